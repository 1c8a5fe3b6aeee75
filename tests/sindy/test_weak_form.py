"""The weak form is exact where a plant's states are lines and parabolas, and its bump is the one that is said."""

import numpy as np
import pytest
import torch

from dynasindy.sindy.regression import weak_form
from dynasindy.systems.transitions import Transitions

DT = 0.1


def chain(n: int, seed: int) -> Transitions:
    """Exact states of p' = v, v' = 2 u - 0.5, z' = 3 v under held inputs; v is a line in each interval."""
    rng = np.random.default_rng(seed)
    u, states = rng.normal(size=n), [rng.normal(size=3)]
    for held in u:
        p, v, z = states[-1]
        rate = 2 * held - 0.5
        moved = v * DT + 0.5 * rate * DT**2
        states.append(np.array([p + moved, v + rate * DT, z + 3 * moved]))
    return Transitions.from_trajectory(torch.from_numpy(np.array(states)), torch.from_numpy(u)[:, None], DT)


def theta(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    return torch.cat([torch.ones_like(x[:, :1]), x, u], -1)


def without(data: Transitions, *columns: int) -> Transitions:
    x, x_next = data.x.clone(), data.x_next.clone()
    x[:, columns] = x_next[:, columns] = torch.nan
    return Transitions(x, data.u, x_next, data.dt, data.segment)


XI = torch.tensor([[0, -0.5, 0], [0, 0, 0], [1, 0, 3], [0, 0, 0], [0, 2, 0]], dtype=torch.float64)


@pytest.mark.parametrize("half", [1, 2, 5, 12])
def test_averaged_rates_are_the_averaged_functions_of_an_exact_plant(half):
    data = chain(40, 0)
    functions, rates = weak_form(theta, data, data, {}, half)
    torch.testing.assert_close(rates, functions @ XI)
    # One row per quarter of half a bump, as far as whole bumps of 2 half - 1 samples reach.
    assert len(rates) == (39 - (2 * half - 1)) // max(1, half // 4) + 1


def test_a_rate_that_was_not_measured_is_the_second_difference_of_its_state():
    data = chain(60, 1)
    # The guess of v serves the functions alone: a wrong one changes the equations of p and z, not that of v.
    guess = Transitions(data.x.clone(), data.u, data.x_next.clone(), DT, data.segment)
    guess.x[:, 1] += 0.7
    guess.x_next[:, 1] += 0.7
    functions, rates = weak_form(theta, without(data, 1), guess, {1: 0}, 6)
    error = rates - functions @ XI
    torch.testing.assert_close(error, torch.tensor([-0.7, 0.0, -2.1]).double().expand_as(error))
    # What was measured is no matter of the guess: a rate that was measured is differentiated once.
    guess.x[:, 0] += torch.randn(60, generator=torch.Generator().manual_seed(0))
    again = weak_form(theta, data, guess, {1: 0}, 6)[1]
    torch.testing.assert_close(again, weak_form(theta, data, data, {}, 6)[1])


def test_no_row_reaches_over_two_segments_and_short_ones_have_short_bumps():
    parts = [chain(30, 5), chain(1, 6), chain(7, 7), chain(2, 8)]
    functions, rates = weak_form(theta, whole := Transitions.cat(parts), whole, {}, 5)
    torch.testing.assert_close(rates, functions @ XI)
    # A row needs two intervals; the bumps are of 9, 5 and 1 samples.
    apart = [weak_form(theta, part, part, {}, half) for part, half in zip(parts[::2] + parts[3:], (5, 3, 1))]
    torch.testing.assert_close(functions, torch.cat([f for f, _ in apart]))
    assert len(rates) == (29 - 9 + 1) + (6 - 5 + 1) + 1
    with pytest.raises(ValueError, match="two transitions"):
        weak_form(theta, parts[1], parts[1], {}, 5)


@pytest.mark.parametrize("half", [3, 8])
def test_the_weights_are_a_power_of_a_parabola_over_two_intervals_each(half):
    """A pulse of the input at one sample is seen with half the weights of the two intervals beside that sample's."""
    n, at = 41, 20
    u = torch.zeros(n, 1, dtype=torch.float64)
    u[at] = 1.0
    data = Transitions.from_trajectory(torch.zeros(n + 1, 3, dtype=torch.float64), u, DT)
    functions, _ = weak_form(theta, data, data, {}, half)
    weights = np.array([(1 - (j / half) ** 2) ** 4 for j in range(1 - half, half)])
    weights /= weights.sum()
    pulse = np.zeros(n - 1)
    pulse[[at - 1, at]] = 0.5
    expected = np.correlate(pulse, weights, "valid")[:: max(1, half // 4)]
    np.testing.assert_allclose(functions[:, -1].numpy(), expected, rtol=1e-12, atol=1e-15)
