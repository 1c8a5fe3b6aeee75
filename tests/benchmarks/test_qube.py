"""The published physics of the QUBE against the energy of its masses, and predictions of a plant that is known."""

import math

import numpy as np
import pytest
import torch
from benchmarks.qube import PublishedQube, ahead

from dynasindy.systems import rk4
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("theta", "alpha", "dtheta", "dalpha"), ("rad", "rad", "rad/s", "rad/s"), ("u",), (1, 0.2, 3, 3))


def energy(x: torch.Tensor) -> torch.Tensor:
    """Energy of the arm and of 2000 pieces of the pendulum, from where they are and how they move."""
    theta, alpha, dtheta, dalpha = x
    pieces = (torch.arange(2000, dtype=torch.float64) + 0.5) / 2000 * 0.129

    def places(t: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        out = pieces * torch.sin(a)
        return torch.stack(
            (
                0.085 * torch.cos(t) - out * torch.sin(t),
                0.085 * torch.sin(t) + out * torch.cos(t),
                pieces * torch.cos(a),
            )
        )

    velocity = torch.func.jvp(places, (theta, alpha), (dtheta, dalpha))[1]
    rod = 0.024 / 2000 * (0.5 * velocity.square().sum() + 9.81 * places(theta, alpha)[2].sum())
    return rod + 0.5 * 0.095 * 0.085**2 / 3 * dtheta.square()


def test_energy_changes_by_the_power_of_the_motor_alone():
    for x in torch.from_numpy(np.random.default_rng(0).normal(size=(5, 4)) * [1, 1, 5, 5]):
        u = torch.tensor([0.3], dtype=torch.float64)
        dx = PublishedQube(SIGNATURE)(x, u)
        gained = torch.func.jvp(energy, (x,), (dx,))[1]
        power = 0.042 * (10 * 0.3 - 0.042 * x[2]) / 8.4 * x[2]
        assert gained.item() == pytest.approx(power.item(), rel=1e-4, abs=1e-6)


def test_it_falls_from_upright_and_hangs_below():
    plant, rest = PublishedQube(SIGNATURE), torch.zeros(1)
    leaning = plant(torch.tensor([0.0, 0.01, 0.0, 0.0]), rest)[3]
    below = plant(torch.tensor([0.0, math.pi + 0.01, 0.0, 0.0]), rest)[3]
    assert leaning > 0 > below


def test_the_plant_itself_predicts_what_its_encoders_can_tell():
    plant, generator = PublishedQube(SIGNATURE), torch.Generator().manual_seed(0)
    x, states, inputs = torch.tensor([0.0, math.pi, 0.0, 0.0]).double(), [], []
    for _ in range(400):
        u = 0.1 * torch.randn(1, generator=generator).double()
        states.append(x)
        inputs.append(u)
        for _ in range(5):
            x = rk4(plant, x, u, 0.002)
    y = torch.full((401, 4), torch.nan, dtype=torch.float64)
    step = 2 * math.pi / 2048
    y[:, :2] = ((torch.stack([*states, x]) / step).round() * step)[:, :2]
    log = Transitions.from_trajectory(y, torch.stack(inputs), 0.01)
    errors, held = ahead(plant, log, log)
    moved = y[70:-81:10, :2] - y[50:-101:10, :2]  # from every 0.1 s after the first half second, 20 samples on
    torch.testing.assert_close(held[0], moved.square().mean(0).sqrt())
    assert errors.shape == held.shape == (2, 2)
    assert (errors < 0.2 * held).all() and (errors[0] < 5 * step).all()
