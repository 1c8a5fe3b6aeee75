"""The Feedback rig rests, hovers and turns as its authors measured."""

import pytest
import torch

from dynasindy.systems.integrators import rk4
from dynasindy.systems.trms33 import Trms33


def test_without_voltage_the_beam_rests_at_its_published_pitch():
    """Gravity vanishes where tan(psi) = G_y / G_z, -0.537 rad."""
    x, u = torch.zeros(6, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    x[1] = -0.537
    assert float(Trms33()(x, u).abs().max()) < 1e-2
    x[1] = -0.5
    assert float(Trms33()(x, u)[3]) < -0.1


def test_energy_of_the_swinging_beam_is_lost_by_friction_alone():
    """Without rotors and voltage, kinetic plus potential energy falls and never rises."""
    x, u = torch.zeros(6, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    x[1] = -0.2
    energies = []
    for _ in range(300):
        x = rk4(Trms33(), x, u, 0.01)
        x[4:] = 0.0
        psi = x[1]
        potential = 0.25254 * torch.cos(psi) * -1 + 0.15032 * torch.sin(psi)
        energies.append(float(0.5 * 6.1644e-2 * x[3] ** 2 + potential))
    assert energies[-1] < energies[0]
    assert max(b - a for a, b in zip(energies, energies[1:])) < 2e-5


def test_top_speeds_are_those_of_the_rig():
    plant, u = Trms33(), torch.ones(2, dtype=torch.float64)
    x = torch.zeros(6, dtype=torch.float64)
    for _ in range(4000):
        x[:4] = 0.0
        x[4:] = rk4(plant, x, u, 0.005)[4:]
    assert float(x[5]) == pytest.approx(2700, rel=0.06)
    assert float(x[4]) == pytest.approx(4060, rel=0.06)


def test_stops_that_are_not_positive_are_refused():
    with pytest.raises(ValueError, match="positive"):
        Trms33(pitch_stop=0.0)
