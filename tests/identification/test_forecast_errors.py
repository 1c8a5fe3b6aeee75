"""Errors over horizons are those of formulas: start states of an oscillator, a random walk held, a linear model."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from plants import held_motion, scipy_motion
from scipy.linalg import expm

from dynasindy.identification.forecast_errors import (
    LinearModel,
    characteristic,
    estimate,
    forecast_errors,
    predict_ahead,
    starting_states,
)
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("q", "v"), ("m", "m/s"), ("u",), (1.0, 1.0))
DT, OMEGA = 0.02, 3.0


def oscillator(delay: float = 0.0) -> SindyModel:
    model = SindyModel(SIGNATURE, ["q", "v", "u"], known={"q": "v"})
    model.set_coefficients(torch.tensor([[0.0, -(OMEGA**2)], [1.0, 0.0], [0.0, 1.0]]))
    model.delay = delay
    return model


def recording(n: int = 1500, seed: int = 0, noise: float = 0.0, delay: int = 0) -> tuple[Transitions, np.ndarray]:
    """q'' = -9 q + u, solved exactly between samples; v is not measured."""
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.uniform(-5, 5, n // 10), 10)
    c, s = math.cos(OMEGA * DT), math.sin(OMEGA * DT)
    x = np.zeros((n + 1, 2))
    x[0] = 0.7, -0.4
    for k in range(n):
        rest = u[max(0, k - delay)] / OMEGA**2
        q, v = x[k, 0] - rest, x[k, 1] / OMEGA
        x[k + 1] = rest + c * q + s * v, OMEGA * (c * v - s * q)
    seen = torch.tensor(np.stack([x[:, 0] + noise * generator.normal(size=n + 1), np.full(n + 1, np.nan)], -1))
    return Transitions.from_trajectory(seen, torch.tensor(u[:, None]), DT), x


def test_a_state_that_no_sensor_sees_is_estimated_from_the_samples_before():
    data, x = recording()
    rows = torch.tensor([100, 400])
    begin, end = estimate(oscillator(), data, rows, 25)
    assert np.allclose(begin, x[[100, 400]], atol=1e-5) and np.allclose(end, x[[125, 425]], atol=1e-5)


def test_a_step_that_leads_too_far_does_not_end_the_fit_of_a_start_state():
    u = np.repeat(np.random.default_rng(0).uniform(-1.5, 1.5, 40), 20)
    x = scipy_motion(lambda t, x, u: [x[1], -9 * np.sin(x[0]) - 0.1 * x[1] + 5 * u[0]], [0.5, -3.0], u[:, None], 0.05)
    seen = torch.from_numpy(np.stack([x[:, 0], np.full(len(x), np.nan)], 1))
    data = Transitions.from_trajectory(seen, torch.from_numpy(u[:, None]), 0.05)
    model = SindyModel(Signature(("q", "v"), ("rad", "rad/s"), ("u",), (2.0, 5.0)), ["v", "sin(q)", "u"])
    model.set_coefficients(torch.tensor([[1.0, -0.1], [0.0, -9.0], [0.0, 5.0]]))
    for row in (0, 120, 510, 660):
        begin, _ = estimate(model, data, torch.tensor([row]), 80)
        assert begin[0].tolist() == pytest.approx(x[row], abs=1e-2)


def test_a_linear_model_is_fitted_to_a_recording_too_short_to_compare_orders():
    """Of q[k+1] = 2 cos(w dt) q[k] - ... one past sample alone tells nearly all, as a step is short."""
    data, _ = recording(60)
    model = LinearModel.fit(data, 50, 16)
    assert model.order == 1 and abs(float(model.weights[0, 0]) - 1) < 0.1


@pytest.mark.parametrize("starts", [[30], [30, 400, 1390]])
def test_a_plant_is_predicted_from_its_past_samples(starts):
    data, x = recording(delay=2)
    path = predict_ahead(oscillator(2 * DT), data, data, torch.tensor(starts), 100)
    assert np.allclose(path, x[np.array(starts)[:, None] + np.arange(1, 101)], atol=1e-4)


def test_a_start_is_estimated_on_its_own_past_however_early_others_are():
    data, _ = recording(noise=0.01)
    late, both = (predict_ahead(oscillator(), data, data, torch.tensor(s), 50)[-2:] for s in ([30, 400], [3, 30, 400]))
    torch.testing.assert_close(late, both)


def test_states_of_a_plant_with_process_noise_are_those_of_a_kalman_filter():
    rng, a, noise, error = np.random.default_rng(0), expm(DT * np.array([[0, 1], [-(OMEGA**2), 0]])), 0.3, 0.01
    x, seen = np.zeros((401, 2)), np.zeros(401)
    for k in range(400):
        x[k + 1] = a @ x[k] + [0.0, noise * math.sqrt(DT) * rng.normal()]
        seen[k + 1] = x[k + 1, 0] + error * rng.normal()
    y = torch.from_numpy(np.stack([seen, np.full(401, np.nan)], -1))
    data, model, rows = Transitions.from_trajectory(y, torch.zeros(400, 1), DT), oscillator(), np.arange(100, 400, 10)
    drawn, p = np.diag([0.0, noise**2 * DT]), np.diag([error**2, 1.0])
    for _ in range(1000):  # Riccati's equation, by its own steps
        ahead = a @ p @ a.T + drawn
        gain = ahead[:, :1] / (ahead[0, 0] + error**2)
        p = ahead - gain @ ahead[:1]
    expected = np.zeros((401, 2))
    for k in range(400):
        now = a @ expected[k]
        expected[k + 1] = now + gain[:, 0] * (seen[k + 1] - now[0])
    model.process_noise = noise
    found = starting_states(model, data, torch.from_numpy(rows), 90, torch.tensor([error, math.nan]))
    assert found.numpy() == pytest.approx(expected[rows], abs=1e-4)
    model.process_noise = 0.0
    simulated = starting_states(model, data, torch.from_numpy(rows), 90, torch.tensor([error, math.nan])).numpy()
    assert 2 * np.abs(found.numpy() - x[rows]).mean() < np.abs(simulated - x[rows]).mean()


def test_noise_of_the_sensor_is_averaged_over_the_fit():
    data, x = recording(noise=0.01)
    rows = torch.arange(50, 1400, 50)
    begin, _ = estimate(oscillator(), data, rows, 25)
    # Two unknowns of 26 samples each: a straight line's ends have a standard deviation of about 2 / sqrt(26).
    assert float((begin[:, 0] - torch.tensor(x[rows, 0])).std()) < 0.01 * 2 / math.sqrt(26) * 1.3


@pytest.mark.parametrize("delay", [0, 3])
def test_the_right_model_has_the_noise_for_its_error_over_all_horizons(delay):
    data, _ = recording(noise=0.01, delay=delay)
    found = forecast_errors(oscillator(delay * DT), data, data, [0.1, 1.0, 4.0])
    assert found is not None and found.horizons == pytest.approx((0.1, 1.0, 4.0)) and found.starts == 200
    # Noise of the sensor, and that of a start from ten samples, which an undamped swing keeps.
    assert bool(((found.model[:, 0] > 0.009) & (found.model[:, 0] < 0.017)).all())
    assert bool(found.model[:, 1].isnan().all())
    assert float(found.resolution[0]) == pytest.approx(0.01, rel=0.15)
    if delay:
        wrong = forecast_errors(oscillator(), data, data, [0.1, 1.0, 4.0])
        assert wrong is not None and float(wrong.model[1, 0]) > 0.03


def test_what_sensors_can_tell_of_a_map_is_what_the_map_leaves_over():
    """x[k+1] = 0.9 cos(4 x[k]) + 0.3 u[k] without noise: neither a cubic nor a square of past samples follows it."""
    rng, x = np.random.default_rng(3), [0.0]
    u = rng.uniform(-1, 1, 1200)
    for held in u:
        x.append(0.9 * math.cos(4 * x[-1]) + 0.3 * held)
    data = Transitions.from_trajectory(torch.tensor(x, dtype=torch.float64)[:, None], torch.from_numpy(u)[:, None], 0.5)
    model = SindyModel(Signature(("x",), ("-",), ("u",), (1.0,)), ["x", "cos(4 x)", "u"], time="discrete")
    model.library = model.library.with_step(0.5)
    model.set_coefficients(torch.tensor([[-1.0], [0.9], [0.3]], dtype=torch.float64) / 0.5)
    told = forecast_errors(model, data.select(torch.arange(1200) < 900), data.select(torch.arange(1200) >= 900))
    assert float(told.resolution) < 1e-6


def test_horizons_are_round_times_from_a_tenth_to_three_times_the_time_in_which_the_plant_changes():
    data, _ = recording()
    found = forecast_errors(oscillator(), data, data)
    assert found is not None and 0.34 < found.characteristic < 0.5  # a swing changes by its spread in pi / 3 / 3 s
    assert found.horizons == pytest.approx((0.04, 0.1, 0.2, 0.5, 1.0))  # 0.05 s are two samples and a half


def test_the_error_of_the_last_value_held_on_a_random_walk_is_that_of_its_steps():
    walk = torch.from_numpy(np.random.default_rng(0).normal(size=(60_000, 1)).cumsum(0))
    data = Transitions.from_trajectory(torch.cat([walk, walk * math.nan], -1), torch.zeros(60_000, 1), DT)
    found = forecast_errors(oscillator(), data, data, [10 * DT, 40 * DT])
    assert found is not None
    for k, n in enumerate((10, 40)):  # mean of 1 .. n steps of variance one
        assert float(found.held[k, 0]) == pytest.approx(math.sqrt((n + 1) / 2), rel=0.15)


def test_lost_samples_do_not_count_and_the_last_measured_value_is_held():
    """Of a straight line of slope one every third sample is measured, so the next one is always three steps on."""
    line = DT * torch.arange(3001, dtype=torch.float64)
    line[torch.arange(3001) % 3 > 0] = math.nan
    data = Transitions.from_trajectory(torch.stack([line, line * math.nan], -1), torch.zeros(3000, 1), DT)
    found = forecast_errors(oscillator(), data, data, [3 * DT])
    assert found is not None and bool(found.linear.isnan().all()) and bool(found.model.isfinite()[:, 0].all())
    assert float(found.held[0, 0]) == pytest.approx(3 * DT)


def test_a_model_that_runs_away_has_an_infinite_error():
    model, (data, _) = oscillator(), recording(600)
    model.set_coefficients(torch.tensor([[0.0, 4e4], [1.0, 0.0], [0.0, 1.0]]))
    found = forecast_errors(model, data, data, [0.1, 4.0])
    assert found is not None and float(found.model[1, 0]) > 1e6


def test_a_sine_changes_by_its_spread_in_a_sixth_of_its_period():
    t = DT * torch.arange(3001, dtype=torch.float64)
    x = torch.stack([torch.sin(t), torch.sin(7 * t)], -1)
    # |sin(t + h) - sin t| is 2 sin(h/2) rms / sqrt 2, the spread 1 / sqrt 2: h = pi / 3.
    data = Transitions.from_trajectory(x, x[:, :1], DT)
    assert characteristic(data, SIGNATURE) == pytest.approx(math.pi / 3, rel=0.15)


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * math.pi), ("deg", 360.0)])
def test_an_angle_that_turns_over_changes_by_the_spread_of_a_turn(unit, turn):
    x = 0.5 * turn * DT * torch.arange(3001, dtype=torch.float64).unsqueeze(-1)  # half a turn a second
    signature = Signature(("q",), (unit,), ("u",), (1.0,))
    # Whatever is anywhere in a turn alike has a spread of a turn by the root of 12.
    assert characteristic(Transitions.from_trajectory(x, x, DT), signature) == pytest.approx(2 / 12**0.5, rel=0.15)


def second_order(n: int = 300) -> Transitions:
    """y[k+1] = 1.2 y[k] - 0.5 y[k-1] + 0.7 u[k] - 0.2 u[k-1] + 0.1, and a state that nobody measured."""
    u = np.random.default_rng(0).normal(size=n)
    y = [0.0, 0.3]
    for k in range(1, n):
        y.append(1.2 * y[k] - 0.5 * y[k - 1] + 0.7 * u[k] - 0.2 * u[k - 1] + 0.1)
    x = torch.full((n + 1, 2), torch.nan, dtype=torch.float64)
    x[:, 0] = torch.tensor(y)
    return Transitions.from_trajectory(x, torch.from_numpy(u)[:, None], 0.1)


def lossy(share: float = 0.1) -> Transitions:
    """The recurrence, of which some samples of y were lost."""
    data, lost = second_order(), torch.from_numpy(np.random.default_rng(1).random(301) < share)
    x = torch.cat([data.x, data.x_next[-1:]])
    x[lost, 0] = torch.nan
    return Transitions.from_trajectory(x, data.u, data.dt)


def test_lost_samples_cost_their_rows_and_nothing_else():
    data = lossy()
    model = LinearModel.fit(data, 10, 2)
    assert model.order == 2 and model.seen.tolist() == [True, False]
    assert model.weights.flatten().tolist() == pytest.approx([1.2, -0.5, 0.7, -0.2, 0.1], abs=1e-9)
    starts = torch.arange(5, 200)
    predicted = model.predict(data, starts, starts.unsqueeze(-1) + torch.arange(10))[..., 0]
    lost = (data.x[starts, 0].isnan() | data.x[starts - 1, 0].isnan()).numpy()
    real = second_order().x_next[starts.unsqueeze(-1) + torch.arange(10), 0]
    assert lost.any() and bool(predicted[torch.from_numpy(lost)].isnan().all())
    assert torch.allclose(predicted[torch.from_numpy(~lost)], real[torch.from_numpy(~lost)], atol=1e-6)


def test_a_fast_oscillation_is_predicted_as_exactly_as_its_equations_are():
    """Of y'' = -400 y - y' + 400 u sampled 9 times a turn, against the matrix exponential."""
    dt, u = 0.035, np.random.default_rng(0).uniform(-1, 1, 300)
    x = held_motion([[0.0, 1], [-400, -1]], [[0.0], [400]], [0, 0], u, dt)
    y = torch.from_numpy(x[:, :1]).contiguous()
    data = Transitions.from_trajectory(y, torch.from_numpy(u)[:, None], dt)
    both = (torch.nn.functional.pad(each, (0, 1), value=math.nan) for each in (data.x, data.x_next))
    data = replace(data, **dict(zip(("x", "x_next"), both, strict=True)))
    signature = Signature(("y", "v"), ("m", "m/s"), ("u",), (2.0, 40.0))
    model = SindyModel(signature, ["y", "v", "u"], known={"y": "v"})
    model.set_coefficients(torch.tensor([[0.0, -400], [1, -1], [0, 400]]).double())
    early = torch.arange(300) < 200
    found = forecast_errors(model, data.select(early), data.select(~early), [0.35])
    assert float(found.model[0, 0]) < 1e-3 * float(y.std())
