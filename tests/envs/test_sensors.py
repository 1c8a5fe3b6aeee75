"""What sensors make of true states."""

import math

import pytest
import torch

from dynasindy.agents import Hyperparameters
from dynasindy.dyna.simulated import Simulated
from dynasindy.envs import Channel, Sensors, TrackingReward
from dynasindy.evaluation.ablation import Level
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems import Pendulum, Signature

SIGNATURE = Signature(("a", "b", "c"), ("rad", "rad/s", "rpm"), ("u",), (1.0, 2.0, 1000.0))


def read(sensors, x, seed=0):
    return sensors.read(x, SIGNATURE, torch.Generator().manual_seed(seed))


def test_an_encoder_rounds_to_its_steps_and_what_has_no_sensor_is_nan():
    x = torch.tensor([[0.0, 5.0, 7.0], [0.24, 5.0, 7.0], [0.26, 5.0, 7.0], [-0.74, 5.0, 7.0]], dtype=torch.float64)
    y = read(Sensors({"a": {"resolution": 0.5}, "c": {}}), x)
    assert y[:, 0].tolist() == [0.0, 0.0, 0.5, -0.5]
    assert y[:, 1].isnan().all() and torch.equal(y[:, 2], x[:, 2])


def test_noise_is_white_with_its_deviation_and_that_of_its_seed():
    sensors = Sensors({"a": Channel(noise=0.1), "c": Channel(noise=20.0)})
    x = torch.ones(20_000, 3, dtype=torch.float64)
    error = (read(sensors, x) - x)[:, [0, 2]]
    torch.testing.assert_close(error.std(0), torch.tensor([0.1, 20.0]).double(), rtol=0.03, atol=0)
    neighbours = (error[1:] * error[:-1]).mean(0) / error.var(0)
    assert neighbours.abs().max() < 0.03 and torch.corrcoef(error.T)[0, 1].abs() < 0.03
    assert torch.equal(read(sensors, x, 1)[:, 0], read(sensors, x, 1)[:, 0])
    assert not torch.equal(read(sensors, x, 1)[:, 0], read(sensors, x, 2)[:, 0])


def test_a_lost_sample_is_lost_on_all_channels():
    y = read(Sensors({"a": {}, "b": {}, "c": {}}, lost=0.25), torch.zeros(4000, 3))
    gone = y.isnan()
    assert torch.equal(gone.all(-1), gone.any(-1))
    assert gone[:, 0].float().mean().item() == pytest.approx(0.25, abs=0.03)


def test_the_variance_is_that_of_noise_and_of_rounding():
    spread = Sensors({"a": {"resolution": 0.6}, "c": {"resolution": 0.6, "noise": 2.0}}).variance(SIGNATURE)
    assert spread.tolist() == [pytest.approx(0.03), math.inf, pytest.approx(4.03)]


def test_more_noise_is_added_in_squares_to_what_is_measured_and_to_nothing_else():
    sensors = Sensors({"a": {"resolution": 0.6}, "c": Channel(noise=3.0)}, delay=2, lost=0.1)
    louder = sensors.noisier({"b": 1.0, "c": 4.0})
    assert louder.variance(SIGNATURE).tolist() == [pytest.approx(0.03), math.inf, pytest.approx(25.0)]
    assert sensors.variance(SIGNATURE)[2] == pytest.approx(9.0) and (louder.delay, louder.lost) == (2, 0.1)


def test_a_plant_that_left_all_numbers_is_not_taken_for_a_lost_sample():
    y = read(Sensors({"a": {}}), torch.tensor([[math.nan, 0.0, 0.0], [0.0, math.inf, 0.0]]))
    assert y.isinf().tolist() == [[True, False, False], [False, True, False]]


def test_rates_are_those_entries_that_name_two_states():
    sensors = Sensors({"a": {}}, rates={"a": "b", "b": "sin(a)", "z": "c"})
    assert sensors.rate_indices(SIGNATURE) == {0: 1}


def test_exact_sensors_measure_all_states_as_they_are():
    signature = Pendulum().signature
    sensors = Sensors(dict.fromkeys(signature.state_names, Channel()))
    x = torch.tensor([[0.123456789, -4.0]], dtype=torch.float64)
    assert torch.equal(sensors.read(x, signature, torch.Generator().manual_seed(0)), x)
    assert sensors.variance(signature).tolist() == [0.0, 0.0]


def test_a_setting_that_does_not_exist_is_refused():
    for build, own in (
        (Sensors, {"channels": {"angle": {}}, "dely": 2}),
        (Refinement, {"windw": 2}),
        (Regression, {"treshold": 1.0}),
        (Simulated, {"sample": 2}),
        (Hyperparameters, {"gama": 0.9}),
        (TrackingReward, {"weight": 1.0}),
        (Level, {"errors": 0.1}),
    ):
        with pytest.raises(ValueError, match=[*own][-1]):
            build(**own)
