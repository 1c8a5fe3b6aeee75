"""Which functions a fit to trajectories takes: what is outside may come in, and what makes it worse goes again."""

import math

import numpy as np
import pytest
import torch

from dynasindy.sindy import trajectory_fit as choosing
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import Descent, Estimate
from dynasindy.sindy.trajectory_fit import Limits, converge, price, refine_trajectory, search_functions
from dynasindy.sindy.windows import Windows
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

LIBRARY = Library(Signature(("y",), ("-",), ("u",), (1.0,)), [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B, DT, NOISE = -2.0, 3.0, 0.01, 0.03
ALL = torch.ones(4, 1, dtype=torch.bool)


def recording(seed=1, noise=NOISE):
    """Samples of y' = A y + B u, exact but for white noise."""
    rng = np.random.default_rng(seed)
    u, phi, y = rng.uniform(-1, 1, 20).repeat(10), math.exp(A * DT), [0.3]
    for held in u:
        y.append(phi * y[-1] + B * (phi - 1) / A * held)
    seen = torch.from_numpy(np.array(y) + noise * rng.normal(size=201)).unsqueeze(-1)
    return Transitions.from_trajectory(seen, torch.from_numpy(u).unsqueeze(-1), DT)


def begun(*values):
    """An estimate over one window, and the window."""
    windows = Windows.of(recording(), 200)
    xi = torch.tensor(values, dtype=torch.float64).unsqueeze(-1)
    return Estimate(LIBRARY, xi, windows.first), windows


def test_what_may_come_in_is_what_is_outside_the_model(monkeypatch):
    seen = []

    def spy(triangle, n_fixed, active, others, limit):
        seen.append((triangle.shape[1], n_fixed, active.features.tolist(), others.features.tolist(), limit))

    monkeypatch.setattr(choosing, "reconsider", spy)
    xi = torch.tensor([[A], [B], [0.0], [0.0]], dtype=torch.float64)
    refine_trajectory(LIBRARY, xi, ALL, recording(), Descent(10))
    # One start state, four functions and the error; a function is worth the logarithm of 200 samples, and as it is
    # one of four, twice the logarithm of that.
    assert seen == [(6, 1, [0, 1], [2, 3], pytest.approx(math.log(200) + 2 * math.log(4)))]
    assert price(200, ALL) == pytest.approx(math.log(200) + 2 * math.log(4))


def test_what_promises_much_and_turns_out_worse_goes_again_and_is_not_tried_twice(monkeypatch):
    offered = []

    def promise(triangle, n_fixed, active, others, limit):
        """The input has to go for the last function outside, whatever that costs."""
        offered.append(others.features.tolist())
        stay = [k for k, feature in enumerate(active.features.tolist()) if feature != 1]
        return torch.tensor([*stay, len(active) + len(others) - 1])

    monkeypatch.setattr(choosing, "reconsider", promise)
    estimate, windows = begun(A, B, 0.0, 0.0)
    found = search_functions(estimate, ALL, windows, Limits(price(200, ALL), 30))
    assert found.xi[:2, 0].tolist() == pytest.approx([A, B], rel=0.1) and not found.xi[2:].any()
    assert offered == [[2, 3], [2]]


def test_functions_that_mean_nothing_are_dropped_and_steps_end_at_the_least_error():
    estimate, windows = begun(-1.5, 2.5, 0.05, 0.05)
    found = search_functions(estimate, ALL, windows, Limits(price(200, ALL), 30))
    assert found.xi[:2, 0].tolist() == pytest.approx([A, B], rel=0.1) and not found.xi[2:].any()
    exact = Windows.of(recording(noise=0.0), 200)
    estimate = Estimate(LIBRARY, estimate.xi, exact.first)
    assert converge(estimate, Parameters.where(ALL), exact, 30).xi.flatten().tolist() == pytest.approx(
        [A, B, 0.0, 0.0], abs=1e-6
    )


def test_errors_that_last_make_a_coefficient_dearer_if_that_is_asked():
    data = Transitions.from_trajectory(torch.zeros(401, 1).double(), torch.zeros(400, 1).double(), 0.1)
    windows = Windows.of(data, 20, False, 1)
    slow = torch.sin(torch.arange(400).double() / 10).reshape(windows.mask.shape)
    assert Limits(7.0, 3).at(slow, windows) == 7.0
    assert Limits(7.0, 3, correlated=True).at(slow, windows) > 14.0
