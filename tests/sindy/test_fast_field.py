"""Generated code computes Theta times Xi, its derivatives included, with inactive functions left out."""

import pytest
import torch

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.functions import register_function
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems import Tras
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
NAMES = ["paper_table", "paper_equation", "rotor", "rotor_reaction", "polynomial", "fourier"]


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 2 * torch.rand(*shape, generator=generator, dtype=torch.float64) - 1


def sparse(library: Library, share: float, seed: int) -> torch.Tensor:
    xi = draw(len(library), library.signature.n_x, seed=seed)
    return torch.where(draw(*xi.shape, seed=seed + 100) < 2 * share - 1, xi, 0.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_code_equals_the_sum_of_all_functions(name, share):
    library = build_library(name, Tras().signature)
    x, u = draw(3, 4, 6, seed=1), draw(3, 4, 2, seed=2)
    for seed in range(3):
        xi = sparse(library, share, seed)
        assert torch.allclose(generate(library, xi)(x, u), library(x, u) @ xi, rtol=1e-12, atol=1e-12)


def test_closed_form_with_powers_frequencies_inverses_and_functions_of_two_variables():
    register_function("angle_test", torch.atan2)
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
        *(torch.ones_like(a), a, a**5, a / b**2, torch.sin(2 * a) ** 3, torch.cos(a / 2) * v, torch.atan2(a, b)),
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


def test_derivatives_by_states_and_inputs_are_those_of_the_sum():
    library = build_library("rotor", Tras().signature)
    xi, x, u = sparse(library, 0.5, 3), draw(4, 6, seed=1), draw(4, 2, seed=2)
    ours, plain = generate(library, xi), lambda x, u: library(x, u) @ xi
    for argument in (0, 1):
        got, wanted = (torch.func.vmap(torch.func.jacrev(f, argument))(x, u) for f in (ours, plain))
        assert torch.allclose(got, wanted, rtol=1e-10, atol=1e-12)


def test_one_field_serves_both_precisions():
    library = build_library("paper_table", Tras().signature)
    xi, x, u = sparse(library, 0.5, 4), draw(4, 6, seed=1), draw(4, 2, seed=2)
    field = generate(library, xi)
    single = field(x.float(), u)  # inputs follow the states
    assert single.dtype == torch.float32 and field(x, u).dtype == torch.float64
    assert torch.allclose(single.double(), field(x, u), rtol=1e-4, atol=1e-5)
    assert torch.allclose(field(x, u), library(x, u) @ xi, rtol=1e-12, atol=1e-14)


def test_functions_without_a_coefficient_are_not_computed():
    calls = []
    register_function("counted_test", lambda z: calls.append(1) or z)
    library = Library(SIGNATURE, [variable("a"), of("counted_test", "b")])
    x, u = draw(2, 2), draw(2, 1)
    generate(library, torch.tensor([[1.0, 2.0], [0.0, 0.0]]))(x, u)
    assert not calls
    generate(library, torch.tensor([[1.0, 2.0], [3.0, 4.0]]))(x, u)
    assert len(calls) == 1  # one value serves both rows


@pytest.mark.parametrize("value", [float("inf"), -float("inf"), float("nan")])
def test_coefficients_that_are_not_finite_get_one_line(value):
    xi = torch.zeros(2, 2, dtype=torch.float64)
    xi[1, 0] = value
    with pytest.raises(ValueError, match=rf"such as {value} of u in a'; allowed are finite ones") as error:
        generate(Library(SIGNATURE, [CONSTANT, variable("u")]), xi)
    assert "\n" not in str(error.value)
