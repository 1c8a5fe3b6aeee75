import math

import pytest
import torch

from dynasindy.tasks import TrackingReward


def pay(error, change=(0.0, 0.0), at_stop=False, **settings):
    reward = TrackingReward(**settings)
    return reward(torch.tensor(error), torch.tensor(change), torch.tensor(at_stop)).item()


def test_the_papers_reward_by_hand():
    # -(2*0.1^2 + 3*0.2^2) - 0.5*(0.3^2 + 0.1^2) = -0.14 - 0.05
    paid = pay((0.1, -0.2), (0.3, 0.1), error_weights=(2.0, 3.0), rate_weight=0.5)
    assert paid == pytest.approx(-0.19)


def test_the_bonus_is_paid_per_axis_inside_the_band():
    assert pay((0.0099, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(0.7)
    assert pay((0.0, -0.009), error_weights=(0.0, 0.0), bonus=0.7) == pytest.approx(1.4)
    assert pay((0.011, 0.2), error_weights=(0.0, 0.0), bonus=0.7) == 0.0


def test_a_stop_costs_its_penalty():
    assert pay((0.0, 0.0), at_stop=True, bonus=0.0, stop_penalty=3.0) == pytest.approx(-3.0)


def test_the_linear_shape_is_quadratic_within_its_width_and_linear_beyond():
    settings = {"error_weights": (1.0, 0.0), "error_shape": "linear", "width": 0.05, "bonus": 0.0}
    assert pay((0.05, 0.0), **settings) == pytest.approx(-(0.05**2) / 0.1)
    slope = pay((2.0, 0.0), **settings) - pay((3.0, 0.0), **settings)
    assert slope == pytest.approx(1.0, abs=1e-3)


def test_the_logarithmic_shape_is_quadratic_near_zero_and_grows_by_a_constant_per_octave_far_away():
    settings = {"error_weights": (1.0, 0.0), "error_shape": "logarithmic", "width": 0.05, "bonus": 0.0}
    assert pay((0.001, 0.0), **settings) == pytest.approx(-(0.001**2) / 0.05, rel=1e-3)
    octave = pay((20.0, 0.0), **settings) - pay((40.0, 0.0), **settings)
    assert octave == pytest.approx(0.1 * 0.6931472, rel=1e-3)


@pytest.mark.parametrize("settings", [{"bonus": -1.0}, {"width": 0.0}, {"error_shape": "cubic"}])
def test_impossible_rewards_are_refused(settings):
    with pytest.raises(ValueError, match=str(next(iter(settings.values())))):
        TrackingReward(**settings)


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


def test_rows_of_a_batch_are_paid_apart():
    reward = TrackingReward((1.0, 2.0), 3.0, 0.0, stop_penalty=5.0)
    error = torch.tensor([[[0.1, 0.2]], [[0.3, 0.4]]], dtype=torch.float64)
    change = torch.tensor([[[0.5, 0.0]], [[0.0, 0.1]]], dtype=torch.float64)
    paid = reward(error, change, torch.tensor([[False], [True]]))
    assert paid.shape == (2, 1) and paid.dtype == torch.float64
    assert paid.flatten().tolist() == pytest.approx([-0.01 - 0.08 - 0.75, -0.09 - 0.32 - 0.03 - 5.0])


def test_an_error_at_the_tolerance_earns_nothing():
    assert pay((0.5, 0.5), error_weights=(0.0, 0.0), tolerance=0.5) == 0.0


@pytest.mark.parametrize(
    "settings", [{"error_weights": (1.0, -1.0)}, {"rate_weight": -1.0}, {"tolerance": -1.0}, {"stop_penalty": -1.0}]
)
def test_no_weight_may_be_negative_and_all_may_be_zero(settings):
    with pytest.raises(ValueError, match="must be >= 0"):
        TrackingReward(**settings)
    assert pay((0.3, 0.3), (1.0, 1.0), True, error_weights=[0, 0], rate_weight=0, bonus=0, stop_penalty=0) == 0.0
