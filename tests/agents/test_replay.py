"""Replay: exact shares, refusals, seeds, resume, and the first number on the plant that is not finite."""

import math

import pytest
import torch
from plants import Plant
from tensordict import TensorDict
from torchrl.envs.transforms import Transform

from dynasindy.agents import LEARN_KEYS, REAL_KEYS, DynaReplay
from dynasindy.agents.replay import require_finite_rollout
from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward
from dynasindy.systems import Diverged


def rows(n, value=0.0, keys=LEARN_KEYS):
    """Rows whose every float is `value + row number`."""
    number = value + torch.arange(n, dtype=torch.float32)
    td = TensorDict({}, [n])
    for key in keys:
        name = key if isinstance(key, str) else key[-1]
        if name in ("done", "terminated", "truncated", "at_stop"):
            td[key] = torch.zeros(n, 1, dtype=torch.bool)
        elif name == "reward":
            td[key] = number[:, None].clone()
        elif name == "step_count":
            td[key] = torch.arange(n)[:, None]
        elif name == "samples":
            td[key] = number[:, None, None].repeat(1, 5, 6)
        else:
            td[key] = number[:, None].repeat(1, 3)
    return td


def filled(real_ratio=0.3, batch_size=50, real=200, model=400, **settings):
    replay = DynaReplay(1000, batch_size, real_ratio, **settings)
    if real:
        replay.extend_real(rows(real, keys=REAL_KEYS))
    if model:
        replay.model.extend(rows(model, value=10_000))
    return replay


def test_sampling_is_uniform_over_the_written_rows():
    replay = filled(1.0, batch_size=1000, real=10)
    drawn = torch.cat([replay.sample()["next", "reward"] for _ in range(20)]).flatten()
    counts = torch.bincount(drawn.long(), minlength=10)
    assert len(counts) == 10
    assert (counts - 2000).abs().max() < 5 * (20000 * 0.1 * 0.9) ** 0.5  # five standard deviations


def test_real_rollouts_are_flattened_and_reduced_to_their_keys():
    replay = filled(model=0, real=0)
    rollout = rows(24, keys=REAL_KEYS).reshape(4, 6)
    rollout["reference"] = torch.zeros(4, 6, 2)
    replay.extend_real(rollout)
    assert len(replay.real) == 24
    assert set(replay.real[:].keys(True, True)) - {"index"} == set(REAL_KEYS)


def test_seed_decides_the_batches_and_the_global_generator_does_not():
    drawn = []
    for seed, other in ((1, 3), (1, 4), (2, 3)):
        torch.manual_seed(other)
        drawn.append(filled(seed=seed).sample()["next", "reward"])
    assert torch.equal(drawn[0], drawn[1])
    assert not torch.equal(drawn[0], drawn[2])
    assert torch.equal(filled().sample()["next", "reward"], filled(seed=0).sample()["next", "reward"])


@pytest.mark.parametrize("model", [0, 400])
def test_resumed_replay_equals_an_uninterrupted_one(tmp_path, model):
    replay, resumed = filled(model=model, model_capacity=450), filled(real=30, seed=5, model_capacity=450)
    resumed.sample()
    torch.save(replay.state_dict(), tmp_path / "replay.pt")
    resumed.load_state_dict(torch.load(tmp_path / "replay.pt", weights_only=True))
    assert (len(resumed.real), len(resumed.model)) == (200, model)
    for _ in range(2):
        assert torch.equal(replay.sample()["action"], resumed.sample()["action"])
        for each in (replay, resumed):  # the ring wraps at the same row
            each.model.extend(rows(100, value=30_000))
    assert torch.equal(replay.model[:]["action"], resumed.model[:]["action"])


@pytest.mark.parametrize("written", [4, 5, 7, 8])
def test_the_newest_real_rows_are_replaced_in_the_order_of_time_also_across_the_end_of_the_ring(written):
    replay = DynaReplay(5, 2, 1.0, keys=LEARN_KEYS)
    for number in range(written):
        replay.extend_real(rows(1, number))
    before = replay.real_in_order()["next", "reward"].flatten().tolist()
    replay.sample()
    stored = replay.real_in_order()[-3:]
    stored["next", "reward"] = torch.tensor([[100.0], [200.0], [300.0]])
    replay.rewrite_newest(stored)
    assert replay.real_in_order()["next", "reward"].flatten().tolist() == [*before[:-3], 100, 200, 300]
    drawn = {int(reward) for _ in range(50) for reward in replay.sample()["next", "reward"]}
    assert drawn == {*map(int, before[:-3]), 100, 200, 300}  # batches are drawn from the new rows
    replay.extend_real(rows(1, 50.0))
    expected = [*before[:-3], 100, 200, 300, 50][-5:]
    assert replay.real_in_order()["next", "reward"].flatten().tolist() == expected


def test_a_real_rollout_that_is_not_finite_leaves_no_row():
    replay = DynaReplay(100, 2)
    bad = rows(5, keys=REAL_KEYS)
    bad["next", "reward"][3] = float("inf")
    with pytest.raises(Diverged, match="period"):
        replay.extend_real(bad)
    assert not len(replay.real)


