import pytest
import sympy
import torch

from dynasindy.systems import Pendulum


def test_small_swing_has_the_natural_frequency():
    plant = Pendulum(mass=2.0, length=0.5, damping=0.0)
    jacobian = torch.autograd.functional.jacobian(lambda x: plant(x, torch.zeros(1)), torch.zeros(2))
    assert jacobian[1, 0].item() == pytest.approx(-9.81 / 0.5)


def test_full_input_holds_the_horizontal():
    # m g l = 9.81 N m holds a rod at 90 degrees.
    plant = Pendulum(max_torque=9.81)
    assert plant(torch.tensor([torch.pi / 2, 0.0]), torch.ones(1))[1].item() == pytest.approx(0.0, abs=1e-5)


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


@pytest.mark.parametrize("wrong", ["mass", "length", "max_torque"])
def test_what_must_be_positive_may_not_be_zero(wrong):
    with pytest.raises(ValueError, match=wrong):
        Pendulum(**{wrong: 0.0})
    with pytest.raises(ValueError, match="damping"):
        Pendulum(damping=-0.1)


def test_a_massless_pendulum_is_refused():
    with pytest.raises(ValueError, match="mass"):
        Pendulum(mass=0.0)
