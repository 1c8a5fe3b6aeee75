"""What the end of a run says of a plant, from made-up trajectories."""

import json
import math
from dataclasses import asdict

import pytest
import torch
from tensordict import TensorDict

from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.tracking_criteria import TrackingCriteria, judge_control, judge_tracking
from dynasindy.systems import Diverged, Signature, System

SIGNATURE = Signature(("p", "theta", "way"), ("m", "rad", "m"), ("u",), (1.0, 0.5, 10.0))
TIME = torch.arange(0, 20, 0.05)


class Plant(System):
    """A plant whose rates depend on some of its states."""

    def __init__(self, *matter):
        super().__init__(SIGNATURE)
        self.matter = torch.tensor(matter)

    def forward(self, x, u):
        return (self.matter * x).sum(-1, keepdim=True).expand_as(x)


PLANT = Plant(1.0, 1.0, 0.0)


def evaluation(x, r=None):
    """Return runs `(2, 400, 3)` of a plant whose first state is tracked in a box of 4 m."""
    x = x.expand(2, len(TIME), 3).double()
    r = torch.zeros(2, len(TIME), 1, dtype=torch.float64) if r is None else r
    trajectory = TensorDict({"state": x, "reference": r}, [2, len(TIME)])
    return Evaluation("step", SIGNATURE, (0,), TIME, trajectory, {}, (), (4.0,))


def states(p=0.0, theta=0.0, way=0.0):
    return torch.stack([torch.as_tensor(v).expand(len(TIME)) for v in (p, theta, way)], -1)


def judge(x, r=None):
    return judge_tracking(evaluation(x, r), PLANT)


def test_errors_are_those_of_the_last_seconds_in_boxes():
    early = torch.where(TIME < 14.9, 3.0, 0.02)
    x = torch.stack([states(early), states(2 * early)])
    found = judge(x)
    assert found.share == {"p": pytest.approx(0.03 / 4)} and found.worst == {"p": pytest.approx(0.04 / 4)}
    assert not found.away and not found.idle


def test_a_spinning_pole_and_a_mileage_are_told_apart():
    x = states(theta=3.0 * TIME, way=2.0 * TIME)
    found = judge(torch.stack([x, states()]))
    assert found.away == {"theta": 0.5} and found.idle == {"way": 0.5}
    assert json.loads(json.dumps(asdict(found), allow_nan=False)) == asdict(found)


def test_a_state_that_swings_has_not_come_to_rest():
    swinging = judge(states(theta=0.2 * torch.sin(3 * TIME)))
    assert swinging.away == swinging.swings == {"theta": 1.0}  # 0.4 of a range of 0.5
    assert not judge(states(theta=0.1 * torch.sin(3 * TIME))).away
    assert not judge(states(theta=torch.where(TIME < 14.9, 3.0, 0.0))).away


def test_the_rate_of_what_does_not_come_to_rest_is_found_in_its_motion():
    def rates(x):
        return judge_tracking(evaluation(x), Plant(1.0, 1.0, 1.0)).rates

    angle, rate = 0.3 * torch.sin(3 * TIME) + 0.1, 0.9 * torch.cos(3 * TIME)
    assert rates(states(theta=angle, way=10 * rate)) == []  # ten times as fast
    assert rates(states(theta=angle, way=rate)) == ["way"]
    assert rates(states(theta=rate, way=angle)) == ["theta"]
    assert rates(states(p=angle, theta=2.0 * TIME)) == []
    assert rates(states(theta=30.0 * TIME, way=30.0)) == ["way"]  # runs away at an even rate
    assert rates(states(theta=0.1, way=0.0)) == []


