import pytest
import torch
from tensordict import TensorDict

from dynasindy.data.recording import transitions
from dynasindy.envs import ControlEnv
from dynasindy.excitation import Multisine
from dynasindy.planning import Bounds
from dynasindy.planning.bounds import Agreeing, Near, Within
from dynasindy.planning.variation import Members
from dynasindy.sindy import Oracle, SindyModel
from dynasindy.systems import System, Xi
from dynasindy.tasks import Step, Tracking


def steps(states, actions):
    rows = TensorDict({"state": states, "action": actions}, [len(states)])
    rows["next"] = TensorDict({"state": states}, [len(states)])
    return rows


def test_near_is_within_the_distance_of_some_real_pair_in_units_of_the_largest_value():
    states, actions = torch.tensor([[10.0], [0.0]]), torch.tensor([[0.0], [0.5]])
    near = Near(states, actions, distance=0.11)
    asked = steps(torch.tensor([[11.0], [12.0], [0.0], [0.0]]), torch.tensor([[0.0], [0.0], [0.55], [0.6]]))
    assert near(asked).tolist() == [True, False, True, False]


def test_within_bounds_every_state():
    asked = steps(torch.tensor([[0.1, -2.0], [0.1, -2.1], [-0.2, 0.0]]), torch.zeros(3, 1))
    assert Within(torch.tensor([0.1, 2.0]))(asked).tolist() == [True, False, False]


def test_models_that_differ_by_a_factor_agree_where_their_rates_are_small():
    class Scaled(System):
        def __init__(self, factor):
            super().__init__(Xi().signature)
            self.factor = factor

        def forward(self, x, u):
            return self.factor * x

    members = Members([Scaled(factor) for factor in (0.9, 1.0, 1.1)])
    scale = torch.tensor(members.signature.x_scale)
    # The changes of a state of s ranges in 0.05 s have a standard deviation of 0.1 * 0.05 s over the members.
    asked = steps(torch.stack([0.9 * scale, 1.1 * scale]), torch.zeros(2, 2))
    assert Agreeing(members, dt=0.05, disagreement=0.1 * 0.05)(asked).tolist() == [True, False]


def test_an_exact_model_agrees_with_its_own_resamples_and_the_masks_are_those_asked_for():
    plant = Xi()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])), dtype=torch.float64)
    real = env.rollout(200, Multisine(2, 10.0, 0.05))
    masks = Bounds(distance=0.5, disagreement=1e-3).masks(
        env.with_system(SindyModel(plant.signature)), real, torch.Generator().manual_seed(0)
    )
    assert [type(mask) for mask in masks] == [Within, Near, Agreeing]
    assert all(mask(real).float().mean() > 0.95 for mask in masks)
    assert [type(mask) for mask in Bounds().masks(env, real, torch.Generator())] == [Within]


def test_a_model_without_members_cannot_disagree():
    plant = Xi()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])))
    real = env.rollout(20, Multisine(2, 10.0, 0.05))
    with pytest.raises(TypeError, match="Oracle"):
        Bounds(disagreement=0.1).masks(env.with_system(Oracle(plant.signature, plant)), real, torch.Generator())


@pytest.mark.parametrize("settings", [{"reach": 0.0}, {"distance": -1.0}, {"disagreement": 0.0}])
def test_impossible_bounds_are_refused(settings):
    with pytest.raises(ValueError, match=r"planning\.bounds"):
        Bounds(**settings)


def real_rows(n=20):
    plant = Xi()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])), dtype=torch.float64)
    return env, env.rollout(n, Multisine(2, 10.0, 0.05))


def test_the_limit_is_the_reach_times_the_largest_state_that_a_period_ended_in():
    env, real = real_rows()
    real["state"][0] = 1e6  # where a period begins does not count
    (within,) = Bounds(reach=2.5).masks(env, real, torch.Generator())
    torch.testing.assert_close(within.limit, 2.5 * real["next", "state"].abs().amax(0))


def test_the_distance_is_measured_to_pairs_of_state_and_action_drawn_by_the_generator():
    env, real = real_rows()
    torch.manual_seed(5)
    near, again, other = (
        Bounds(distance=0.1).masks(env, real, torch.Generator().manual_seed(seed))[1] for seed in (0, 0, 1)
    )
    assert len(near.real) == 2000 and near.distance == 0.1
    pairs = torch.cat([real["state"], real["action"]], -1).float()
    # Of twenty pairs every one is among two thousand draws, and nothing else is.
    scale = pairs.abs().amax(0).clamp_min(1e-9)
    torch.testing.assert_close(near.real.unique(dim=0), (pairs / scale).unique(dim=0))
    assert torch.equal(near.real, again.real) and not torch.equal(near.real, other.real)


def test_a_state_that_never_moved_counts_by_its_least_movement():
    near = Near(torch.zeros(3, 1), torch.ones(3, 1), distance=1.0)
    asked = steps(torch.tensor([[0.0], [0.9e-9], [1.1e-9]]), torch.ones(3, 1))
    assert near(asked).tolist() == [True, True, False]


def test_near_reads_every_step_of_every_rollout_in_its_place():
    near = Near(torch.tensor([[1.0]]), torch.tensor([[1.0]]), distance=0.5)
    rollouts = TensorDict({"state": torch.tensor([[[1.0], [2.0], [1.2]], [[3.0], [1.0], [0.4]]])}, [2, 3])
    rollouts["action"] = torch.ones(2, 3, 1)
    assert near(rollouts).tolist() == [[True, False, True], [False, True, False]]


def test_five_fits_have_to_agree_over_a_control_period():
    env, real = real_rows(100)
    model_env = env.with_system(SindyModel(env.system.signature))
    agreeing = Bounds(disagreement=0.2).masks(model_env, real, torch.Generator())[1]
    assert len(agreeing.models) == 5 and agreeing.disagreement == 0.2
    torch.testing.assert_close(agreeing.factor, 0.05 / torch.tensor(env.system.signature.x_scale))
    # The fits are those to the samples every 0.01 s within the periods.
    expected = Members.of(model_env.system, transitions(real, 0.01), 5).models
    assert all(torch.equal(one.coefficients, two.coefficients) for one, two in zip(agreeing.models, expected))


@pytest.mark.parametrize("name", ["reach", "distance", "disagreement"])
def test_the_smallest_positive_bounds_are_allowed(name):
    assert getattr(Bounds(**{name: 1e-9}), name) == 1e-9
