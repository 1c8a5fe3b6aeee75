"""Recordings of simulated plants follow the plant's setup, hold what falls, and have the noise of sensors."""

from functools import partial

import pytest
import torch
from plants import Plant, Upright

import dynasindy
from dynasindy.dyna import simulated
from dynasindy.envs import Aprbs, Chirp, Sensors
from dynasindy.sindy import Refinement, Regression, SindyModel

Simulated = partial(simulated.Simulated, substeps=2)
CHIRP = partial(Chirp, duration=None, band=None, amplitude=0.4)


LAG = Plant("x y", lambda x, y, u: [(u - x) / 100.0, (x - y) / 100.0])
"""As slow as a tank."""


def test_a_recording_follows_the_control_period_of_its_plant():
    source = Simulated(period=2.0, validation_seconds=80.0).load(LAG, CHIRP)
    data, unseen = source.training, source.validation
    assert (data.dt, len(data), unseen.dt, len(unseen)) == (pytest.approx(0.4), 1000, pytest.approx(0.4), 200)
    # Of a lag under a held input exp(-dt / 100) of the distance is left.
    left = torch.exp(torch.tensor(-0.4 / 100.0, dtype=torch.float64))
    torch.testing.assert_close(data.x_next[:, 0], data.u[:, 0] + left * (data.x[:, 0] - data.u[:, 0]))
    held = Aprbs(1, duration=80.0, dt=2.0, amplitude=0.28, seed=1).samples(0.4)
    torch.testing.assert_close(unseen.u, held)  # levels for ten control periods


def test_noise_may_be_what_a_sensor_has_in_the_unit_of_its_state():
    clean, noisy = (Simulated(noise=n, validation_seconds=1.0).load(LAG, CHIRP).training for n in (0.0, {"x": 0.03}))
    error = noisy.x_next - clean.x_next
    assert error[:, 0].std().item() == pytest.approx(0.03, rel=0.1) and not error[:, 1].any()
    assert torch.equal(noisy.x[1:], noisy.x_next[:-1])
    with pytest.raises(ValueError, match="names"):
        Simulated(noise={"z": 0.1}).load(LAG, CHIRP)


def test_sensors_of_the_bench_measure_what_they_do_as_finely_as_they_do():
    sensors = Sensors({"x": {"resolution": 0.01, "noise": 0.002}})
    settings = {"period": 2.0, "validation_seconds": 4.0}
    source = Simulated(**settings, sensors=sensors).load(LAG, CHIRP)
    exact = Simulated(**settings).load(LAG, CHIRP)
    seen = source.training.x_next
    assert seen[:, 1].isnan().all() and source.training.x[:, 1].isnan().all()
    steps = seen[:, 0] / 0.01
    torch.testing.assert_close(steps, steps.round(), atol=1e-6, rtol=0.0)
    error = seen[:, 0] - exact.training.x_next[:, 0]
    assert error.std().item() == pytest.approx((0.002**2 + 0.01**2 / 12) ** 0.5, rel=0.15)  # noise, and rounding
    assert torch.equal(source.validation.x_next, exact.validation.x_next)  # it judges by what is true


def test_a_plant_that_falls_is_held_within_its_bounds_and_found_without_bias():
    careful = partial(CHIRP, first=0.1)
    noise, bounds = {"theta": 1e-3, "Omega": 1e-2}, {"theta": 0.5}
    source = Simulated(bounds=bounds, noise=noise, validation_seconds=1.0).load(Upright(5.0, 8.0, 0.2), careful)
    exact = Simulated(bounds=bounds, validation_seconds=8.0).load(Upright(5.0, 8.0, 0.2), careful)
    for data in (exact.training, exact.validation):
        assert float(data.x[::5, 0].abs().max()) <= 0.5  # no period, of five samples, begins beyond
        lengths = data.segment.unique(return_counts=True)[1]
        assert int(lengths.max()) > 0.5 * len(data)  # most of it is one flight
    assert len(exact.training) == 1000 and len(exact.validation) == 800
    assert exact.validation.segment.unique().numel() == 1  # the regulator of the training holds it from the start
    assert [each.code for each in exact.findings] == ["excitation.restarts"]
    library = ["1", "sin(theta)", "Omega", "u"]
    model = SindyModel(source.signature, library, Regression("bic"), Refinement("trajectory"), known={"theta": "Omega"})
    model.fit(source.training)
    expected = torch.tensor([0.2, 5.0, 0.0, 8.0], dtype=torch.float64)
    torch.testing.assert_close(model.coefficients[:, 1], expected, atol=0.05, rtol=0.02)


