"""Libraries hold the functions they say, and no others."""

import pickle

import pytest
import torch

from dynasindy.sindy import library as library_module
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.named_libraries import build_library, paper_table, polynomial
from dynasindy.systems import Xi
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def _points(n: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return tuple(2 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1 for k in (6, 2))


def test_values_are_those_of_the_formulas():
    x, u = _points()
    theta = paper_table(Xi().signature)(x, u)
    assert torch.allclose(theta[:, 14], x[:, 5] * torch.cos(x[:, 1]))
    assert torch.allclose(theta[:, 23], u[:, 0] ** 2 * torch.sin(x[:, 1]))


def test_powers_products_and_functions_are_those_that_they_say_also_of_a_copy():
    a, u = variable("a"), variable("u")
    features = [CONSTANT, a, variable("a", 3), variable("b", -1), variable("a", 2) * u]
    features += [of("sin", "b", power=3, frequency=2.0) * a, of("ahead", "u", "a"), of("sin", "b", frequency=2.0)]
    library = Library(SIGNATURE, features)
    x, v = (part[:, :k] for part, k in zip(_points(7), (2, 1), strict=True))
    p, q, r = x[:, 0], x[:, 1], v[:, 0]
    sine = torch.sin(2.0 * q)
    wanted = [torch.ones(7), p, p * p * p, 1 / q, p * p * r, sine * sine * sine * p, r - p, sine]
    wanted = torch.stack([column.double() for column in wanted], -1)
    for found in (library, library, pickle.loads(pickle.dumps(library)), library.with_step(0.1)):
        torch.testing.assert_close(found(x, v), wanted, rtol=1e-13, atol=1e-14)
    torch.testing.assert_close(library.subset([5, 2])(x, v), wanted[:, [5, 2]], rtol=1e-13, atol=1e-14)
    assert library(x.float(), v).dtype == torch.float32


def test_a_library_may_be_as_large_as_is_said_and_no_larger(monkeypatch):
    monkeypatch.setattr(library_module, "LARGEST", 3)
    features = [variable("a", power) for power in range(1, 5)]
    assert len(Library(SIGNATURE, features[:3])) == 3
    with pytest.raises(ValueError, match="more than 3 functions"):
        Library(SIGNATURE, features)


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="beta"):
        Library(SIGNATURE, [variable("beta")])
    with pytest.raises(ValueError, match="allowed are paper_table"):
        build_library("papertable", SIGNATURE)
    with pytest.raises(ValueError, match="among"):
        polynomial(SIGNATURE).index("a^9")
    with pytest.raises(ValueError, match="empty"):
        Library(SIGNATURE, [])
    with pytest.raises(ValueError, match="does not exist"):
        Library(SIGNATURE, [variable("a")], allowed={"c": [variable("a")]})
