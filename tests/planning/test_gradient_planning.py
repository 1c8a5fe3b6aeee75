"""Planning by gradient: updates as written, episodes, and what makes a plan longer."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from plants import Plant
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete
from torch import nn

from dynasindy.agents import Actor
from dynasindy.envs import ControlEnv, RandomStep, Tracking, TrackingReward
from dynasindy.planning import GradientPlanning
from dynasindy.planning import imitation as module
from dynasindy.planning.gradient_planning import _Episodes
from dynasindy.planning.imitation import _better, _starts, imagined_rewards, improve
from dynasindy.planning.plan_settings import PlanSettings
from dynasindy.planning.rollout import Rows, imagine
from dynasindy.sindy import LearnedReward
from dynasindy.systems import Diverged, Xi


@torch.no_grad()
def total(env, agent):
    return float(env.with_task(env.task).rollout(60, agent.policy)["next", "reward"].sum())


@torch.no_grad()
def flown(env, agent, steps=20):
    return env.rollout(steps, agent.policy)


def weights(policy):
    return torch.cat([p.detach().reshape(-1).clone() for p in policy.parameters()])


def test_planning_improves_the_return_in_the_real_environment(setting, small):
    env, agent, replay = setting()
    before = total(env, agent)
    planned = GradientPlanning(env, agent, replay, updates=40, lr=1e-2, **small).plan()
    after = total(env, agent)
    assert planned.updates == 40
    assert planned.imagined == 40 * 16 * 20
    assert after > 0.5 * before  # returns are negative: more than half of the cost is gone


@pytest.mark.parametrize(("settings", "held"), [({"updates": 8}, False), ({"warm_start": False}, False), ({}, True)])
def test_a_phase_goes_on_from_a_regulator_where_its_updates_lead_nowhere(mapped, settings, held):
    """With so many updates given, and where a regulator is ruled out, it ends there."""
    env = mapped(0.9, 0.2)  # stable, x[k+1] = .9 x + .2 u, so that no regulator is there at first
    actor = Actor(env.task.n_o, 1, hidden=(32, 32))
    planner = GradientPlanning(env, actor, lr=1e-9, rollouts=16, check_every=4, gain_range=0.0, **settings)
    planner.plan()
    assert (planner.imagined_error > 0.05) is (not held)
    with torch.no_grad():
        rollout = env.rollout(env.task.max_steps, actor.policy)
    error = (rollout["next", "state"][-1] - env.task.reference(rollout["task_params"][-1:], torch.ones(1, 1))).abs()
    assert float(error) < 0.05 or not held


def test_a_bound_that_weaker_inputs_cannot_keep_is_kept_by_those_of_the_model():
    """A motor without load, whose current is what its voltage is beyond the speed, over a small resistance."""
    plant = Plant("speed current", lambda w, i, u: [2 * i - 0.05 * w, 40 * (u - w - 0.1 * i)])
    ends, reward = {"low": [0.1], "high": [0.6]}, TrackingReward([4.0])
    narrow, begin = {"current": [-0.15, 0.15]}, {"speed": 0.1}
    task = Tracking(plant.signature, RandomStep(**ends), ["speed"], [], reward, 40, **ends, bounds=narrow, start=begin)
    torch.manual_seed(2)
    env, actor = ControlEnv(plant, task, 0.05, 2, batch_size=[64], seed=0), Actor(task.n_o, 1, hidden=(32, 32))
    GradientPlanning(env, actor, rollouts=16, seed=2).plan()
    with torch.no_grad():
        current = env.rollout(40, actor.policy)["next", "state"][..., 1]
    assert 0.1 < float(current.abs().max()) < 0.2  # inputs that are stronger by .3 pass .3 on the way to any target


def test_the_actor_of_the_agent_itself_learns_and_td3_goes_on_from_it(setting, small):
    env, agent, replay = setting()
    before = weights(agent.policy)
    GradientPlanning(env, agent, replay, updates=4, **small).plan()
    learnt = torch.cat([p.reshape(-1) for p in agent.loss.actor_network_params.values(True, True)])
    assert not torch.equal(weights(agent.policy), before)
    assert sorted(learnt.tolist()) == sorted(weights(agent.policy).tolist())


def test_a_policy_learns_alike_wherever_the_zero_of_a_scale_lies():
    """An oven, x' = u - y - y^3 / 5 of the distance y = x - zero from the temperature outside."""
    acts, away = [], torch.linspace(-0.5, 0.5, 11).unsqueeze(-1)
    for zero in (0.0, 16.0):
        plant = Plant("x", lambda x, u, zero=zero: [u - (x - zero) - (x - zero) ** 3 / 5])
        ends = {"low": [zero - 0.5], "high": [zero + 0.5]}
        reward = TrackingReward([4.0], error_shape="linear")
        task = Tracking(plant.signature, RandomStep(**ends), ["x"], [], reward, 60, start={"x": zero}, **ends)
        actor = Actor(task.n_o, 1, hidden=(32, 32))
        GradientPlanning(ControlEnv(plant, task), actor, updates=20, rollouts=16, window=20, check_every=10).plan()
        with torch.no_grad():
            acts.append(actor.policy.module(torch.cat([zero + away, -away], -1)))
    torch.testing.assert_close(*acts, atol=0.1, rtol=0)  # rounding grows; about zero it would be 0.4


