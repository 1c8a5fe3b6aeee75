"""What recordings show: steps of sensors and noise, of signals made to show them."""

import numpy as np
import pytest
import torch

from dynasindy.identification.recording_diagnostics import (
    resolution,
    resolutions,
    sensor_resolution,
)
from dynasindy.systems.transitions import Transitions

T = 0.01 * np.arange(3000)


@pytest.mark.parametrize("step", [0.0015, 0.02])
def test_the_step_of_an_encoder_is_found_and_exact_or_noisy_samples_have_none(step):
    swing = np.sin(1.3 * T) + 0.4 * np.sin(0.37 * T)
    assert sensor_resolution(step * np.round(swing / step)) == pytest.approx(step, rel=1e-6)
    assert sensor_resolution(swing) == 0.0
    noisy = swing + 0.01 * np.random.default_rng(0).normal(size=3000)
    assert sensor_resolution(noisy) == 0.0 and resolution(noisy) == pytest.approx(0.01, rel=0.1)
    assert sensor_resolution(np.round(noisy, 6)) == 0.0  # six decimals of a file are no sensor's step


@pytest.mark.parametrize("interval", [0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_what_a_plant_does_between_samples_that_are_far_apart_is_no_noise_of_its_sensor(interval, noise):
    """x' = u + 0.4 u^2 - x under held inputs: x[k+1] = a x[k] + (1 - a) (u + 0.4 u^2), a = exp(-interval)."""
    generator, left = np.random.default_rng(0), np.exp(-interval)
    u, x = generator.uniform(-1, 1, 800), [0.0]
    for held in u:
        x.append(left * x[-1] + (1 - left) * (held + 0.4 * held**2))
    read = np.array(x) + noise * generator.normal(size=801)
    data = Transitions.from_trajectory(torch.tensor(read)[:, None], torch.tensor(u)[:, None], interval)
    told = float(resolutions(data)[0])
    assert resolution(read) > 0.02 * np.std(x)  # a cubic alone cannot follow what jumps with each input
    # What is left over has the noise of this sample and, through `a`, that of the last one.
    assert noise * 0.9 < told < noise * 1.1 * np.sqrt(1 + left**2) + 1e-9


def test_noise_of_samples_that_are_close_is_what_no_cubic_follows_and_a_step_stays_a_step():
    swing = np.sin(1.3 * T) + 0.4 * np.sin(0.37 * T)
    noisy = swing + 0.01 * np.random.default_rng(0).normal(size=3000)
    read = torch.tensor(np.stack([noisy, 0.02 * np.round(swing / 0.02), np.full(3000, np.nan)], -1))
    told = resolutions(Transitions.from_trajectory(read, torch.zeros(2999, 1).double(), 0.01)).tolist()
    assert told[0] == pytest.approx(resolution(noisy), rel=1e-6) and told[1] == pytest.approx(0.02, rel=1e-6)
    assert np.isnan(told[2])


def test_the_noise_of_what_jumps_is_told_by_past_samples():
    """x+ = -0.6 x + u, seen with noise of 0.02: a cubic takes the jumps themselves for noise."""
    rng, n = np.random.default_rng(3), 3000
    u, x = rng.standard_normal(n), np.zeros(n + 1)
    for k in range(n):
        x[k + 1] = -0.6 * x[k] + u[k]
    seen = torch.from_numpy(x + 0.02 * rng.standard_normal(n + 1)).unsqueeze(-1)
    data = Transitions.from_trajectory(seen, torch.from_numpy(u).unsqueeze(-1), 0.1)
    assert resolution(seen[:, 0].numpy()) > 0.3
    assert resolutions(data).tolist() == pytest.approx([0.02], rel=0.1)
