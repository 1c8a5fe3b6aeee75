import pytest
import sympy
import torch

from dynasindy.systems import Pendulum


@pytest.mark.parametrize(("theta", "rate", "u"), [(0.7, -1.3, 0.4), (-2.5, 0.6, -0.9)])
def test_it_obeys_lagranges_equation(theta, rate, u):
    angle, speed = sympy.symbols("angle speed")
    kinetic, potential = 2.5 * (0.4 * speed) ** 2 / 2, -2.5 * 9.81 * 0.4 * sympy.cos(angle)
    force = 3.0 * u - 0.3 * rate - sympy.diff(potential, angle)
    expected = float(force.subs(angle, theta) / sympy.diff(kinetic, speed, 2))
    plant = Pendulum(mass=2.5, length=0.4, damping=0.3, max_torque=3.0)
    dx = plant(torch.tensor([theta, rate], dtype=torch.float64), torch.tensor([u], dtype=torch.float64))
    assert dx.tolist() == pytest.approx([rate, expected], rel=1e-12)


def test_by_default_it_weighs_a_kilogram_on_a_metre():
    # m = 1 kg, l = 1 m, b = 0.5 N m s/rad, 12 N m: 12 * 0.5 - 9.81 sin(0.3) - 0.5 * 2.
    dx = Pendulum()(torch.tensor([0.3, 2.0], dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64))
    assert dx[1].item() == pytest.approx(6.0 - 9.81 * 0.29552020666 - 1.0)
    signature = Pendulum().signature
    assert (signature.state_units, signature.x_scale, signature.n_x, signature.n_u) == (("rad", "rad/s"), (1, 3), 2, 1)
