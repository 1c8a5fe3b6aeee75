import math

import pytest
import torch

from dynasindy.envs import TrackingReward


def pay(error, change=(0.0, 0.0), at_stop=False, **settings):
    reward = TrackingReward(**settings)
    return reward(torch.tensor(error), torch.tensor(change), torch.tensor(at_stop)).item()


def test_the_bonus_is_paid_per_axis_inside_the_band():
    assert pay((0.0099, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(0.7)
    assert pay((0.0, -0.009), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(1.4)
    assert pay((0.011, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == 0.0


@pytest.mark.parametrize(
    ("shape", "cost"),
    [
        ("quadratic", 0.3**2),
        ("linear", 0.3**2 / (0.2 + 0.3)),
        ("logarithmic", 0.2 * math.log(1 + (0.3 / 0.2) ** 2)),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_each_shape_is_its_formula_in_plain_numbers(shape, cost, sign):
    paid = pay((0.0, sign * 0.3), error_weights=(5.0, 2.0), error_shape=shape, width=0.2, bonus=0.0)
    assert paid == pytest.approx(-2 * cost)
