"""Refinement goes beyond the trapezoidal rule, and chooses its criterion by what the errors look like."""

import math

import numpy as np
import pytest
import torch

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.constraints import Constraints
from dynasindy.world_models.features import CONSTANT, variable
from dynasindy.world_models.library import Library
from dynasindy.world_models.one_step import refine_one_step
from dynasindy.world_models.refine import METHODS, Refinement, looks_noisy
from dynasindy.world_models.regression import Regression, RunningSums, integral_form
from dynasindy.world_models.trajectory import refine_trajectory

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B = -2.0, 3.0
FREE = Constraints.build(LIBRARY, {}, {}, {})


def recording(dt: float, noise: float = 0.0, n: int = 150) -> Transitions:
    """Exact motion of y' = A y + B u under held inputs, with white noise on the states."""
    generator, phi, y = np.random.default_rng(3), math.exp(A * dt), [0.3]
    u = generator.uniform(-1, 1, n)
    for held in u:
        y.append(phi * y[-1] + B * (phi - 1) / A * held)
    x = torch.tensor(y, dtype=torch.float64) + noise * torch.from_numpy(generator.normal(size=n + 1))
    return Transitions.from_trajectory(x.unsqueeze(-1), torch.from_numpy(u).unsqueeze(-1), dt)


def first(data: Transitions) -> torch.Tensor:
    sums = RunningSums(4, 1)
    sums.add(integral_form(LIBRARY, data))
    return Regression("bic").solve(sums, FREE.free, FREE.offset)


def error(xi: torch.Tensor) -> float:
    return float((xi.flatten() - torch.tensor([A, B, 0, 0])).abs().max())


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(-1)


def test_each_method_is_nearer_to_the_plant_than_the_one_before():
    data = recording(0.05)
    start = first(data)
    once = Refinement("integral", rounds=1).run(LIBRARY, start, FREE, data)
    twice = Refinement("integral", rounds=2).run(LIBRARY, start, FREE, data)
    exact = Refinement("one_step", tolerance=1e-9).run(LIBRARY, start, FREE, data)
    errors = [error(xi) for xi in (start, once, twice, exact)]
    assert errors[1] < 0.2 * errors[0] and errors[2] <= errors[1] and errors[3] < 0.1 * errors[2]
    assert errors[3] < 1e-7


def test_no_rounds_of_the_integral_form_change_nothing():
    data = recording(0.05)
    assert torch.equal(Refinement(rounds=0).run(LIBRARY, column(1, 2, 3, 4), FREE, data), column(1, 2, 3, 4))


def test_what_is_given_stays_in_every_method():
    constraints = Constraints.build(LIBRARY, {}, {"y": ["y"]}, {"y": {"u": 2.9}})
    data = recording(0.02)
    for method in METHODS:
        found = Refinement(method, window=10).run(LIBRARY, column(A, 2.9, 0, 0), constraints, data)
        assert found[1, 0] == 2.9 and found[2:].flatten().tolist() == [0, 0] and found[0, 0].item() != A


def test_white_noise_is_told_from_a_wrong_model():
    assert looks_noisy(LIBRARY, column(A, B, 0, 0), recording(0.02, 0.03))
    assert not looks_noisy(LIBRARY, column(A, B, 0.5, 0), recording(0.02))  # a constant error correlates by +1
    assert not looks_noisy(LIBRARY, column(0.5 * A, B, 0, 0), recording(0.02))


def test_auto_takes_trajectories_for_noise_and_single_steps_without():
    auto = Refinement("auto", rounds=0, window=10)
    noisy, clean, start = recording(0.02, 0.03), recording(0.02), column(-1.9, 2.8, 0, 0)
    wanted = refine_trajectory(LIBRARY, start, FREE.free, noisy, 10)
    assert torch.equal(auto.run(LIBRARY, start, FREE, noisy), wanted)
    wanted = refine_one_step(LIBRARY, start, FREE.free, clean, auto.tolerance)
    assert torch.equal(auto.run(LIBRARY, start, FREE, clean), wanted)


@pytest.mark.parametrize("wrong", [{"method": "newton"}, {"rounds": -1}, {"tolerance": 0.0}, {"window": 0}])
def test_settings_that_are_not_allowed_are_refused(wrong):
    with pytest.raises(ValueError, match="allowed") as refused:
        Refinement(**wrong)
    assert "\n" not in str(refused.value)
