import math

import pytest
import torch

from dynasindy.tasks import TrackingReward


def pay(error, change=(0.0, 0.0), at_stop=False, **settings):
    reward = TrackingReward(**settings)
    return reward(torch.tensor(error), torch.tensor(change), torch.tensor(at_stop)).item()


def test_the_bonus_is_paid_per_axis_inside_the_band():
    assert pay((0.0099, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(0.7)
    assert pay((0.0, -0.009), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(1.4)
    assert pay((0.011, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == 0.0


def test_the_defaults_are_those_that_the_configs_and_the_documents_state():
    reward = TrackingReward()
    assert (reward.error_weights, reward.rate_weight, reward.bonus, reward.tolerance) == ((4.0, 4.0), 0.1, 0.1, 0.01)
    assert (reward.stop_penalty, reward.error_shape, reward.width) == (1.0, "quadratic", 0.05)
    # -4 (0.3^2 + 0.2^2) - 0.1 (0.5^2 + 0.4^2) - 1 = -0.52 - 0.041 - 1; the bonus for the second of two errors below.
    assert pay((0.3, -0.2), (0.5, -0.4), at_stop=True) == pytest.approx(-1.561)
    assert pay((0.3, 0.005)) == pytest.approx(-0.36 - 0.0001 + 0.1)


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


def test_an_error_at_the_tolerance_earns_nothing():
    assert pay((0.5, 0.5), error_weights=(0.0, 0.0), tolerance=0.5) == 0.0


@pytest.mark.parametrize(
    "settings",
    [
        {"error_weights": (1.0, -1.0)},
        {"rate_weight": -1.0},
        {"tolerance": -1.0},
        {"stop_penalty": -1.0},
        {"bonus": -1.0},
        {"width": 0.0},
        {"error_shape": "cubic"},
    ],
)
def test_no_weight_may_be_negative_and_all_may_be_zero(settings):
    with pytest.raises(ValueError, match=r"-1|0\.0|cubic"):
        TrackingReward(**settings)
    assert pay((0.3, 0.3), (1.0, 1.0), True, error_weights=[0, 0], rate_weight=0, bonus=0, stop_penalty=0) == 0.0