def test_equal_seeds_plan_equally(setting, small):
    policies = []
    for _ in range(2):
        env, agent, replay = setting()
        GradientPlanning(env, agent, replay, updates=6, seed=5, **small).plan()
        policies.append(weights(agent.policy))
    assert torch.equal(*policies)


def test_the_best_policy_on_held_out_references_is_kept_and_a_phase_without_progress_ends(setting):
    env, agent, replay = setting()
    planner = GradientPlanning(env, agent, replay, updates=1000, rollouts=16, window=20, check_every=1, patience=2)
    scores = iter([-3.0, -1.0, -2.0, -2.0])
    seen = []
    planner.test = lambda: (seen.append(weights(agent.policy)), next(scores))[1]
    assert planner.plan().updates == 4
    assert torch.equal(weights(agent.policy), seen[1])


class Runaway(Xi):
    """A model that is right where the plant was excited, and explodes when the main rotor runs backwards."""

    def forward(self, x, u):
        dx = super().forward(x, u)
        backwards = (-x[..., 5:] - 150).clamp_min(0)
        return torch.cat([dx[..., :5], dx[..., 5:] - backwards**3], -1)


def test_a_model_that_explodes_elsewhere_is_still_planned_with(setting, small):
    env, agent, replay = setting()
    replay.extend_real(flown(env, agent))
    before = total(env, agent)
    planner = GradientPlanning(env.with_system(Runaway()), agent, replay, updates=40, lr=1e-2, **small)
    whole = imagine(planner.env, planner.network, _Episodes(planner).rows, 60)
    assert not whole.alive[-1].all()  # the untrained policy does run it backwards
    planner.plan()
    assert total(env, agent) > 0.5 * before


class Nowhere(Xi):
    """A model that is nowhere after its first period."""

    def forward(self, x, u):
        return super().forward(x, u) + math.inf


def test_a_model_in_which_every_episode_diverges_stops_the_phase_at_its_first_test(setting, small):
    env, agent, replay = setting(policy_average=0.01)
    before = weights(agent.policy), weights(agent.deployed)
    planner = GradientPlanning(env.with_system(Nowhere()), agent, replay, updates=40, **small)
    # Four updates up to the first test, with sixteen windows each.
    told = r"planning by gradient: 0 of 4 updates .* 64 of 64 imagined windows diverged.*the model explodes"
    with pytest.raises(Diverged, match=told):
        planner.plan()
    assert torch.equal(weights(agent.policy), before[0]) and torch.equal(weights(agent.deployed), before[1])


