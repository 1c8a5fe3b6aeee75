"""Named libraries hold the functions that they are named for."""

import pytest
import torch

from dynasindy.systems import Tras, Xi
from dynasindy.systems.base import Signature
from dynasindy.world_models.features import of, register_function, variable
from dynasindy.world_models.libraries import (
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


def test_degrees_and_harmonics_below_one_are_refused():
    with pytest.raises(ValueError, match="degree 0"):
        polynomial(SIGNATURE, degree=0)
    with pytest.raises(ValueError, match="0 harmonics"):
        fourier(SIGNATURE, n_frequencies=0)
