import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from dynasindy.data.rollout_data import LoggedPeriods, measurements_and_inputs, transitions
from dynasindy.envs import ControlEnv
from dynasindy.systems import Tras, rk4
from dynasindy.tasks import Step, Tracking


def rollout(u, steps):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.0, 0.0]])), dtype=torch.float64)
    policy = TensorDictModule(lambda o: torch.tensor(u), in_keys=["observation"], out_keys=["action"])
    return env.rollout(steps, policy)


def test_each_period_gives_its_own_rows_inputs_and_flag():
    """Four periods of two samples; the second and the last touched a stop."""
    start = torch.tensor([[0.0], [2.0], [4.0], [6.0]])
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [4.0]], [[5.0], [6.0]], [[7.0], [8.0]]])
    rows = TensorDict(
        {
            "state": start,
            "action": torch.tensor([[0.1, -0.1], [0.2, -0.2], [0.3, -0.3], [0.4, -0.4]]),
            "next": {"samples": samples, "at_stop": torch.tensor([[False], [True], [False], [True]])},
        },
        [4],
    )
    data = transitions(rows, 0.025)
    assert data.x.flatten().tolist() == [0, 1, 4, 5] and data.x_next.flatten().tolist() == [1, 2, 5, 6]
    expected = torch.tensor([[0.1, -0.1], [0.1, -0.1], [0.3, -0.3], [0.3, -0.3]])
    assert torch.equal(data.u.float(), expected) and data.u.dtype == data.x.dtype == data.x_next.dtype == torch.float64
    assert data.segment.tolist() == [0, 0, 1, 1] and data.dt == 0.025


def test_every_logged_sample_becomes_a_transition_of_the_plant():
    data = transitions(rollout([0.2, 0.4], 20), 0.01)
    assert len(data) == 100 and data.dt == 0.01
    assert torch.allclose(rk4(Tras(), data.x, data.u, 0.01), data.x_next, rtol=1e-12)


def test_periods_at_a_stop_are_left_out_and_break_the_segment():
    rows = rollout([1.0, 1.0], 80)
    at_stop = rows["next", "at_stop"].flatten()
    assert 0 < at_stop.sum() < 80
    data = transitions(rows, 0.01)
    assert len(data) == 5 * int((~at_stop).sum())
    follows = data.segment[1:] == data.segment[:-1]
    assert torch.equal(data.x[1:][follows], data.x_next[:-1][follows])


def test_some_periods_and_the_others_are_read_of_the_same_log():
    rows = rollout([0.2, 0.4], 12)
    rows["next", "at_stop"][5] = True
    logged, some = LoggedPeriods(rows, 0.01), torch.tensor([True] * 4 + [False, True] * 4)
    for among in (some, ~some, torch.ones(12, dtype=torch.bool)):
        found, wanted = logged.transitions(among), transitions(rows[among], 0.01)
        for name in ("x", "u", "x_next", "segment"):
            assert torch.equal(getattr(found, name), getattr(wanted, name)), name
    assert len(logged.transitions()) == 55


def test_an_observer_reads_the_first_measurement_and_that_at_the_end_of_each_period():
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [torch.nan]]])
    rows = TensorDict(
        {
            "measurement": torch.tensor([[0.5], [2.0]]),
            "action": torch.tensor([[0.1], [0.2]]),
            "next": {"samples": samples},
        },
        [2],
    )
    y, u = measurements_and_inputs(rows)
    torch.testing.assert_close(y, torch.tensor([[0.5], [2.0], [torch.nan]]), equal_nan=True)
    assert u.flatten().tolist() == pytest.approx([0.1, 0.2])
