"""Generated torch code and machine code compute Theta times Xi, Runge-Kutta steps, and their derivatives."""

import copy
import math

import pytest
import torch
from one_period import one_period

from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import Writer, generate
from dynasindy.sindy.functions import register_function
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems import Tras, integrate
from dynasindy.systems.base import Signature
from dynasindy.systems.compiler import compiler
from dynasindy.systems.machine import Machine

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
NAMES = ["paper_table", "paper_equation", "rotor", "rotor_reaction", "polynomial"]


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 2 * torch.rand(*shape, generator=generator, dtype=torch.float64) - 1


def sparse(library: Library, share: float, seed: int) -> torch.Tensor:
    xi = draw(len(library), library.signature.n_x, seed=seed)
    return torch.where(draw(*xi.shape, seed=seed + 100) < 2 * share - 1, xi, 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_code_equals_the_sum_of_all_functions(name):
    library = build_library(name, Tras().signature)
    x, u = draw(3, 4, 6, seed=1), draw(3, 4, 2, seed=2)
    for seed, share in enumerate((0.1, 0.5, 1.0)):
        xi = sparse(library, share, seed)
        assert torch.allclose(generate(library, xi)(x, u), library(x, u) @ xi, rtol=1e-12, atol=1e-12)


def test_closed_form_with_powers_frequencies_inverses_and_functions_of_two_variables():
    register_function("angle_test", "{0} / (1 + fabs({1}))")
    features = [
        *(CONSTANT, variable("a"), variable("a", 5), variable("b", -2) * variable("a")),
        *(of("sin", "a", frequency=2.0, power=3), of("cos", "a", frequency=0.5) * variable("u")),
        *(of("angle_test", "a", "b"), of("exp", "b") * of("abs", "u") * of("sign", "a") * of("tanh", "b")),
    ]
    values = [0.5, -1.5, 2.0, 0.25, 3.0, -4.0, 0.7, 1.1]
    xi = torch.tensor([values, values[::-1]], dtype=torch.float64).mT
    x, u = draw(9, 2), draw(9, 1, seed=1)
    (a, b), v = x.unbind(-1), u[:, 0]
    theta = [
        *(torch.ones_like(a), a, a**5, a / b**2, torch.sin(2 * a) ** 3, torch.cos(a / 2) * v, a / (1 + b.abs())),
        torch.exp(b) * v.abs() * a.sign() * torch.tanh(b),
    ]
    expected = torch.stack([sum(c * t for c, t in zip(row, theta)) for row in xi.mT.tolist()], -1)
    assert torch.allclose(generate(Library(SIGNATURE, features), xi)(x, u), expected, rtol=1e-12)


def test_rows_that_are_empty_constant_or_one_function_have_the_shape_of_the_batch():
    library = Library(SIGNATURE, [CONSTANT, variable("u")])
    for batch in ((), (5,), (2, 3)):
        x, u = draw(*batch, 2), draw(*batch, 1, seed=1)
        empty = generate(library, torch.tensor([[0.0, 2.5], [0.0, 0.0]]))(x, u)
        assert torch.equal(empty, torch.tensor([0.0, 2.5], dtype=torch.float64).expand(*batch, 2))
        single = generate(library, torch.tensor([[0.0, 0.0], [1.0, -3.0]]))(x, u)
        assert torch.allclose(single, torch.cat([u, -3 * u], -1), rtol=1e-15)


pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
A, B, U = variable("a"), variable("b"), variable("u")
FEATURES = {
    "products": [CONSTANT, A * B, U * B * B, A * A * A],
    "sin": [of("sin", "a"), of("sin", "b", frequency=3.0) * U],
    "cos": [of("cos", "a", frequency=2.0) * B],
    "abs": [of("abs", "b") * B, of("abs", "u")],
    "sign": [of("sign", "b") * A],
    "exp": [of("exp", "a")],
    "tanh": [of("tanh", "b", frequency=10.0), of("tanh", "a", frequency=0.05)],
    "sqrt": [of("sqrt", "a")],
    "bell": [of("bell", "b", frequency=2.0)],
    "root": [of("root", "a", frequency=-2.0, fitted=True)],
    "hinge": [of("hinge", "b", frequency=0.2, fitted=True)],
    "ahead": [of("ahead", "a", "b"), of("ahead", "u", "b")],
    "slack": [of("slack", "a", "b", frequency=0.4, fitted=True)],
    "per_cos2": [of("per_cos2", "a", frequency=3.0, fitted=True) * U],
}


def drawn(rows, *, reach=2.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    whole = reach * (2 * torch.rand(rows, 3, generator=generator) - 1)
    return whole[:, :2].contiguous(), (whole[:, 2:] / reach).contiguous()


def made(features, seed=1):
    library = Library(SIGNATURE, features)
    generator = torch.Generator().manual_seed(seed)
    return library, torch.randn(len(library), 2, generator=generator, dtype=torch.float64)


def reference(library, xi, x, u, dt, substeps, stops=None):
    """Integrate with the library's own functions in double precision."""
    return integrate(lambda x, u: library(x, u) @ xi, x.double(), u.double(), dt, substeps, stops)


@pytest.mark.parametrize("names", [list(FEATURES)[::2], list(FEATURES)[1::2]], ids=["one half", "other half"])
def test_states_and_derivatives_equal_double_precision(names):
    library, xi = made([A, *(feature for name in names for feature in FEATURES[name])])
    x, u = drawn(67)  # not a multiple of the rows that are handled at once
    code = Machine(Writer(library, xi).program())
    samples, _ = one_period(code, x, u, 0.1, 3)
    torch.testing.assert_close(samples, reference(library, xi, x, u, 0.1, 3)[0].float(), rtol=2e-5, atol=2e-6)
    a, b = code.sensitivities(x, u, 0.1, 2)
    whole = torch.cat([x, u], -1).double()
    slopes = torch.func.vmap(
        torch.func.jacrev(lambda z: reference(library, xi, z[:2], z[2:], 0.1, 2)[0][-1])
    )(whole)  # fmt: skip
    torch.testing.assert_close(torch.cat([a, b], -1), slopes.float(), rtol=5e-5, atol=5e-6)


def test_a_model_is_as_its_coefficients_are_whichever_of_them_are_zero_or_one():
    library, xi = made([A, B, U, A * B, of("sin", "a", frequency=3.0)])
    x, u = (part.double() for part in drawn(7))
    rng = torch.Generator().manual_seed(5)
    for _ in range(6):
        drawn_kinds = torch.randint(4, xi.shape, generator=rng)
        changed = torch.where(drawn_kinds == 0, 0.0, torch.where(drawn_kinds == 1, 1.0, xi))
        changed = torch.where(drawn_kinds == 2, torch.full_like(xi, 3.0), changed)  # as the number in the sine
        found = one_period(Machine(Writer(library, changed).program(), torch.float64), x, u, 0.1, 2)[0]
        torch.testing.assert_close(found, reference(library, changed, x, u, 0.1, 2)[0], rtol=1e-13, atol=1e-14)


def test_a_model_has_machine_code_for_what_it_can_compute_and_as_it_is_now(monkeypatch):
    library, xi = made([A, B, U])
    model = SindyModel(SIGNATURE, library)
    model.set_coefficients(xi)
    x, u = drawn(6)
    code = model.compiled(x, u)
    assert code is not None and model.compiled(x, u) is code
    double = x.double(), u.double()
    assert model.compiled(*double) not in (None, code)
    exact = reference(library, xi, *double, 0.1, 2)[0]
    torch.testing.assert_close(integrate(model, *double, 0.1, 2)[0], exact, rtol=1e-13, atol=1e-14)
    assert model.compiled(x, u.double()) is None
    assert model.compiled(x, u[:1]) is None
    torch.testing.assert_close(integrate(model, x, u, 0.1, 2)[0], reference(library, xi, x, u, 0.1, 2)[0].float())
    before = integrate(model, x, u, 0.1, 2)[0]
    model.set_coefficients(2 * xi)
    assert not torch.allclose(integrate(model, x, u, 0.1, 2)[0], before)
    copied = copy.deepcopy(model)
    assert torch.equal(integrate(copied, x, u, 0.1, 2)[0], integrate(model, x, u, 0.1, 2)[0])
    # What carries a gradient is left to torch.
    slope = integrate(model, x.requires_grad_(), u, 0.1, 2)[0].sum()
    assert slope.requires_grad
    assert SindyModel(SIGNATURE, library, machine_code=False).compiled(x.detach(), u) is None
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    alone = SindyModel(SIGNATURE, Library(SIGNATURE, [A, A * B * U]))
    assert alone.compiled(x.detach(), u) is None
    assert integrate(alone, x.detach(), u, 0.1, 2)[0].shape == (6, 2, 2)


def test_a_fraction_of_whole_numbers_in_a_users_formula_is_one():
    register_function("third_test", "1 / 3 * {0}")
    register_function("half_test", "{0} / 2")
    library = Library(SIGNATURE, [of("third_test", "a"), of("half_test", "a")])
    xi = torch.tensor([[1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    code, (x, u) = Machine(Writer(library, xi).program()), drawn(5)
    torch.testing.assert_close(one_period(code, x, u, 0.3, 1)[0], reference(library, xi, x, u, 0.3, 1)[0].float())
    slopes = code.sensitivities(x, u, 0.3, 1)[0][:, :, 0]
    wanted = torch.tensor([math.exp(0.1), 1.5 * (math.exp(0.1) - 1)])  # of a' = a / 3, b' = a / 2 over 0.3 s
    torch.testing.assert_close(slopes, wanted.expand(5, 2), rtol=1e-5, atol=1e-6)
