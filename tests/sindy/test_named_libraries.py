"""Named libraries hold the functions that they are named for, and the equations of motion of textbooks."""

import math

import numpy as np
import pysindy
import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import (
    auto,
    auto_rig,
    build_library,
    paper_equation,
    paper_table,
    polynomial,
    rotor,
)
from dynasindy.systems import Signature, Tras, Xi, rk4
from dynasindy.systems.transitions import Transitions


def _wide_points(n: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    generator = np.random.default_rng(0)
    return torch.from_numpy(generator.uniform(-2, 2, (n, 6))), torch.from_numpy(generator.uniform(-1, 1, (n, 2)))


def _values(library, z) -> np.ndarray:
    return np.asarray(library.fit(z).transform(z))


def _same_functions(ours: torch.Tensor, theirs: np.ndarray) -> bool:
    """Whether columns are equal up to their order."""
    if ours.shape != theirs.shape:
        return False
    one, two = (table[:, np.lexsort(np.round(table, 9))] for table in (ours.numpy(), theirs))
    return np.allclose(one, two, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_polynomials_are_pysindy_s(degree):
    x, u = _wide_points()
    theirs = _values(pysindy.PolynomialLibrary(degree), torch.cat([x, u], -1).numpy())
    assert theirs.shape[1] == math.comb(8 + degree, degree)
    assert _same_functions(polynomial(Xi().signature, degree)(x, u), theirs)


def test_the_paper_s_libraries_are_made_of_pysindy_s():
    x, u = _wide_points()
    z = torch.cat([x, u], -1).numpy()
    linear = _values(pysindy.PolynomialLibrary(1, include_bias=False), z)
    trigonometric = _values(pysindy.FourierLibrary(1), z)
    sine, cosine = _values(pysindy.FourierLibrary(1), z[:, 1:2]).T[:, :, None]
    products = [linear, linear * cosine, linear**2 * sine]
    table = np.concatenate([np.ones((60, 1)), *products, sine, cosine], 1)
    assert np.allclose(paper_table(Xi().signature)(x, u), table)  # in the order of the table
    assert _same_functions(paper_equation(Xi().signature)(x, u), np.concatenate([*products, trigonometric], 1))


@pytest.mark.parametrize("rate", ["Omega_p", "omega_a", "omega_p"])
def test_the_rotor_library_represents_the_equations_of_tras(rate):
    # Exact derivatives of the first-principles plant lie in the span of the functions allowed in that equation.
    library, plant = rotor(Tras().signature), Tras()
    x, u = _wide_points(400)
    x = x * torch.tensor([1, 0.3, 1, 1, 2000, 1500])
    allowed = [library.index(n) for n in library.allowed[rate]]
    theta, dx = library(x, u)[:, allowed], plant(x, u)[:, [plant.signature.state_index(rate)]]
    scaled = theta / theta.norm(dim=0)
    rest = dx - scaled @ torch.linalg.lstsq(scaled, dx, driver="gelsd").solution
    assert float(rest.norm() / (dx - dx.mean()).norm()) < 1e-3


def test_libraries_are_built_from_words_builders_and_libraries():
    words = build_library(["1", "alpha_p", "omega_a |omega_a|", "Omega_a^2 sin(2 alpha_p)"], Xi().signature)
    x, u = _wide_points()
    expected = [torch.ones(60).double(), x[:, 1], x[:, 4] * x[:, 4].abs(), x[:, 2] ** 2 * torch.sin(2 * x[:, 1])]
    assert torch.allclose(words(x, u), torch.stack(expected, -1))
    assert build_library(words, Xi().signature) is words
    assert len(build_library(lambda s: polynomial(s, 1), Xi().signature)) == 9


def test_a_dead_zone_with_two_edges_is_identified_from_a_noisy_log():
    signature, rng = Signature(("v",), ("m/s",), ("u",), (1.0,)), np.random.default_rng(1)
    u, v, phi = rng.uniform(-1, 1, 100).repeat(10), [0.0], math.exp(-1.5 * 0.02)
    for held in u:  # v' = -1.5 v + 6 d(u), its closed form
        through = held - 0.25 if held > 0.25 else min(held + 0.14, 0.0)
        v.append(phi * v[-1] + (1 - phi) / 1.5 * 6 * through)
    x = torch.tensor(v).double() + 0.01 * torch.from_numpy(rng.normal(size=1001))
    words = ["1", "v", "u", "hinge(~0.1 u)", "hinge(~-0.1 u)"]
    model = SindyModel(signature, words, Regression("bic"), Refinement("auto", rounds=4))
    model.fit(Transitions.from_trajectory(x[:, None], torch.from_numpy(u)[:, None], 0.02))
    assert [shape.frequency for shape in model.library.shapes] == pytest.approx([0.25, -0.14], abs=0.01)
    # 1, v, u, and one bend at either edge; u + 0.14 up to the lower edge and nothing from there to the upper one.
    expected = [6 * 0.14, -1.5, 6.0, 6.0, -6.0]
    assert model.coefficients[:, 0].tolist() == pytest.approx(expected, rel=0.03)


def test_the_library_of_a_rig_has_dry_friction_of_every_rate_and_what_it_turns():
    one = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 4.0))
    assert set(auto_rig(one).names) - set(auto(one).names) == {"tanh(5 w)"}  # full beyond a 20th of the range
    cart = Signature(("p", "a", "v", "w"), ("m", "rad", "m/s", "rad/s"), ("u",), (1.0, 1.0, 2.0, 10.0))
    dry = {"tanh(10 v)", "tanh(2 w)"}
    assert set(auto_rig(cart).names) - set(auto(cart).names) == dry | {f"{f} cos(a)" for f in dry}
    assert all(shape.fitted for shape in auto_rig(one).shapes)
    for unit in ("cm", "degC/s", "V/s", "1/s", "mol/min", "rpm/s"):
        tank = Signature(("h",), (unit,), ("u",), (1.0,))
        assert auto_rig(tank).names == auto(tank).names
    for unit in ("rpm", "deg/s", "°/s", "rev/s", "1/min", "rev/min", "km/h", "mm/s", "rad/min"):
        shaft = Signature(("w",), (unit,), ("u",), (100.0,))
        assert set(auto_rig(shaft).names) - set(auto(shaft).names) == {"tanh(0.2 w)"}
    rotor = Signature(("a", "w", "n"), ("rad", "rad/s", "rpm"), ("u",), (1.0, 4.0, 100.0))
    assert set(auto_rig(rotor).names) - set(auto(rotor).names) == {"tanh(5 w)", "tanh(0.2 n)"}


