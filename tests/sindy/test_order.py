"""A state that goes on by itself misses its rate; one that follows its inputs, however late or bent, does not."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import polynomial
from dynasindy.sindy.reconstruction import find_missing_rates
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

DT, N = 0.02, 600
ONE = Signature(("y",), ("-",), ("u",), (1.0,))
TWO = Signature(("y", "v"), ("-", "-"), ("u",), (1.0, 1.0))


def recorded(rate, size, columns, late=0, noise=0.0):
    """Integrate `size` states by scipy under inputs held for ten samples that act `late` samples later."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, N // 10), 10)
    acting = np.concatenate([np.full(late, u[0]), u])[:N]
    x, samples = np.full(size, 0.3), []
    edges = [0, *(np.flatnonzero(np.diff(acting)) + 1), N - 1]
    for k, end in pairwise(edges):
        times = DT * np.arange(end - k + 1)
        found = solve_ivp(lambda t, x: rate(x, acting[k]), times[[0, -1]], x, t_eval=times, rtol=1e-9, atol=1e-12)  # noqa: B023
        samples.append(found.y[:, :-1].T)
        x = found.y[:, -1]
    samples.append(x[None])
    x = np.concatenate(samples)[:, columns]
    x = x + noise * x.std(0) * rng.normal(size=x.shape)
    return Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u[:-1, None]), DT)


def swing(x, u):
    return np.array([x[1], 12 * u - 9.81 * np.sin(x[0]) - 0.5 * x[1]])


def lag(x, u):
    return np.array([3 * u - 2 * np.sqrt(np.abs(x[0])) * np.sign(x[0])])


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_an_angle_alone_misses_its_rate(noise):
    assert find_missing_rates(polynomial(ONE), recorded(swing, 2, [0], noise=noise)) == ["y"]


def test_a_difference_equation_misses_no_rate():
    """What follows from an angle and the one before is a state more to it, and no rate."""
    assert find_missing_rates(polynomial(ONE).with_step(DT), recorded(swing, 2, [0])) == []


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_an_angle_with_its_rate_misses_nothing(noise):
    assert find_missing_rates(polynomial(TWO), recorded(swing, 2, [0, 1], noise=noise)) == []


@pytest.mark.parametrize("late", [0, 1])
def test_a_first_order_plant_misses_nothing_though_its_root_is_no_polynomial(late):
    assert find_missing_rates(polynomial(ONE), recorded(lag, 1, [0], late=late)) == []


def test_a_state_that_was_not_measured_is_not_judged():
    data = recorded(swing, 2, [0])
    data.x[:, 0] = torch.nan
    assert find_missing_rates(polynomial(ONE), data) == []


def test_a_delay_is_not_made_up_where_a_rate_is_missing():
    """The inputs act at once; a delay of the first-order model would be the best that stands for its rate."""
    model = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=0.1))
    report = model.fit(recorded(swing, 2, [0]))
    assert model.delay == 0
    assert any("stand" in note for note in report.notes)


def test_a_delay_at_the_end_of_what_was_looked_for_is_said_to_be_one():
    """The inputs act 0.06 s late; 0.04 s at most are looked for."""
    data = recorded(lambda x, u: np.array([3 * u - 2 * x[0]]), 1, [0], late=3)
    model = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=2 * DT))
    report = model.fit(data)
    assert model.delay == pytest.approx(0.04)
    assert any("longest_delay=0.08" in note for note in report.notes)
    longer = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=5 * DT))
    assert not any("at the end" in note for note in longer.fit(data).notes)
    assert longer.delay == pytest.approx(0.06)


@pytest.mark.parametrize("substeps", [1, 2])
def test_without_a_time_a_delay_beyond_two_control_periods_is_found_where_a_regression_tells_it(substeps):
    """The inputs act three samples, 0.06 s, late; a control period has one or two samples."""
    data = replace(recorded(lambda x, u: np.array([3 * u - 2 * x[0]]), 1, [0], late=3), substeps=substeps)
    model = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=None))
    model.fit(data)
    assert model.delay == pytest.approx(0.06)


def test_a_recording_of_a_few_samples_is_not_judged():
    assert find_missing_rates(polynomial(ONE), recorded(swing, 2, [0]).select(torch.arange(N - 1) < 7)) == []


def lossy(data: Transitions, kept: np.ndarray, column: int = 0) -> Transitions:
    """Lose the samples of a state that are not kept, bool `(N + 1,)`."""
    x = torch.cat([data.x, data.x_next[-1:]])
    x[torch.from_numpy(~kept), column] = torch.nan
    return Transitions.from_trajectory(x, data.u, data.dt)


@pytest.mark.parametrize("kept", [np.random.default_rng(1).random(N) > 0.1, np.arange(N) % 3 == 0])
def test_lost_samples_hide_neither_a_missing_rate_nor_one_that_is_there(kept):
    assert find_missing_rates(polynomial(ONE), lossy(recorded(swing, 2, [0]), kept)) == ["y"]
    assert find_missing_rates(polynomial(TWO), lossy(recorded(swing, 2, [0, 1]), kept)) == []
    assert find_missing_rates(polynomial(ONE), lossy(recorded(lag, 1, [0]), kept)) == []
