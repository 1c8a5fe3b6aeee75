import pytest
import torch

from dynasindy.systems import Tras
from dynasindy.tasks import RandomStep, Step, Tracking, TrackingReward, Wave

SIGNATURE = Tras().signature


def test_observation_is_scaled_states_and_errors():
    task = Tracking(SIGNATURE, Step([[0.5, -0.25]]), error_scale=0.5)
    x = torch.tensor([[0.1, 0.2, 0.3, 0.4, 2000.0, -1250.0]])
    seen = task.observation(x, task.sample(torch.Size((1,)), torch.Generator()), torch.zeros(1, 1))
    assert seen[0].tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, -0.5, 0.8, -0.9])
    assert seen[0, task.error_columns].tolist() == pytest.approx([0.8, -0.9])


def test_rates_are_seen_when_asked():
    task = Tracking(SIGNATURE, Wave([0.35, 0.25], [0.015, 0.015]), observe_rate=True)
    params = task.sample(torch.Size((1,)), torch.Generator())
    seen = task.observation(torch.zeros(1, 6), params, torch.zeros(1, 1))
    assert task.n_o == seen.shape[-1] == 10
    assert seen[0, 8].item() == pytest.approx(0.35 * 2 * torch.pi * 0.015)


def test_reward_reads_the_error_at_the_end_and_the_change_of_the_rates():
    task = Tracking(SIGNATURE, Step([[0.0, 0.0]]), reward=TrackingReward((1.0, 1.0), 2.0, 0.0))
    x, x_next = torch.zeros(1, 6), torch.tensor([[0.3, 0.0, 0.5, 0.0, 0.0, 0.0]])
    params = task.sample(torch.Size((1,)), torch.Generator())
    paid = task.reward(x, x_next, params, torch.full((1, 1), 0.05), torch.tensor([False]))
    assert paid.item() == pytest.approx(-(0.3**2) - 2 * 0.5**2)


def test_a_state_that_does_not_exist_is_named():
    with pytest.raises(ValueError, match="'yaw' does not exist"):
        Tracking(SIGNATURE, Step([[0.0, 0.0]]), outputs=("yaw", "alpha_p"))


def test_counts_must_agree():
    with pytest.raises(ValueError, match="equally many"):
        Tracking(SIGNATURE, Step([[0.0]]))


def test_another_reference_leaves_the_rest():
    task = Tracking(SIGNATURE, RandomStep([-1, -1], [1, 1]), max_steps=7, observe_rate=True, error_scale=0.2)
    other = task.with_reference(Step([[0.1, 0.2]]))
    assert (other.max_steps, other.observe_rate, other.error_scale) == (7, True, 0.2)
    assert other.outputs == task.outputs