def marked(n, first, keys=LEARN_KEYS):
    """Rows in which every column tells its key: row number plus 1000 times the key's place; flags of own patterns."""
    number = first + torch.arange(n, dtype=torch.float32)
    patterns = {"done": 2, "terminated": 3, "truncated": 5, "at_stop": 7}
    td = TensorDict({}, [n])
    for place, key in enumerate(keys):
        name = key if isinstance(key, str) else key[-1]
        if name in patterns:
            td[key] = (number % patterns[name] == 0)[:, None]
        else:
            td[key] = (number + 1000 * place)[:, None].repeat(1, 1 if name == "reward" else 2)
    return td


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0])
def test_every_column_of_a_batch_is_that_of_its_key_in_its_row(ratio):
    replay = DynaReplay(100, 40, ratio, keys=LEARN_KEYS)
    replay.extend_real(marked(60, 0))
    replay.model.extend(marked(60, 100))
    batch = replay.sample()
    assert batch.batch_size == (40,) and batch["next"].batch_size == (40,)
    number = batch["observation"][:, 0].long()
    assert (number < 100).tolist() == [True] * round(40 * ratio) + [False] * round(40 * (1 - ratio))
    for place, key in ((1, "action"), (2, ("next", "observation")), (3, ("next", "reward"))):
        assert torch.equal(batch[key][:, 0].long(), number + 1000 * place), key
    for key, step in (("done", 2), ("terminated", 3), ("truncated", 5)):
        assert torch.equal(batch["next", key], (number % step == 0)[:, None]), key


def test_shares_are_rounded_to_whole_rows_and_sum_to_the_batch():
    assert filled(0.3, batch_size=5).counts() == (2, 3)  # 1.5 goes to the even number
    assert filled(0.29, batch_size=5).counts() == (1, 4)
    assert filled(0.5, real=0, batch_size=8).counts() == (0, 8)
    assert filled(0.0, model=0, batch_size=8).counts() == (8, 0)
    assert filled(None, batch_size=9, real=100, model=200).counts() == (3, 6)


def test_both_storages_are_rings_of_their_own_size():
    replay = DynaReplay(4, 2, keys=LEARN_KEYS, model_capacity=3)
    replay.extend_real(rows(3))
    assert replay.real_in_order()["action"][:, 0].tolist() == [0, 1, 2]  # not yet full: as written
    replay.extend_real(rows(3, 3.0))
    replay.model.extend(rows(5, 10.0))
    assert replay.real_in_order()["action"][:, 0].tolist() == [2, 3, 4, 5]
    assert len(replay.model) == 3
    replay.keep_imagined(3)  # as many as there are: nothing happens
    assert len(replay.model) == 3
    replay.keep_imagined(1)
    assert replay.model[:]["action"][:, 0].tolist() == [14]
    assert len(DynaReplay(7, 2).model.storage._storage or ()) == 0 and DynaReplay(7, 2).model.storage.max_size == 7


def test_keeping_imagined_rows_does_not_imagine_anew():
    class Doubled(Transform):
        def _inv_call(self, tensordict):
            return torch.cat([tensordict, tensordict])

    replay = DynaReplay(20, 2, keys=LEARN_KEYS)
    replay.model.append_transform(Doubled())
    replay.model.extend(rows(3))
    assert len(replay.model) == 6
    replay.keep_imagined(4)
    assert len(replay.model) == 4


def mass(edge=math.inf, beyond=math.nan):
    """A mass whose rate grows by one per second until the angle passes an edge, and that is then nowhere."""
    return Plant("angle rate", lambda angle, rate, u: [rate, torch.where(angle > edge, beyond, 1.0 + 0 * u)])


def env_of(plant):
    task = Tracking(plant.signature, Step([[0.5]]), outputs=["angle"], rates=["rate"], reward=TrackingReward((4.0,)))
    task.initial_state = lambda batch, rng: torch.zeros(*batch, 2)
    return ControlEnv(plant, task, dt=0.1, substeps=2, dtype=torch.float64)


def flown(plant, spoil=None):
    rollout = env_of(plant).rollout(30, lambda td: td.set("action", torch.full((1,), 0.25)))
    if spoil:
        key, value = spoil
        rollout[key][7] = value
    return rollout


@pytest.mark.parametrize("beyond", [math.nan, math.inf])
def test_a_plant_that_leaves_all_bounds_is_told_with_the_state_that_it_left_from(beyond):
    # 0.5 t^2 passes 0.605 in the twelfth control period of 0.1 s, which begins at rate 1.1 rad/s.
    with pytest.raises(Diverged, match="moves"):
        require_finite_rollout(flown(mass(0.61, beyond)))
    require_finite_rollout(flown(mass()))


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("observation", "the observation is .* from state"),
        ("action", "the policy's action is .* from observation .* check the policy's weights"),
        (("next", "state"), "the plant ends at"),
        (("next", "reward"), r"the reward is \[nan\], from state"),
        (("next", "observation"), "the observation is"),
    ],
)
def test_each_cause_is_told_by_its_name(key, told):
    with pytest.raises(Diverged, match="period 8 "):
        require_finite_rollout(flown(mass(), (key, math.nan)), "evaluation")


def test_an_action_that_is_nowhere_is_not_laid_on_the_plant():
    rollout = flown(mass(), ("action", math.nan))
    rollout["next", "state"][7:] = math.nan
    with pytest.raises(Diverged, match="policy"):
        require_finite_rollout(rollout)


def test_sensors_may_miss_what_is_there_but_tell_nothing_infinite():
    """NaN is what was not measured; infinity is no measurement, and may be all that is wrong in a rollout."""
    rollout = flown(mass())
    rollout["measurement"] = torch.full_like(rollout["state"], math.nan)
    rollout["next", "samples"][3, 1, 0] = math.nan
    require_finite_rollout(rollout)
    rollout["next", "samples"][7, 0, 1] = -math.inf
    with pytest.raises(Diverged, match="moves"):
        require_finite_rollout(rollout)