CART_POLE = Signature(("p", "theta", "v", "omega"), ("m", "rad", "m/s", "rad/s"), ("force",), (1.0, 0.3, 1.0, 1.0))
CART, POLE, LENGTH, GRAVITY, LARGEST = 1.0, 0.3, 0.6, 9.81, 10.0


def cart_pole(x, u):
    """Solve the two equations of Lagrange for a rod on a cart, upright at 0, by elimination by hand."""
    _, theta, v, omega = x.unbind(-1)
    s, c = theta.sin(), theta.cos()
    # (M + m) v' + m l c omega' = F + m l omega^2 s,   m l c v' + 4/3 m l^2 omega' = m g l s
    a, b, d = CART + POLE, POLE * LENGTH * c, 4 / 3 * POLE * LENGTH**2
    first = LARGEST * u[..., 0] + POLE * LENGTH * omega**2 * s
    second = POLE * GRAVITY * LENGTH * s
    det = a * d - b * b
    return torch.stack((v, omega, (d * first - b * second) / det, (a * second - b * first) / det), -1)


@pytest.fixture(scope="module")
def data():
    generator = torch.Generator().manual_seed(0)
    size = torch.tensor([1.0, 0.5, 1.0, 1.0], dtype=torch.float64)
    x = (torch.rand(20, 4, generator=generator, dtype=torch.float64) - 0.5) * size
    parts, rows = [], torch.arange(20)
    for k in range(40):
        if k % 5 == 0:
            u = torch.rand(20, 1, generator=generator, dtype=torch.float64) - 0.5
        ahead = x
        for _ in range(10):
            ahead = rk4(cart_pole, ahead, u, 0.001)
        parts.append((x, u, ahead))
        x = ahead
    ordered = [torch.stack([part[i] for part in parts], 1).flatten(0, 1) for i in range(3)]
    return Transitions(*ordered, 0.01, rows.repeat_interleave(40))


def test_the_pole_on_a_cart_is_found_with_its_quotient(data):
    model = SindyModel(CART_POLE, "auto", Regression("bic"), Refinement("auto"), known={"p": "v", "theta": "omega"})
    model.fit(data)
    assert (model.coefficients != 0).sum(0).tolist() == [1, 1, 3, 3]
    (shape,) = model.library.shapes
    assert shape.frequency == pytest.approx(-0.75 * POLE / (CART + POLE), rel=1e-4)
    found = dict(zip(model.library.names, model.coefficients[:, 2].tolist(), strict=True))
    over = f"/(1 - {-shape.frequency:g} cos(theta)^2)"
    assert found[f"force {over}"] == pytest.approx(LARGEST / (CART + POLE), rel=1e-4)
    assert found[f"sin(theta) cos(theta) {over}"] == pytest.approx(-0.75 * POLE * GRAVITY / (CART + POLE), rel=1e-4)
