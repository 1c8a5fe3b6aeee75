"""The Feedback rig rests, hovers and turns as its authors measured, and moves by Lagrange's equations."""

import math

import pytest
import sympy
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


# Azimuth, pitch, their rates, tail and main rotor [rpm]; both senses of both rotors.
POINTS = [
    ([0.3, 0.4, 0.7, -0.5, 3000.0, 1500.0], [0.3, -0.6]),
    ([-1.2, -0.7, -0.09, 0.08, -2500.0, 2000.0], [-0.8, 0.5]),
    ([2.0, 0.9, 1.3, 0.03, 1200.0, -1800.0], [0.9, 0.4]),
    ([0.1, -0.2, -0.02, -1.1, -3600.0, -900.0], [-0.2, -0.3]),
]


def lagrange(x, u):
    """Accelerations of azimuth, pitch, tail rotor and main rotor, by SymPy from energies and forces.

    The constants are those of Tastemirov, Lecchini-Visintini and Morales (2017). The spin of a rotor in space is its
    speed in the beam plus the beam's rate about the rotor's axis; drag works on that spin, a motor on the speed in the
    beam.
    """
    q = sympy.symbols("phi psi theta_t theta_m")
    v = sympy.symbols("dphi dpsi w_t w_m")
    (phi, psi, _, _), (dphi, dpsi, w_t, w_m) = q, v
    c, s = sympy.cos(psi), sympy.sin(psi)
    body = (2.1117e-2 + (8.3286e-2 - 1.7249e-4) * c**2) * dphi**2 / 2 + (6.1644e-2 - 3.2170e-5) * dpsi**2 / 2
    product = -(-1.9525e-3 * c + 6.6120e-3 * s) * dphi * dpsi
    spins = 1.7249e-4 * (w_m + c * dphi) ** 2 / 2 + 3.2170e-5 * (w_t + dpsi) ** 2 / 2
    kinetic = body + product + spins
    potential = -0.25254 * c + 0.15032 * s + 9.8664e-3 * phi**2 / 2
    state = [*x[:4], *(2 * math.pi / 60 * rpm for rpm in x[4:])]
    tail, main = state[4], state[5]
    drag_t, drag_m = 9.8104e-8 * tail * abs(tail), 4.7815e-7 * main * abs(main)
    lift_t = (3.7755e-6 if tail >= 0 else 2.3046e-6) * tail * abs(tail)
    lift_m = (1.4971e-5 if main >= 0 else 8.9974e-6) * main * abs(main)
    motor_t = 0.0202 * (6.5 * 2.5 * u[0] - 0.0202 * tail) / 8 - 3.2498e-6 * tail
    motor_m = 0.0202 * (8.5 * 2.5 * u[1] - 0.0202 * main) / 8 - 4.1993e-6 * main
    cosine = math.cos(x[1])
    forces = [
        0.275 * lift_t * cosine - 1.1243e-4 * x[2] - 1.1758e-5 * math.tanh(20 * x[2]) - cosine * drag_m,
        0.254 * lift_m - 4.2150e-4 * x[3] - 4.0548e-4 * math.tanh(20 * x[3]) - drag_t,
        motor_t - drag_t,
        motor_m - drag_m,
    ]
    momenta = [sympy.diff(kinetic, rate) for rate in v]
    here = dict(zip((*q[:2], *v), state, strict=True))
    mass = sympy.Matrix([[sympy.diff(p, rate) for rate in v] for p in momenta]).subs(here)
    turning = [sum(sympy.diff(p, place) * rate for place, rate in zip(q, v, strict=True)) for p in momenta]
    pulls = [sympy.diff(kinetic - potential, place) for place in q]
    right = [f + (pull - turn).subs(here) for f, pull, turn in zip(forces, pulls, turning, strict=True)]
    return [float(a) for a in mass.LUsolve(sympy.Matrix(right))]


@pytest.mark.parametrize(("x", "u"), POINTS)
def test_accelerations_are_those_of_lagranges_equations(x, u):
    plant = Trms33()
    dx = plant(torch.tensor(x, dtype=torch.float64), torch.tensor(u, dtype=torch.float64)).tolist()
    turn, lift, tail, main = lagrange(x, u)
    rpm = 60 / (2 * math.pi)
    assert dx == pytest.approx([x[2], x[3], turn, lift, rpm * tail, rpm * main], rel=1e-9)


def test_the_stops_are_those_of_the_rig():
    assert (Trms33().stops.low, Trms33().stops.high) == ((-2.8, -1.0), (2.8, 1.0))


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
    for _ in range(800):
        x[:4] = 0.0
        x[4:] = rk4(plant, x, u, 0.025)[4:]
    assert float(x[5]) == pytest.approx(2700, rel=0.06)
    assert float(x[4]) == pytest.approx(4060, rel=0.06)
