import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from dynasindy.data import LEARN_KEYS
from dynasindy.envs import ControlEnv
from dynasindy.planning import Imagination, imagined_replay
from dynasindy.systems import System, Tras
from dynasindy.tasks import Step, Tracking, Wave

POLICY = TensorDictModule(lambda o: o[..., :2] * 0 + 0.3, in_keys=["observation"], out_keys=["action"])


def make_env(system=None):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])))
    return env.with_system(system) if system else env


class Explosion(System):
    """The pitch doubles every period; row k starts at its own value."""

    def __init__(self):
        super().__init__(Tras().signature)

    def forward(self, x, u):
        return x * (torch.log(torch.tensor(2.0)) / 0.05)


def test_starts_in_transitions_out_on_any_buffer():
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(1000), batch_size=16)
    buffer.append_transform(Imagination(make_env(), POLICY, horizon=7))
    buffer.extend(TensorDict({"state": torch.zeros(5, 6)}, [5]))
    assert len(buffer) == 35
    stored = set(buffer[:].keys(include_nested=True, leaves_only=True)) - {"index"}
    assert stored == set(LEARN_KEYS)


def test_imagined_with_the_true_plant_equals_real():
    env = make_env()
    imagined = Imagination(env, POLICY, horizon=6).imagine(torch.zeros(1, 6))
    real = env.rollout(6, POLICY)
    for key in ("observation", "action", ("next", "observation"), ("next", "reward")):
        assert torch.equal(imagined[key], real[key]), key


def test_ends_are_truncated_and_never_terminated():
    imagined = Imagination(make_env(), POLICY, horizon=4).imagine(torch.zeros(2, 6))
    ends = imagined["next", "truncated"].flatten().reshape(2, 4)
    assert ends.tolist() == [[False, False, False, True]] * 2
    assert torch.equal(imagined["next", "done"], imagined["next", "truncated"])
    assert not imagined["next", "terminated"].any()


def test_a_rollout_is_cut_before_it_leaves_the_limit():
    # 0.01 doubles to 0.02, 0.04, 0.08, 0.16: three transitions stay within 0.1; 0.04 -> 0.08 stays, once.
    starts = torch.zeros(2, 6)
    starts[:, 1] = torch.tensor([0.01, 0.04])
    imagination = Imagination(make_env(Explosion()), POLICY, horizon=10, limit=torch.full((6,), 0.1))
    imagined = imagination.imagine(starts)
    assert len(imagined) == 3 + 1
    assert imagined["next", "truncated"].flatten().tolist() == [False, False, True, True]


def test_what_is_not_finite_is_never_stored():
    starts = torch.zeros(3, 6)
    starts[:, 4] = 1e30  # a rotor speed that overflows float32 after some doublings
    imagined = Imagination(make_env(Explosion()), POLICY, horizon=50).imagine(starts)
    assert 0 < len(imagined) < 150
    assert all(imagined[key].isfinite().all() for key in LEARN_KEYS)


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


def test_a_rollout_needs_a_period():
    with pytest.raises(ValueError, match=r"at least 1 control period, got 0; mend planning\.horizon"):
        Imagination(make_env(), POLICY, horizon=0)
    assert len(Imagination(make_env(), POLICY, horizon=1).imagine(torch.zeros(2, 6))) == 2


@pytest.mark.parametrize("key", ["state", "observation", "reward"])
@pytest.mark.parametrize("value", [torch.nan, -torch.inf])
def test_a_transition_is_finite_where_all_of_its_numbers_are(key, value):
    following = {"state": torch.zeros(3, 4, 6), "observation": torch.zeros(3, 4, 8), "reward": torch.zeros(3, 4, 1)}
    rollout = TensorDict({"next": TensorDict(following, [3, 4])}, [3, 4])
    assert imagined_replay._finite(rollout).tolist() == 3 * [4 * [True]]
    rollout["next", key][:2] = 3e38  # the sum of all is too large for float32
    assert imagined_replay._finite(rollout).tolist() == 3 * [4 * [True]]
    rollout["next", key][1, 2, 0] = value
    found = imagined_replay._finite(rollout)
    assert found.sum() == 11 and not found[1, 2]