def test_a_plant_that_falls_though_it_is_said_to_stay_is_held_too():
    source = Simulated(bounds={"theta": 0.5}, validation_seconds=1.0).load(Upright(5.0, 8.0, 0.2), CHIRP)
    assert len(source.training) == 1000 and [each.code for each in source.findings] == ["excitation.restarts"]
    assert float(source.training.x[::5, 0].abs().max()) <= 0.5


def test_bounds_that_exclude_the_start_are_refused_and_a_far_start_is_no_running_away():
    with pytest.raises(ValueError, match=r"^data\.start has theta .*data\.bounds"):
        Simulated(bounds={"theta": [0.5, 1.0]}).load(Upright(5.0, 8.0, 0.2), CHIRP)
    with pytest.raises(ValueError, match="Omega"):
        Simulated(bounds={"Omega": 1.0}, start={"Omega": [0.0, 2.0]}).load(Upright(5.0, 8.0, 0.2), CHIRP)
    plant = Plant("T", lambda x, u: [u - 0.1 * (x - 9000.0)], (2.0,))
    source = Simulated(start={"T": 9000.0}, period=0.5, validation_seconds=5.0).load(plant, CHIRP)
    assert source.findings == () and float(source.training.x.min()) > 8990.0


OSCILLATOR = Plant("x v", lambda x, v, u: [v, u - 4.0 * x], (10.0, 10.0))
"""A mass on a spring, of 2 rad/s, pushed by u."""


@pytest.mark.parametrize("substeps", [1, 5])
def test_a_plant_that_is_excited_as_in_training_has_the_samples_and_the_steps_that_were_asked_for(substeps):
    """Under a held input the mass circles about u / 4 by 2 dt = 1; s Runge-Kutta steps miss s^-4 / 5! of it."""
    careful = partial(CHIRP, duration=20.0, first=0.5)
    source = Simulated(dt=0.5, period=1.0, substeps=substeps, validation_seconds=5.0).load(OSCILLATOR, careful)
    turn = torch.tensor([[0.0, -1.0], [1.0, 0.0]], dtype=torch.float64).matrix_exp()
    for data, count in ((source.training, 40), (source.validation, 10)):
        assert (data.dt, len(data), data.substeps) == (0.5, count, 2)
        assert torch.equal(data.x[1:], data.x_next[:-1]) and torch.equal(data.u[::2], data.u[1::2])
        before, after = (torch.stack((2 * x[:, 0] - data.u[:, 0] / 2, x[:, 1]), -1) for x in (data.x, data.x_next))
        missed = (after - before @ turn).norm(dim=-1) / before.norm(dim=-1)
        torch.testing.assert_close(missed, torch.full_like(missed, substeps**-4 / 120), rtol=0.02, atol=0.0)


def test_a_plant_is_excited_in_its_own_time_and_in_steps_that_it_needs():
    data = dynasindy.excite(OSCILLATOR, dt=5.0, start={"x": 2.0}).training
    assert len(data) == 1000 and data.x[0].tolist() == [2.0, 0.0]
    (x, v), rest, turn = data.x.mT, data.u[:, 0] / 4, torch.tensor(10.0)
    expected = rest + (x - rest) * turn.cos() + v / 2 * turn.sin()  # ten steps would miss it by a twelfth
    torch.testing.assert_close(data.x_next[:, 0], expected, atol=0.01, rtol=0.0)
