"""A quotient that says nothing goes, and one that the simulated plant has stays."""

import math

import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.library import Library, parse
from dynasindy.sindy.trajectory_fit import drop_quotient
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("a", "w"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
OVER = "per_cos2(~-0.03 a)"
WORDS = ["w", "u", "sin(a)", *(f"{f} {OVER}" for f in ("w", "u", "sin(a)"))]


def library(words=WORDS):
    return Library(SIGNATURE, [parse(text) for text in words])


def test_terms_over_a_quotient_are_joined_to_those_without_it():
    made, free = library(), torch.ones(6, 2, dtype=torch.bool)
    xi = torch.tensor([[1.0, -0.5], [0.0, 0.0], [0.0, 0.0], [0.0, -0.25], [0.0, 3.0], [0.0, 0.0]])
    expected = torch.tensor([[1.0, -0.75], [0.0, 3.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    assert torch.equal(drop_quotient(made, xi, free, 0), expected)
    assert xi[3, 1] == -0.25
    assert drop_quotient(made, expected, free, 0) is None  # it is not in use
    fixed = free.clone()
    fixed[1, 1] = False
    assert drop_quotient(made, xi, fixed, 0) is None
    assert (
        drop_quotient(library([*WORDS[:1], *WORDS[3:]]), xi[[0, 3, 4, 5]], free[:4], 0) is None
    )  # u stands nowhere alone
    dry = library(["w", "tanh(~5 w)"])
    assert drop_quotient(dry, torch.ones(2, 2), torch.ones(2, 2, dtype=torch.bool), 0) is None


@pytest.mark.parametrize("p", [0.0, -0.4])
def test_a_fit_keeps_the_quotient_of_a_plant_that_has_one(p):
    rng, dt = torch.Generator().manual_seed(0), 0.02
    u = (2 * torch.rand(60, generator=rng).double() - 1).repeat_interleave(20)
    x = [torch.zeros(2, dtype=torch.float64)]

    def rates(x, u):
        return torch.stack([x[1], (8 * u - x[1] - 4 * torch.sin(x[0])) / (1 + p * math.cos(x[0]) ** 2)])

    for held in u:
        now = x[-1]
        for _ in range(4):
            k1 = rates(now, held)
            k2 = rates(now + dt / 8 * k1, held)
            k3 = rates(now + dt / 8 * k2, held)
            now = now + dt / 24 * (k1 + 2 * k2 + 2 * k3 + rates(now + dt / 4 * k3, held))
        x.append(now)
    seen = torch.stack(x)
    seen = seen + torch.tensor([1e-3, 1e-2]) * torch.randn(seen.shape, generator=rng).double()
    model = SindyModel(SIGNATURE, WORDS, Regression("bic"), Refinement("trajectory"), known={"a": "w"})
    model.fit(Transitions.from_trajectory(seen, u[:, None], dt))
    equation = model.equations()[1]
    assert ("cos(a)^2" in equation) == (p != 0)
    if p:
        (shape,) = model.library.shapes
        assert shape.frequency == pytest.approx(p, rel=0.05)
    else:
        used = model.coefficients[:, 1].nonzero().flatten().tolist()
        assert {model.library.names[k] for k in used} == {"w", "u", "sin(a)"}