def ringing(damping, half=math.inf, amplitude=0.2, period=6.0):
    """Return runs in which theta swings about its rest, and what makes the same runs in another length [s].

    The swings begin anew with every jump of the reference, which is a square wave of a half period [s].
    """

    def rerun(phase, seconds):
        time = torch.arange(0, seconds, 0.05, dtype=torch.float64)
        since, sign = time % half, 1.0 - 2.0 * (time // half % 2)
        theta = amplitude * torch.exp(-damping * since) * torch.sin(2 * math.pi / period * since)
        x = torch.stack([sign, theta, 0 * theta], -1).expand(2, -1, -1)
        rows = {"state": x, "reference": x[..., :1]}
        return Evaluation("step", SIGNATURE, (0,), time, TensorDict(rows, x.shape[:2]), {}, (), (4.0,))

    return rerun("", 20.0), rerun


@pytest.mark.parametrize(
    ("damping", "half", "decaying"),
    [
        (0.02, math.inf, True),
        (0.002, math.inf, True),  # .85 of its motion after five runs, .47 after twenty
        (0.0, math.inf, False),
        (-0.001, math.inf, False),
        (0.0, 7.0, False),  # it rests from 14 s to 21 s, and for 2 s at the end of the longer run
        (0.02, 45.0, True),
        (0.02, 30.0, False),  # 10 s more say too little
    ],
)
def test_a_state_whose_swings_die_away_rings_and_is_not_restless(damping, half, decaying):
    short, rerun = ringing(damping, half)
    found = judge_tracking(short, PLANT, rerun)
    assert bool(found.ringing) == decaying and bool(found.away) == bool(found.swings) == (not decaying)
    assert judge_tracking(short, PLANT).away == {"theta": 1.0}  # as no longer run says more


@pytest.mark.parametrize("error", [Diverged, ValueError, MemoryError, RuntimeError])
def test_a_longer_run_that_fails_says_nothing(error):
    def rerun(phase, seconds):
        raise error("of five times the length")

    assert judge_tracking(ringing(0.02)[0], PLANT, rerun).away == {"theta": 1.0}


@pytest.mark.parametrize(("late", "share"), [(1.0, 0.0), (4.0, 0.35)])  # 2.33 s of 3.33 s, 2 m of 4 m
def test_a_square_wave_is_judged_where_its_jumps_may_have_settled(late, share):
    sign, before = (1.0 - 2.0 * ((TIME - by).clamp_min(0) // 5 % 2) for by in (0.0, late))
    found = judge(states(p=before), sign.reshape(1, -1, 1).expand(2, -1, 1).double())
    assert found.share["p"] == pytest.approx(share, abs=0.02)


def test_under_a_moving_reference_states_may_move_too_but_not_run_away():
    r = torch.sin(TIME).reshape(1, -1, 1).expand(2, -1, 1).double()
    assert not judge(states(theta=torch.sin(TIME)), r).away
    assert judge(states(theta=TIME), r).away == {"theta": 1.0}  # 40 ranges at the end
    assert not judge(states(theta=TIME), r).swings


@pytest.mark.parametrize(("lag", "controlled"), [(0.1, True), (0.5, False), (math.inf, False)])
def test_a_wave_may_be_followed_with_a_little_lag_and_not_be_ignored(lag, controlled):
    # An amplitude of .2 m in a box of 4 m: even who does nothing misses by no more than 3.2 % of the box.
    wave = 0.2 * torch.sin(TIME)
    r = wave.reshape(1, -1, 1).expand(2, -1, 1).double()
    x = states(p=0.0 * TIME if lag == math.inf else 0.2 * torch.sin(TIME - lag))
    found = judge(x, r)
    held, told = judge_control([found], 0.01)
    assert held is controlled and told.values["within"] == told.values["lost"] == 0.1
    last = slice(-100, None)
    error = (x[last, 0] - wave[last]).abs().mean().item()
    assert found.share == {"p": pytest.approx(error / 0.4, rel=1e-3)}


def test_a_target_at_rest_is_held_to_its_own_limit_beside_a_wave():
    wave = 0.2 * torch.sin(TIME)
    x = states(p=wave, theta=0.36).expand(2, -1, 3).double()
    r = torch.stack([wave, 0.0 * wave], -1).expand(2, -1, 2).double()
    trajectory = TensorDict({"state": x, "reference": r}, [2, len(TIME)])
    found = judge_tracking(Evaluation("both", SIGNATURE, (0, 1), TIME, trajectory, {}, (), (4.0, 4.0)), PLANT)
    assert found.share["theta"] == pytest.approx(0.09) and judge_control([found], 0.01)[0] is False


def test_a_state_runs_away_from_where_it_began_and_not_from_zero():
    assert not judge(states(theta=300.0 + 0.1 * torch.sin(3 * TIME))).away  # 600 ranges
    assert judge(states(theta=300.0 + TIME)).away == {"theta": 1.0}


def test_what_is_not_finite_is_lost():
    found = judge(states(*(torch.where(TIME > 1.0, lost, 0.0) for lost in (torch.inf, torch.nan))))
    assert found.share == {"p": None} and found.away == {"theta": 1.0}


def test_where_nothing_is_tracked_motion_is_no_fault_and_running_away_is():
    x = torch.stack([states(theta=0.2 * torch.sin(3 * TIME)), states(p=3.0 * TIME)]).double()
    trajectory = TensorDict({"state": x, "reference": torch.zeros(2, len(TIME), 0)}, [2, len(TIME)])
    untracked = Evaluation("task", SIGNATURE, (), TIME, trajectory, {})
    found = judge_tracking(untracked, PLANT)
    assert found == TrackingCriteria({}, {}, {"p": 0.5}, {})


TWO = Signature(("a", "b"), ("m", "rad"), ("u",), (1.0, 1.0))


def flights(starts, references, boxes=(), columns=(0, 1), rewards=None) -> Evaluation:
    """Return flights that stay where they begin, `(episodes, 3)`."""
    x = torch.tensor(starts).unsqueeze(1).expand(-1, 3, -1)
    r = torch.tensor(references).unsqueeze(1).expand(-1, 3, -1)
    paid = torch.zeros(len(starts), 3, 1) if rewards is None else torch.tensor(rewards).unsqueeze(-1)
    rows = {"state": x, "reference": r, "action": torch.zeros(len(starts), 3, 1), "next": {"reward": paid}}
    return Evaluation("s", TWO, columns, torch.arange(3.0), TensorDict(rows, x.shape[:2]), {}, boxes=boxes)


def test_where_all_begin_alike_it_is_the_first_whatever_came_of_it() -> None:
    row, words = flights([[0.0, 0.0]] * 4, [[0.5, 0.0], [0.1, 0.0], [0.9, 0.0], [0.2, 0.3]]).representative_episode
    assert row == 0
    # 0.1 and 0.3, the larger one of 0.2 and 0.3, are less than 0.5.
    assert "episode 1 of 4;" in words and "2 others" in words


@pytest.mark.parametrize(("boxes", "row"), [((), 2), ((1.0, 10.0), 1)])
def test_of_different_beginnings_it_is_the_farthest_in_boxes(boxes, row) -> None:
    found, words = flights([[0.1, 0.1], [-0.6, 0.0], [0.0, 3.0]], [[0.0, 0.0]] * 3, boxes).representative_episode
    assert found == row
    assert words.startswith(f"episode {row + 1} of 3, ")


def test_without_references_it_is_the_one_that_earns_least_at_first() -> None:
    rewards = [[-1.0, 0.0, 0.0], [-5.0, 4.0, 4.0], [-2.0, 0.0, 0.0]]
    found = flights([[0.0, 1.0], [1.0, 0.0], [2.0, 0.0]], [[0.0]] * 3, columns=(), rewards=rewards)
    row, words = found.representative_episode
    assert (row, words.partition("; ")[2]) == (1, "0 others earn more")


def test_of_a_single_episode_nothing_is_said() -> None:
    assert flights([[0.0, 0.0]], [[0.5, 0.0]]).representative_episode == (0, "")
