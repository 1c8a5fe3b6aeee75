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