def test_a_reward_that_is_not_finite_is_told_from_a_model_that_explodes(setting, small):
    env, agent, replay = setting()
    before = weights(agent.policy)
    planner = GradientPlanning(env, agent, replay, updates=40, **small)
    reward = planner.env.task.reward_function
    planner.env.task.reward_function = lambda *of: reward(*of) * math.nan
    with pytest.raises(Diverged, match=r"0 of 4 .* 0 of 64 .*reward"):
        planner.plan()
    assert torch.equal(weights(agent.policy), before)


def test_a_plant_that_is_lost_is_won_back_from_the_best_policy_in_shorter_steps(setting, small):
    env, agent, replay = setting()
    settings = small | {"updates": 6, "check_every": 2, "warm_start": True, "gain_range": 0.0, "input_delay": 0.0}
    planner = GradientPlanning(env, agent, replay, **settings, lr=0.5)
    # Six regulators and the untrained policy, the imitation, then a policy that has lost the plant, a worse and a
    # better one.
    scores, rates, seen = iter([-9.0, *6 * [-2.0], -1.0, -2.1, -1.9, -0.5]), [], []

    def update(episodes, optimizer):
        rates.append(optimizer.param_groups[0]["lr"])
        seen.append(weights(planner.network))
        with torch.no_grad():
            next(planner.network.parameters()).add_(1.0)
        return True

    planner._update = update
    planner.test = lambda network=None: next(scores)
    planner.plan()
    factors = [0.5, 0.5, 0.05, 0.05, 0.05, 0.05]  # 2.1 is more than twice the cost of 1, 1.9 is not
    falls = [0.01 + 0.99 * math.cos(math.pi * k / 12) ** 2 for k in range(6)]  # half a cosine, down to 1 %
    warmed = [(k + 1) / 10 * fall for k, fall in enumerate(falls)]
    assert rates == pytest.approx([factor * rate for factor, rate in zip(factors, warmed, strict=True)])
    assert torch.equal(seen[2], seen[0]) and not torch.equal(seen[4], seen[0])  # back once, and on from there


def test_the_held_out_score_is_the_mean_reward_over_whole_episodes_from_rest(setting, small):
    env, agent, replay = setting(max_steps=12)
    planner = GradientPlanning(env, agent, replay, width=None, **small)
    params = env.task.sample(torch.Size((64,)), torch.Generator().manual_seed(1))  # the seed of the planner and one
    start = env.start_from(torch.zeros(64, 6))
    start["task_params"] = params
    start["observation"] = env.task.observation(torch.zeros(64, 6), params, torch.zeros(64, 1))
    imagined = planner.env.rollout(12, agent.policy, auto_reset=False, tensordict=start)
    assert planner.test() == pytest.approx(imagined["next", "reward"].mean().item(), rel=1e-4)


def test_the_imagined_cost_is_linear_without_a_bonus_and_the_task_keeps_its_own(setting, planned):
    planner = planned(width=0.04)
    of_task = setting()[0].task.reward_function
    expected = replace(of_task, error_shape="linear", width=0.04, bonus=0.0)
    assert planner.env.task.reward_function == expected and of_task.bonus > 0
    assert planned(width=None).env.task.reward_function == of_task
    assert (planner.env.substeps, planned(substeps=3).env.substeps) == (1, 3)


def test_what_is_not_given_follows_the_plant_and_what_is_given_stays(setting, small):
    env, agent, replay = setting()
    env.substeps = 7
    planner = GradientPlanning(env, agent, replay, updates=1, rollouts=4, lr=0.02)
    assert planner.plan().imagined == 4 * 60  # the window of the twin rotor
    assert (planner.pace.window, planner.pace.updates, planner.pace.lr) == (60, 1, 0.02)
    assert planner.env.substeps == planner.pace.substeps < 7
    planner = GradientPlanning(env, agent, replay, updates=1, substeps=3, patience=7, **small)
    planner.plan()
    assert (planner.pace.window, planner.pace.patience, planner.env.substeps) == (20, 7, 3)
    resumed = GradientPlanning(env, agent, replay)
    resumed.load_state_dict(planner.state_dict())
    assert resumed.settings() == planner.settings() != {}


