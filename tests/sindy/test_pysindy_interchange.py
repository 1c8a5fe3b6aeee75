"""Models agree with PySINDy and sympy on what they compute."""

import numpy as np
import pysindy
import pytest
import torch

from dynasindy.sindy import SindyModel
from dynasindy.sindy.pysindy_interchange import from_pysindy, to_pysindy, to_sympy
from dynasindy.systems import Tras
from dynasindy.systems.base import Signature


def _model(library="rotor") -> SindyModel:
    model = SindyModel(Tras().signature, library)
    generator = torch.Generator().manual_seed(0)
    model.set_coefficients(torch.rand(model.coefficients.shape, generator=generator, dtype=torch.float64) - 0.5)
    return model


def _points(n=4):
    generator = torch.Generator().manual_seed(1)
    return (2 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1 for k in (6, 2))


def test_pysindy_predicts_what_we_do():
    model = _model("paper_table")
    x, u = _points()
    theirs = to_pysindy(model).predict(x.numpy(), u=u.numpy())
    assert np.allclose(np.asarray(theirs), model(x, u).numpy(), rtol=1e-12)


def test_a_model_goes_to_pysindy_and_back():
    model = _model()
    x, u = _points()
    back = from_pysindy(to_pysindy(model), Tras().signature)
    assert torch.allclose(back(x, u), model(x, u), rtol=1e-12)


def test_a_polynomial_and_fourier_model_of_pysindy_is_read():
    generator = np.random.default_rng(0)
    x, u = generator.uniform(-1, 1, (200, 2)), generator.uniform(-1, 1, (200, 1))
    dx = np.stack([x[:, 1], -np.sin(2 * x[:, 0]) + 3 * x[:, 0] * u[:, 0] - x[:, 1] ** 2], -1)
    library = pysindy.PolynomialLibrary(2) + pysindy.FourierLibrary(2)
    theirs = pysindy.SINDy(optimizer=pysindy.STLSQ(threshold=0.05, alpha=0), feature_library=library)
    theirs.fit(x, t=0.1, x_dot=dx, u=u)
    ours = from_pysindy(theirs, Signature(("a", "b"), ("-", "-"), ("c",), (1.0, 1.0)))
    assert np.allclose(ours(torch.from_numpy(x), torch.from_numpy(u)).numpy(), dx, atol=1e-8)


def test_a_model_of_pysindy_in_discrete_time_is_refused():
    x = np.cumprod(np.full((30, 1), 0.9), 0)
    theirs = pysindy.DiscreteSINDy(feature_library=pysindy.PolynomialLibrary(1)).fit(x, t=1)
    with pytest.raises(ValueError, match="DiscreteSINDy"):
        from_pysindy(theirs, Signature(("a",), ("-",), (), (1.0,)))


def test_sympy_knows_the_functions_with_numbers_inside():
    sympy = pytest.importorskip("sympy")
    words = ["tanh(3 a)", "b^2 /(1 + 3 cos(a)^2)", "max(0, a - 0.2)", "sqrt(a - 0.2)", "exp(-(2 a)^2)^2", "sqrt(2 b)",
             "|a|", "sign(b)", "slack(a, b; 0.2)"]  # fmt: skip
    model = SindyModel(Signature(("a", "b"), ("-", "-"), (), (1.0, 1.0)), words)
    model.set_coefficients(torch.arange(1.0, 19.0).reshape(9, 2))
    a, b = 0.7, 0.4
    values = [
        *(np.tanh(3 * a), b**2 / (1 + 3 * np.cos(a) ** 2), a - 0.2, np.sqrt(a - 0.2)),
        *(np.exp(-((2 * a) ** 2)) ** 2, np.sqrt(2 * b), a, 1.0, a - b - 0.2),
    ]
    expected = [np.dot(values, np.arange(k, 19, 2)) for k in (1, 2)]
    written = to_sympy(model)
    point = {sympy.Symbol("a", real=True): a, sympy.Symbol("b", real=True): b}
    assert [float(written[state].subs(point)) for state in ("a", "b")] == pytest.approx(expected)
    # Below their number the ramp is nothing, and the root that of a thousandth, as in the model.
    low = np.sqrt(1e-3)
    values = [
        *(np.tanh(0.3), b**2 / (1 + 3 * np.cos(0.1) ** 2), 0, low, np.exp(-0.04) ** 2),
        *(np.sqrt(2 * b), 0.1, 1.0, 0.1 - b + 0.2),
    ]
    below = written["a"].subs({**point, sympy.Symbol("a", real=True): 0.1})
    assert float(below) == pytest.approx(np.dot(values, np.arange(1, 19, 2)))


def test_a_difference_equation_goes_to_sympy_as_what_comes_next_and_not_to_pysindy():
    """x+ = -0.6 x + 0.3 u, every 0.1 s."""
    signature = Signature(("x",), ("-",), ("u",), (1.0,))
    model = SindyModel(signature, ["x", "u"], time="discrete")
    model.library = model.library.with_step(0.1)
    model.set_coefficients(torch.tensor([[-16.0], [3.0]]))
    expression = to_sympy(model)["x"]
    values = {str(symbol): symbol for symbol in expression.free_symbols}
    assert float(expression.subs({values["x"]: 2.0, values["u"]: 5.0})) == pytest.approx(0.3)
    with pytest.raises(ValueError, match="to_pysindy"):
        to_pysindy(model)
