"""The time between an input and its effect is found in fractions of a sample, against the closed form of a delay."""

import math

import numpy as np
import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.library import Library, variable
from dynasindy.sindy.refinement import _refined_delay
from dynasindy.sindy.regression import integral_form
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u")])
A, B, DT = -2.0, 3.0, 0.02


def motion(u: np.ndarray, delay: float, before: float = 0.0) -> np.ndarray:
    """Exact states of y' = A y + B u(t - delay) from 0, u held from sample to sample and `before` until the first."""
    whole, part = divmod(delay / DT, 1.0)
    late = np.concatenate([np.full(int(whole) + 1, before), u])
    y, states = 0.0, [0.0]
    for k in range(len(u)):
        for held, span in ((late[k], part * DT), (late[k + 1], (1 - part) * DT)):
            phi = math.exp(A * span)
            y = phi * y + B * (phi - 1) / A * held
        states.append(y)
    return np.array(states)


def recording(delay: float, seed: int = 0, n: int = 200, before: float = 0.0, noise: float = 0.0) -> Transitions:
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, n)
    y = motion(u, delay, before) + noise * rng.normal(size=n + 1)
    return Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(u)[:, None], DT)


def coefficients(data: Transitions) -> list[float]:
    theta, dx = integral_form(LIBRARY, data)
    return np.linalg.lstsq(theta.numpy(), dx[:, 0].numpy(), rcond=None)[0].tolist()


def test_inputs_come_later_by_whole_samples_and_fractions_of_them():
    u = torch.tensor([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0], [8.0, 80.0], [16.0, 160.0]])
    one = Transitions.from_trajectory(torch.arange(6.0)[:, None], u, 0.5)
    data = Transitions.cat([one, one.select(torch.arange(5) >= 3)])
    later = delay_inputs(data, 1.0)
    # Two samples later; before the first sample of a segment its first input held.
    assert later.u[:, 0].tolist() == [1, 1, 1, 2, 4, 8, 8]
    assert later.u[:, 1].tolist() == [10, 10, 10, 20, 40, 80, 80]
    # A quarter of a sample: in each interval the input before for a quarter of the time.
    assert delay_inputs(data, 0.125).u[:, 0].tolist() == [1, 1.75, 3.5, 7, 14, 8, 14]
    assert delay_inputs(data, 0.625).u[:, 0].tolist() == [1, 1, 1.75, 3.5, 7, 8, 8]
    assert torch.equal(later.x, data.x) and torch.equal(later.x_next, data.x_next)
    assert delay_inputs(data, 0.0) is data
    with pytest.raises(ValueError, match=r"-0\.1 s"):
        delay_inputs(data, -0.1)


@pytest.mark.parametrize("delay", [0.0, 0.4 * DT, 2 * DT, 2.7 * DT])
def test_under_the_true_delay_the_recording_is_that_of_the_plant(delay):
    data = recording(delay)
    assert coefficients(delay_inputs(data, delay)) == pytest.approx([A, B], rel=0.01)
    assert abs(coefficients(delay_inputs(data, delay + 0.3 * DT))[1] / B - 1) > 0.03


def test_a_delay_that_is_worth_little_is_none_and_none_is_longer_than_allowed():
    def cost(delay: float) -> float:
        return 1e4 * (delay - 0.03) ** 2

    assert _refined_delay(0.02, DT, 0.1, 8.9, cost) == pytest.approx(0.03)
    assert _refined_delay(0.02, DT, 0.1, 9.1, cost) == 0.0
    assert _refined_delay(0.0, DT, 0.1, 1.0, lambda delay: 100 * delay) == 0.0
    assert _refined_delay(0.04, DT, 0.1, 1.0, lambda delay: -100 * delay) == pytest.approx(0.1)


@pytest.mark.parametrize("delay", [0.0, 2.4 * DT])
def test_a_fit_finds_the_delay_and_the_plant_whatever_was_put_in_before(delay):
    # Before the recording an input of 5 that it does not tell of; two segments.
    parts = [recording(delay, seed, 150, 5.0, 0.002) for seed in (1, 2)]
    model = SindyModel(SIGNATURE, LIBRARY, Regression("bic"), Refinement("trajectory", longest_delay=5 * DT))
    model.fit(Transitions.cat(parts))
    assert model.delay == pytest.approx(delay, abs=0.03 * DT)
    assert model.coefficients[:, 0].tolist() == pytest.approx([A, B], rel=0.01)


def unexplained(data: Transitions, xi: list[float], late: int) -> float:
    """The part of the rate that A y + B u leaves over, u that of `late` samples before, by numpy."""
    y, u = data.x[:, 0].numpy(), data.u[:, 0].numpy()
    after, n = data.x_next[:, 0].numpy(), len(y) - late
    rate, mean = (after - y)[late:] / DT, 0.5 * (y + after)[late:]
    return float(np.linalg.norm(rate - xi[0] * mean - xi[1] * u[:n]) / np.linalg.norm(rate))


def test_the_report_judges_a_model_under_the_inputs_of_its_delay():
    model = SindyModel(SIGNATURE, LIBRARY, Regression("bic"), Refinement("integral", longest_delay=5 * DT))
    data = recording(3 * DT)
    report = model.fit(data)
    assert model.delay == pytest.approx(3 * DT)
    # Nothing but the error of the trapezoidal rule is left; without the delay it would be nearly everything.
    assert report.residual["y"] == pytest.approx(unexplained(data, model.coefficients[:, 0].tolist(), 3), rel=1e-6)
    assert report.residual["y"] < 0.01 < 0.5 < unexplained(data, model.coefficients[:, 0].tolist(), 0)
    assert report.samples == 197
    model.refinement = None
    model.fit(recording(0.0))
    assert model.delay == 0.0 and model.coefficients[:, 0].tolist() == pytest.approx([A, B], rel=0.01)


def excited(delay: float) -> Transitions:
    """States of y' = A y + B u(t - delay) under sines that are held for five samples, as by a period."""
    t = np.repeat(5 * DT * np.arange(100), 5)
    u = sum(np.sin(2 * np.pi * f * t + p) for f, p in ((0.1, 0.3), (0.3, 2.0), (0.5, 4.0), (0.8, 1.0))) / 3
    return Transitions.from_trajectory(torch.from_numpy(motion(u, delay))[:, None], torch.from_numpy(u)[:, None], DT)


def model(longest: float | None) -> SindyModel:
    return SindyModel(SIGNATURE, LIBRARY, Regression("bic"), Refinement("integral", longest_delay=longest))


@pytest.mark.parametrize("samples", [0.0, 7.5, 33.0])
def test_a_delay_that_nobody_states_is_found_however_long_it_is(samples):
    found = model(None)
    found.fit(excited(samples * DT))
    assert found.delay == pytest.approx(samples * DT, abs=0.05 * DT)
    assert found.coefficients[:, 0].tolist() == pytest.approx([A, B], rel=0.01)
