import pytest
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


def test_a_massless_pendulum_is_refused():
    with pytest.raises(ValueError, match="mass"):
        Pendulum(mass=0.0)
