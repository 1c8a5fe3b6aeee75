"""Libraries hold the functions they say, and their derivatives are those of autograd."""

import pytest
import torch

from dynasindy.systems import Tras, Xi
from dynasindy.systems.base import Signature
from dynasindy.world_models.features import of, register_function, variable
from dynasindy.world_models.libraries import (
    build_library,
    fourier,
    paper_equation,
    paper_table,
    polynomial,
    product_of,
    rotor,
    sum_of,
    terms,
)
from dynasindy.world_models.library import Library

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def _points(n: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return tuple(2 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1 for k in (6, 2))


def test_the_paper_s_libraries_have_27_and_40_functions_in_its_order():
    table = paper_table(Xi().signature)
    assert len(table) == 27
    assert table.names[0] == "1"
    assert table.names[9:11] == ("alpha_a cos(alpha_p)", "alpha_p cos(alpha_p)")
    assert table.names[17] == "alpha_a^2 sin(alpha_p)"
    assert table.names[25:] == ("sin(alpha_p)", "cos(alpha_p)")
    assert len(paper_equation(Xi().signature)) == 40


def test_values_are_those_of_the_formulas():
    x, u = _points()
    theta = paper_table(Xi().signature)(x, u)
    assert torch.allclose(theta[:, 14], x[:, 5] * torch.cos(x[:, 1]))
    assert torch.allclose(theta[:, 23], u[:, 0] ** 2 * torch.sin(x[:, 1]))


@pytest.mark.parametrize("name", ["paper_table", "paper_equation", "rotor", "polynomial", "fourier"])
def test_derivatives_are_those_of_autograd(name):
    library = build_library(name, Tras().signature)
    x, u = _points(4)
    theta, slopes = library.jacobian(x, u)
    expected = torch.func.vmap(torch.func.jacrev(library), (0, 0))(x, u)
    assert torch.equal(theta, library(x, u))
    assert torch.allclose(slopes, expected)


def test_numbers_of_polynomial_and_fourier_functions():
    assert len(polynomial(SIGNATURE, degree=3)) == 20
    assert len(fourier(SIGNATURE, n_frequencies=2, variables=["a"])) == 4


def test_sums_keep_each_function_once_and_products_multiply():
    one = Library(SIGNATURE, [variable("a"), variable("b")])
    two = Library(SIGNATURE, [variable("b"), of("sin", "a")])
    assert (one + two).names == ("a", "b", "sin(a)")
    assert (one * two).names == ("a b", "b^2", "a sin(a)", "b sin(a)")
    builders = [lambda s: polynomial(s, 1), lambda s: fourier(s)]
    assert len(sum_of(SIGNATURE, builders)) == 4 + 6
    assert len(product_of(SIGNATURE, builders)) == 4 * 6


def test_user_functions_can_be_used_by_name():
    register_function("cube_test", lambda z: z**3)
    x, u = torch.tensor([[2.0, 3.0]]), torch.zeros(1, 1)
    assert terms(SIGNATURE, ["cube_test"], ["b"])(x, u).tolist() == [[27.0]]


def test_the_rotor_library_says_which_function_belongs_to_which_equation():
    library = rotor(Tras().signature)
    assert set(library.allowed["omega_p"]) == {
        "1",
        "u_p",
        "omega_p",
        "|omega_p|",
        "omega_p |omega_p|",
        "omega_p^2",
    }
    assert "omega_p |omega_p|" not in library.allowed["Omega_a"]


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match=r"names beta, which do not exist; allowed are a, b, u"):
        Library(SIGNATURE, [variable("beta")])
    with pytest.raises(ValueError, match="allowed are paper_table"):
        build_library("papertable", SIGNATURE)
    with pytest.raises(ValueError, match="not in the library"):
        polynomial(SIGNATURE).index("a^9")
    with pytest.raises(ValueError, match="empty"):
        Library(SIGNATURE, [])
    with pytest.raises(ValueError, match="does not exist"):
        Library(SIGNATURE, [variable("a")], allowed={"c": [variable("a")]})


def test_degrees_and_harmonics_below_one_are_refused():
    with pytest.raises(ValueError, match="degree 0"):
        polynomial(SIGNATURE, degree=0)
    with pytest.raises(ValueError, match="0 harmonics"):
        fourier(SIGNATURE, n_frequencies=0)
