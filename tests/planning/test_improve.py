"""Ways over the border that a gradient cannot see, on a plant whose best way is known by hand."""

from types import SimpleNamespace

import pytest
import torch
from torch import nn

from dynasindy.agents import Actor
from dynasindy.envs import ControlEnv
from dynasindy.planning import GradientPlanning
from dynasindy.planning import imitation as module
from dynasindy.planning.imitation import _better, _starts, imagined_rewards, improve
from dynasindy.planning.plan_settings import PlanSettings
from dynasindy.planning.rollout import Rows, imagine
from dynasindy.sindy import LearnedReward
from dynasindy.systems import Signature, System

HERE, THERE, PERIODS = -0.3, 1.0, 40


class Sledge(System):
    """A sledge on a line that goes at most 1 m/s."""

    def __init__(self):
        super().__init__(Signature(("p",), ("m",), ("speed",), (1.0,)))

    def forward(self, x, u):
        return u


def two_hills(x, u, x_next):
    """Pay half a point a period about the start, two about a place far off, and next to nothing between."""
    low, high = (torch.exp(-((x_next[..., 0] - place) ** 2) / 0.01) for place in (HERE, THERE))
    return 0.5 * low + 2.0 * high


def setting():
    env = ControlEnv(Sledge(), LearnedReward(Sledge().signature, two_hills, max_steps=PERIODS), 0.1, 1)
    env.task = env.task.with_starts(torch.tensor([[HERE]], dtype=torch.float64))
    rows = Rows(torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1, 0), torch.zeros(1, 1))
    return env, rows


def lazy():
    """Return a policy that rests where it is."""
    network = nn.Sequential(nn.Linear(1, 32), nn.ReLU(), nn.Linear(32, 1), nn.Tanh())
    nn.init.zeros_(network[2].weight)
    nn.init.zeros_(network[2].bias)
    return network


def earned(env, network):
    x = torch.tensor([[HERE]])
    rows = Rows(x, torch.zeros(1, 1), torch.zeros(1, 0), torch.zeros(1, 1))
    return float(imagined_rewards(env, imagine(env, network, rows, PERIODS)).sum())


STAYED = 0.5 * PERIODS
GONE = sum(float(two_hills(None, None, torch.tensor([min(HERE + 0.1 * k, THERE)]))) for k in range(1, PERIODS + 1))
"""13 periods at full speed, then the far hill: 27 periods of two points and what lies on the way."""


def test_the_best_way_is_that_over_the_border():
    env, rows = setting()
    rng, network = torch.Generator().manual_seed(0), lazy()
    begun = _starts(network, env, rows, rng, PERIODS)
    way = _better(network, env, begun, rng, PERIODS)
    found = imagined_rewards(env, way).sum(0)
    assert earned(env, network) == pytest.approx(STAYED)
    assert float(found.min()) >= STAYED - 1e-4  # no less than the policy
    assert float(found.mean()) > 0.85 * GONE
    assert float(found.max()) <= GONE + 1.0 + 1e-4  # one who goes round the first hill quicker than by hand is not


def test_the_gradient_alone_stays_and_imitation_of_ways_goes(monkeypatch):
    monkeypatch.setattr(module, "UPDATES", 800)
    env, rows = setting()
    network, rng = lazy(), torch.Generator().manual_seed(0)
    slope = torch.autograd.functional.jacobian(lambda p: two_hills(None, None, p), torch.tensor([HERE]))
    assert abs(float(slope)) < 1e-6
    planner = SimpleNamespace(network=network, env=env, held_out=rows, rng=rng, searches=2)
    planner.test, planner.pace = lambda: earned(env, network), PlanSettings(window=PERIODS)
    done = improve(planner)
    assert done.score == pytest.approx(earned(env, network))
    assert done.score > 0.85 * GONE
    assert done.updates == 1600 and done.imagined >= module.STARTS * PERIODS * module.POPULATION


def test_what_comes_after_divergence_earns_as_little_as_the_worst_before():
    env, rows = setting()
    rows = Rows(torch.tensor([[0.95], [0.0]]), torch.zeros(2, 1), torch.zeros(2, 0), torch.zeros(2, 1))
    rows.reach = torch.tensor([1.02])
    window = imagine(env, lambda o: torch.ones(2, 1), rows, 2)
    found = imagined_rewards(env, window)
    p = torch.tensor([[0.1], [0.2]])
    wanted = two_hills(None, None, p)
    torch.testing.assert_close(found[:, 1], wanted)
    assert found[:, 0].tolist() == pytest.approx([float(wanted.min())] * 2)
    rows.reach = torch.tensor([1e-9])
    window = imagine(env, lambda o: torch.ones(2, 1), rows, 2)
    assert imagined_rewards(env, window).isneginf().all()


def test_planning_searches_where_there_are_no_references(monkeypatch):
    monkeypatch.setattr(module, "UPDATES", 50)
    monkeypatch.setattr(module, "STARTS", 8)
    planned, scores = [], []
    for searches in (0, 2):
        env, _ = setting()
        planner = GradientPlanning(env, Actor(1, 1, hidden=(8,)), updates=3, rollouts=4, searches=searches)
        planned.append(planner.plan())
        scores.append(planner.test())
    assert [found.updates for found in planned] == [3, 103]
    assert planned[1].imagined > planned[0].imagined
    assert scores[1] >= scores[0]
