"""The prior on coefficients: its sizes by hand."""

import math

import pytest
import torch

from dynasindy.sindy.library import CONSTANT, Library, of, parse, variable
from dynasindy.sindy.named_libraries import mechanical
from dynasindy.sindy.trajectory_fit import SHARE, coefficient_prior
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("a", "b"), ("rad", "m"), ("u",), (1.0, 1.0))
LIBRARY = Library(SIGNATURE, [CONSTANT, variable("a"), of("sin", "a") * variable("u"), of("cos", "a")])


def recorded():
    """Two states and an input in three stretches, `a` between 0 and 101 and `b` at rest."""
    a, b, u = [0.0, 1.0, 3.0, 100.0, 101.0], [5.0] * 5, [2.0, -2.0, 2.0, 9.0]
    x = torch.tensor([a, b]).double().T
    # The third transition leads from one stretch to the next: nothing moved along it.
    return Transitions(x[:-1], torch.tensor(u).double()[:, None], x[1:], 0.5, segment=torch.tensor([0, 0, 1, 2]))


def test_a_term_is_likely_to_be_some_times_the_rate_of_change_of_its_equation():
    data, none = recorded(), torch.zeros(4, 2).double()
    found = coefficient_prior(LIBRARY, none, data.x, data)
    # Within the first stretch a moves by 1 in 0.5 s; the others have one sample each.
    rate = 1.0 / 0.5
    turned = [math.sin(value) * u for value, u in zip((0, 1, 3, 100), (2, -2, 2, 9), strict=True)]
    sizes = [math.sqrt(sum(v**2 for v in column) / 4) for column in (turned, map(math.cos, (0, 1, 3, 100)))]
    sizes.insert(0, math.sqrt((0 + 1 + 9 + 100**2) / 4))
    # A constant has none.
    expected = [math.inf, *(SHARE * rate / size for size in sizes)]
    assert found[:, 0].tolist() == pytest.approx(expected)
    assert found[:, 1].tolist() == [math.inf] * 4  # b does not move, and tells no size


def has_prior(library):
    """Whether the functions have one, of states and inputs that move."""
    n_x, n_u = library.signature.n_x, library.signature.n_u
    rng = torch.Generator().manual_seed(0)
    x, u = (torch.rand(9, n, generator=rng, dtype=torch.float64) for n in (n_x, n_u))
    data = Transitions.from_trajectory(x, u, 0.5)
    return coefficient_prior(library, torch.zeros(len(library), n_x).double(), data.x, data).isfinite()[:, 0].tolist()


def test_functions_of_angles_have_a_prior_and_others_have_none():
    words = ["1", "b", "b^2", "u", "tanh(20 b)", "b |b|", "a", "a^2 u", "sin(a)", "cos(a) b", "sin(2 a) u"]
    assert has_prior(Library(SIGNATURE, [parse(word) for word in words])) == [False] * 6 + [True] * 5
    # Where nothing is turned by a state it is no angle.
    assert not any(has_prior(Library(SIGNATURE, [parse(word) for word in words[:8]])))
    quotient = of("per_cos2", "a", frequency=3.0, fitted=True)
    assert has_prior(Library(SIGNATURE, [quotient, variable("a"), variable("b")])) == [True, True, False]
    library = mechanical(Signature(("p", "q", "v", "w"), ("rad", "rad", "rad/s", "rad/s"), ("u",), (1,) * 4))
    turned = [any(name in words for name in "pq") for words in (feature.variables for feature in library.features)]
    assert has_prior(library) == turned and sum(turned) > 50
