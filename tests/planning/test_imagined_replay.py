import math
from functools import cache

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from dynasindy.agents import LEARN_KEYS, TD3, DynaReplay
from dynasindy.envs import ControlEnv, RandomStep, Step, Tracking, Wave
from dynasindy.planning import Imagination, ImaginedReplay, Planned, Planner
from dynasindy.systems import Diverged, System, Tras

PLANT = Tras()
ENV = ControlEnv(PLANT, Tracking(PLANT.signature, RandomStep([-0.5, -0.5], [0.5, 0.4])))


@cache
def flown():
    with torch.no_grad():
        return ENV.rollout(60, TD3(ENV.task.n_o, 2, hidden=(8,)).explore)


def make(**settings):
    agent, replay = TD3(ENV.task.n_o, 2, hidden=(8,)), DynaReplay(5000, 32)
    replay.extend_real(flown().clone())
    return replay, ImaginedReplay(ENV, agent, replay, **settings), agent


def test_what_older_models_imagined_is_evicted_or_kept():
    for generations, stored in ((1, [60, 60, 60]), (2, [60, 120, 120]), (None, [60, 120, 180])):
        replay, planner, _ = make(rollouts=12, horizon=5, generations=generations)
        found = []
        for _ in stored:
            planner.plan()
            found.append(len(replay.model))
        assert found == stored


def test_what_lies_beyond_the_states_of_the_plant_is_not_stored():
    _, planner, _ = make(rollouts=12, horizon=5, state_bound=1e-9)
    assert planner.plan().imagined == 0
    _, planner, _ = make(rollouts=12, horizon=5, state_bound=1e9)
    assert planner.plan().imagined == 60


def test_distrust_empties_the_model_storage_only():
    replay, planner, _ = make(rollouts=12, horizon=5)
    planner.plan()
    planner.distrust()
    assert len(replay.model) == 0 and len(replay.real) == 60


class Nowhere(Tras):
    """A model that is nowhere from where the pitch is above a limit."""

    def __init__(self, limit):
        super().__init__()
        self.limit = limit

    def forward(self, x, u):
        return torch.where(x[..., 1:2] > self.limit, math.nan, super().forward(x, u))


def test_a_phase_in_which_every_rollout_diverges_at_once_is_told():
    replay, planner, _ = make(rollouts=12, horizon=5)
    pitches = replay.real_in_order()["state"][:, 1]
    planner.imagination.env = planner.env.with_system(Nowhere(-math.inf))
    with pytest.raises(Diverged, match="12"):
        planner.plan()
    assert not len(replay.model)
    # Where the model is sound at some real states, their rollouts are stored.
    planner.imagination.env = planner.env.with_system(Nowhere(pitches.median().item()))
    assert 0 < planner.plan().imagined < 60
    assert 0 < planner.imagination.diverged < 12


def starts_of(replay, rows=slice(None)):
    return replay.model[:]["observation"][rows, :6]


def test_branches_begin_at_every_one_of_the_real_states():
    replay, planner, _ = make(rollouts=600, horizon=1)
    planner.plan()
    same = (starts_of(replay).unsqueeze(1) == replay.real_in_order()["observation"][:, :6]).all(-1)
    assert bool(same.any(0).all())
    # Each as often as any other: the counts of 600 draws deviate by the root of their mean.
    assert float((same.sum(0) - 10).abs().max()) <= 5 * 10**0.5


def test_the_seed_of_the_planner_chooses_the_starts_and_nothing_else_does():
    chosen = []
    for seed, drawn_elsewhere in ((3, 0), (3, 7), (4, 0)):
        replay, planner, _ = make(rollouts=20, horizon=1, seed=seed)
        torch.rand(drawn_elsewhere)
        planner.plan()
        chosen.append(starts_of(replay))
    assert torch.equal(chosen[0], chosen[1]) and not torch.equal(chosen[0], chosen[2])


POLICY = TensorDictModule(lambda o: o[..., :2] * 0 + 0.3, in_keys=["observation"], out_keys=["action"])


def make_env(system=None):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])))
    return env.with_system(system) if system else env


def test_starts_in_transitions_out_on_any_buffer():
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(1000), batch_size=16)
    buffer.append_transform(Imagination(make_env(), POLICY, horizon=7))
    buffer.extend(TensorDict({"state": torch.zeros(5, 6)}, [5]))
    assert len(buffer) == 35
    stored = set(buffer[:].keys(include_nested=True, leaves_only=True)) - {"index"}
    assert stored == set(LEARN_KEYS)


class Turn(System):
    """A clock: the azimuth grows by a tenth per period, whatever is done."""

    def __init__(self):
        super().__init__(Tras().signature)

    def forward(self, x, u):
        return torch.cat([torch.full_like(x[..., :1], 0.1 / 0.05), torch.zeros_like(x[..., 1:])], -1)


def test_what_follows_a_step_beyond_the_limit_is_cut_although_it_comes_back():
    starts = torch.zeros(3, 6)
    starts[:, 0] = torch.tensor([0.0, -0.45, -0.3])  # the second begins beyond the limit, and would come back
    imagined = Imagination(make_env(Turn()), POLICY, horizon=5, limit=torch.full((6,), 0.25)).imagine(starts)
    ends = (10 * imagined["next", "observation"][:, 0]).round()
    assert ends.tolist() == [1, 2, -2, -1, 0, 1, 2]
    assert imagined["next", "truncated"].flatten().tolist() == [False, True, False, False, False, False, True]


def test_imagined_rollouts_are_those_of_a_loop_over_rows_and_periods():
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Wave([0.3, 0.2], [0.5, 0.4])))
    policy = TensorDictModule(lambda o: (0.5 * o[..., 6:]).clamp(-1, 1), in_keys=["observation"], out_keys=["action"])
    starts = 0.1 * torch.randn(2, 3, 6, generator=torch.Generator().manual_seed(0))
    imagined = Imagination(env, policy, horizon=4).imagine(starts)
    assert imagined.batch_size == (24,)
    params = env.task.sample(torch.Size((1,)), torch.Generator())
    for i, x in enumerate(starts.reshape(6, 1, 6)):
        for k in range(4):
            seen = env.task.observation(x, params, torch.tensor([[k * 0.05]]))
            u = (0.5 * seen[:, 6:]).clamp(-1, 1)
            following = env.advance(x, u)[0][:, -1]
            t = torch.tensor([[(k + 1) * 0.05]])
            reward = env.task.reward(x, following, params, t, torch.zeros(1, dtype=torch.bool))
            row = imagined[4 * i + k]
            torch.testing.assert_close(row["observation"], seen[0])
            torch.testing.assert_close(row["action"], u[0])
            torch.testing.assert_close(row["next", "observation"], env.task.observation(following, params, t)[0])
            torch.testing.assert_close(row["next", "reward"], reward, atol=1e-6, rtol=1e-5)
            assert row["next", "done"].item() == (k == 3)
            x = following


class Every(Planner):
    def plan(self):
        return Planned(1, 2)

    def distrust(self):
        pass


def test_a_phase_follows_every_nth_episode():
    assert [n for n in range(1, 10) if Every(every=3).due(n)] == [3, 6, 9]
