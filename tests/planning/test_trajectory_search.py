"""The search over signals against hand computations, and on a plant whose way home physics knows."""

import math

import pytest
import torch

from dynasindy.envs import ControlEnv, RandomStep, Tracking, TrackingReward
from dynasindy.planning.trajectory_library import FAR, OUTSIDE, _objective, _roll, _search, cross_entropy, signal
from dynasindy.systems import Signature, System


class Mass(System):
    """A mass on a line, pushed by at most 1 m/s^2."""

    def __init__(self):
        super().__init__(Signature(("p", "v"), ("m", "m/s"), ("push",), (1.0, 1.0)))

    def forward(self, x, u):
        return torch.stack((x[..., 1], u[..., 0]), -1)


def setting(target=0.0, **kwargs):
    plant = Mass()
    reward = TrackingReward((4.0,), rate_weight=0.0, bonus=0.0, error_shape="linear", width=0.02)
    task = Tracking(plant.signature, RandomStep([target], [target]), ("p",), ("v",), reward, max_steps=40, **kwargs)
    return ControlEnv(plant, task, 0.1, 1)


def rows(env, x):
    params = env.task.sample(torch.Size((len(x),)), torch.Generator().manual_seed(0))
    return torch.tensor(x), params


def test_a_signal_runs_straight_between_its_knots_and_stays_within_the_inputs():
    knots = torch.tensor([[[0.0], [1.5], [-0.5]]])
    # Five periods through three knots: knots at periods 0, 2 and 4.
    wanted = torch.tensor([0.0, 0.75, 1.0, 0.5, -0.5])
    torch.testing.assert_close(signal(knots, 5, lambda u: u.clamp(-1.0, 1.0))[:, 0, 0], wanted)


def test_cross_entropy_finds_the_top_of_a_hill_for_each_start_and_no_less_than_it_began_with():
    top = torch.tensor([[[0.4], [-0.7]], [[1.2], [0.3]]])
    seen = []

    def height(drawn):
        hill = -(drawn.reshape(2, -1, 2, 1) - top.unsqueeze(1)).square().sum((2, 3)).flatten()
        seen.append(hill.reshape(2, -1)[:, 0])
        return hill

    found = cross_entropy(height, torch.zeros(2, 2, 1), 128, range(25), 1.0, torch.Generator().manual_seed(0))
    # The second start's first knot may not grow beyond 1.
    torch.testing.assert_close(found, top.clamp(-1.0, 1.0), atol=0.02, rtol=0.0)
    torch.testing.assert_close(seen[0], -top.square().sum((1, 2)))  # what it began with, then the best so far
    assert (torch.stack(seen).diff(dim=0) >= 0).all()


def test_the_end_of_a_way_counts_by_the_square_of_its_time():
    """Cost 4 e^2 / (0.02 + e): periods at errors of 1, 0 and 0.5 m have weights 1, 4 and 9 of 14."""
    env = setting()
    states = torch.tensor([[[9.0, 0.0]], [[1.0, 0.0]], [[0.0, 0.0]], [[0.5, 0.0]]])
    _, params = rows(env, [[9.0, 0.0]])
    wanted = -(1 * 4 * 1.0 / 1.02 + 9 * 4 * 0.25 / 0.52) / 14
    assert _objective(env, states, params).item() == pytest.approx(wanted, rel=1e-5)


def test_a_way_pays_for_leaving_the_limits_of_the_plant_and_for_running_away():
    env = setting(bounds={"p": 2.0})
    _, params = rows(env, [[0.0, 0.0]])
    inside = torch.tensor([[[0.0, 0.0]], [[-2.0, 0.0]], [[2.0, 0.0]], [[0.0, 0.0]]])  # as at stops that are the limits
    paid, gone = _objective(env, inside, params), FAR * OUTSIDE
    for beyond, cost in ((2.1, OUTSIDE / 14), (-2.1, OUTSIDE / 14), (math.nan, gone), (math.inf, gone)):
        outside = inside.clone()
        outside[1, 0, 0] = beyond  # weight 1 of 1 + 4 + 9; what ran away has not come back
        assert (paid - _objective(env, outside, params)).item() == pytest.approx(cost, rel=0.01)


def test_the_search_finds_the_quick_way_home():
    """From 1 m at rest: full push one way, then the other, takes 2 sqrt(1 / 1) = 2 s, which is 20 periods."""
    env = setting()
    x, params = rows(env, [[1.0, 0.0], [-1.0, 0.0]])
    ways = _search(env, x, params, 32, torch.Generator().manual_seed(0))
    assert ways.states.shape == (33, 2, 2) and ways.inputs.shape == (32, 2, 1)
    torch.testing.assert_close(ways.states, _roll(env, ways.states[0], ways.inputs))
    assert ways.states[22:].abs().max() < 0.1
    sign = torch.tensor([[1.0], [-1.0]])
    assert (sign * ways.inputs[2] < -0.5).all() and (sign * ways.inputs[15] > 0.3).all()