def test_without_references_the_plan_is_as_good_as_the_regulator_of_the_textbook(settle):
    """The task pays a quadratic form of states and inputs, whose best law solves a Riccati equation."""
    price = 3.0
    a, b = np.array([[0.0, 1.0], [-1.0, -0.5]]), np.array([[0.0], [2.0]])
    a, b, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), 0.1)
    p = solve_discrete_are(a, b, np.eye(2), [[price]])
    gain = torch.tensor(np.linalg.solve(price + b.T @ p @ b, b.T @ p @ a), dtype=torch.float32)
    plant = Plant("x v", lambda x, v, u: [v, 2.0 * u - x - 0.5 * v])
    env = ControlEnv(plant, settle(plant.signature, price=price, max_steps=60), 0.1, 1)
    agent = Actor(2, 1, hidden=(16, 16))
    starts = env.start_from(env.task.initial_state(torch.Size((32,)), torch.Generator().manual_seed(1)))

    @torch.no_grad()
    def earned(policy):
        rollout = env.rollout(60, policy, auto_reset=False, tensordict=starts.clone(), break_when_any_done=False)
        return rollout["next", "reward"].sum().item()

    best = earned(lambda td: td.set("action", (-td["state"] @ gain.mT).clamp(-1.0, 1.0)))
    before = earned(agent.policy)
    GradientPlanning(env, agent, updates=120, rollouts=16, window=30, lr=1e-2, check_every=20, searches=0).plan()
    assert before < 1.3 * best  # returns are negative
    assert 1.1 * best < earned(agent.policy) < 0.99 * best


def test_a_quarter_begins_at_real_states_and_another_goes_on(setting, small):
    env, agent, replay = setting()
    real = flown(env, agent)
    real["state"] = torch.arange(20.0).unsqueeze(-1).expand(20, 6) + 1
    replay.extend_real(real)
    planner = GradientPlanning(env, agent, replay, **(small | {"rollouts": 4000}))
    episodes = _Episodes(planner)
    x = torch.full((4000, 6), -5.0)
    lost = torch.arange(4000) < 2000
    starts = episodes._starts(x, lost)[:, 0]
    for diverged, rows in ((False, starts[2000:]), (True, starts[:2000])):
        from_real, from_rest, on = rows > 0, rows == 0, rows == -5
        assert bool((from_real | from_rest | on).all())
        assert from_real.float().mean().item() == pytest.approx(0.25, abs=0.04)
        # Where the model diverged nothing goes on.
        assert on.float().mean().item() == pytest.approx(0.0 if diverged else 0.25, abs=0.0 if diverged else 0.04)
    assert starts[starts > 0].unique().tolist() == [float(n) for n in range(1, 21)]


def test_one_episode_of_two_is_late_by_as_much_as_may_be(setting, small):
    env, agent, _ = setting()
    planner = GradientPlanning(env, agent, **(small | {"rollouts": 4000, "input_delay": 0.7}))
    drawn = _Episodes(planner)._draw_delays()
    assert drawn.shape == (4000, 1) and sorted(drawn.unique().tolist()) == pytest.approx([0.0, 0.7])
    assert float((drawn > 0).float().mean()) == pytest.approx(0.5, abs=0.03)  # of 4000 throws of a coin


HERE, THERE, PERIODS = -0.3, 1.0, 40


SLEDGE = Plant("p", lambda p, speed: [speed], inputs="speed")
"""A sledge on a line that goes at most 1 m/s."""


def two_hills(x, u, x_next):
    """Pay half a point a period about the start, two about a place far off, and next to nothing between."""
    low, high = (torch.exp(-((x_next[..., 0] - place) ** 2) / 0.01) for place in (HERE, THERE))
    return 0.5 * low + 2.0 * high


def setting():
    env = ControlEnv(SLEDGE, LearnedReward(SLEDGE.signature, two_hills, max_steps=PERIODS), 0.1, 1)
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
