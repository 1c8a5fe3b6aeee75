"""The published EMPS axis against forces that were worked out by hand."""

import pytest
import torch
from benchmarks.emps_axis import published_axis, steady_force

from dynasindy.systems.base import Signature

SIGNATURE = Signature(("q", "v"), ("m", "m/s"), ("u",), (0.25, 0.15))


@pytest.mark.parametrize(
    ("speed", "newton", "acceleration"),
    [
        # 203.5034 * .1 + 20.3935 - 3.1648 = 37.57904 keeps .1 m/s forth, -43.90864 back: the push helps one way.
        (0.1, 37.57904, 0.0),
        (-0.1, -43.90864, 0.0),
        # One mass in newtons more is 1 m/s^2 more.
        (0.1, 37.57904 + 95.1089, 1.0),
        (0.0, -3.1648, 0.0),
    ],
)
def test_the_force_that_keeps_a_speed(speed, newton, acceleration):
    x = torch.tensor([0.2, speed], dtype=torch.float64)
    dx = published_axis(SIGNATURE)(x, torch.tensor([newton / 100], dtype=torch.float64))
    assert dx.tolist() == pytest.approx([speed, acceleration], abs=1e-9)


def test_the_force_at_a_speed_is_read_from_any_model():
    assert steady_force(published_axis(SIGNATURE), 0.1) == pytest.approx(37.57904)
    assert steady_force(published_axis(SIGNATURE), -0.1) == pytest.approx(-43.90864)
