"""Ways from afar and the search for them, against Riccati's recursion, plain loops and SciPy's swing-up."""

import math

import numpy as np
import pytest
import torch
from plants import Plant, Upright, scipy_motion
from scipy.linalg import solve_discrete_are

from dynasindy.envs import ControlEnv, RandomStep, Tracking, TrackingReward
from dynasindy.planning import trajectory_library
from dynasindy.planning.plan_settings import find_task_equilibria
from dynasindy.planning.regulator import Regulator
from dynasindy.planning.rollout import Rows, imagine
from dynasindy.planning.trajectory_library import (
    NEARNESS,
    WEIGHTS,
    TrajectoryLibrary,
    _along,
    _find_caught_trajectories,
    _log_values,
    _roll,
    _search,
    at_rest,
    cross_entropy,
    signal,
)


def setting(pull=6.0, start=math.pi):
    plant = Upright(15.0, pull, scale=(math.pi, 8.0))
    reward = TrackingReward((4.0,), error_shape="linear", bonus=0.0, width=0.02)
    start = {"theta": [start - 0.05, start + 0.05]}
    task = Tracking(plant.signature, RandomStep([0.0], [0.0]), ("theta",), ("Omega",), reward, 120, start=start)
    env = ControlEnv(plant, task, 0.05, 1)
    return env, find_task_equilibria(env)


@pytest.fixture(autouse=True, scope="module")
def few():
    """Fewer starts and signals than planning takes are enough for one pole."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_library, "STARTS", 6)
        patch.setattr(trajectory_library, "POPULATION", 256)
        yield


@pytest.fixture(scope="module")
def swing(few):
    env, rests = setting()
    law, imagined = TrajectoryLibrary.of(env, rests, torch.Generator().manual_seed(0))
    assert imagined >= 6 * 256 * 30 * (20 + 40)  # starts, signals, rounds, and at least two lengths
    return env, law


def observed(env, x):
    params = env.task.sample(torch.Size((len(x),)), torch.Generator())
    return env.task.observation(x, params, torch.zeros(len(x), 1))


def test_a_pole_swings_up_and_stays_up(swing):
    """The plant is integrated by SciPy, in float64 and to 1e-9, under the law's inputs held for 0.05 s."""
    env, law = swing
    x = np.array([math.pi - 0.03, 0.1])
    for k in range(160):
        u = float(law(observed(env, torch.tensor(x[None], dtype=torch.float32)))[0, 0])
        assert abs(u) <= 1.0
        x = scipy_motion(lambda _, y, u: [y[1], 15 * math.sin(y[0]) + 6 * u], x, [u], 0.05)[-1]
        if k >= 140:
            assert abs(x[0]) < 0.01 and abs(x[1]) < 0.05


def test_a_way_from_where_the_regulator_catches_the_plant_leads_to_the_rest():
    env, rests = setting(start=0.3)
    regulator = Regulator.of(env, rests, *WEIGHTS)
    rows = Rows.start(torch.tensor([[0.3, 0.0]]), env.task.sample(torch.Size((1,)), torch.Generator()), 1)
    ways, imagined = _find_caught_trajectories(env, regulator, rows, torch.Generator().manual_seed(0))
    assert imagined == 0 and ways[0].states[0].tolist() == pytest.approx([0.3, 0.0])
    end = ways[0].states[-1].abs() / torch.tensor([math.pi, 8.0])
    assert (end < 0.05).all() and len(ways[0].states) == len(ways[0].inputs) + 1


def test_of_two_ways_the_one_is_taken_that_bears_errors_of_its_inputs():
    """Along one way the mass is held by feedback, along the other by a twentieth of that."""
    env = mass()
    regulator = Regulator.of(env, find_task_equilibria(env), *WEIGHTS)
    begun = Rows.start(torch.tensor([[1.0, 0.0]] * 8), env.task.sample(torch.Size((8,)), torch.Generator()), 1)
    way = _find_caught_trajectories(env, regulator, begun, torch.Generator())[0][0]
    points, inputs, gains, values = _along(env, regulator, way, torch.zeros(1))
    held = TrajectoryLibrary(regulator, points, inputs, gains, values)
    loose = TrajectoryLibrary(regulator, points, inputs, 0.05 * gains, values)
    found = [law._count_arrivals(env, begun, 40, torch.Generator().manual_seed(0)) for law in (held, loose)]
    assert found[0] == (8, 8) and found[1][0] == 8 > found[1][1]


def test_the_nearest_point_is_that_of_the_formula(swing):
    env, law = swing
    generator = torch.Generator().manual_seed(1)
    x = torch.tensor([2.0, 4.0]) * torch.randn(8, 2, generator=generator)
    told = law(observed(env, x))
    assert torch.equal(law(observed(env, x).reshape(2, 4, -1)), told.reshape(2, 4, 1))
    for row, u in zip(x, told, strict=True):
        best, wanted = math.inf, 0.0
        for point, held, gain, value in zip(law.points, law.inputs, law.gains, law.values, strict=True):
            away = row - point  # the rest is the origin
            far = NEARNESS * ((away[0] / math.pi) ** 2 + (away[1] / 8.0) ** 2) + math.log1p(float(away @ value @ away))
            if far < best:
                best, wanted = far, float(held[0] - gain[0] @ away)
        assert float(u[0]) == pytest.approx(min(1.0, max(-1.0, wanted)), abs=2e-3)


def test_gains_along_a_way_are_those_of_the_riccati_recursion():
    """One way by hand: sampled derivatives by central differences, then P and K backwards in NumPy."""
    env, rests = setting(start=0.9)
    regulator = Regulator.of(env, rests, *WEIGHTS)
    rows = Rows.start(torch.tensor([[0.9, 0.0]]), env.task.sample(torch.Size((1,)), torch.Generator()), 1)
    way = _find_caught_trajectories(env, regulator, rows, torch.Generator().manual_seed(0))[0][0]
    assert len(way.inputs) > 3
    _, _, gains, values = _along(env, regulator, way, torch.zeros(1))
    assert len(gains) == len(way.inputs) + 1

    def after(z):
        state, u = torch.tensor(z[None, :2]), torch.tensor(z[None, 2:])
        return env.advance(state, u)[0][0, -1].numpy()

    q = np.diag([10.0, 1.0 / 64.0])  # outputs 10 over boxes of 1; states 1 over 8 squared
    p = regulator.cost.double().numpy()
    for i, k in enumerate(range(len(way.inputs) - 1, -1, -1), start=1):
        z = np.concatenate([way.states[k].double().numpy(), way.inputs[k].double().numpy()])
        slope = np.stack([(after(z + h) - after(z - h)) / 2e-5 for h in 1e-5 * np.eye(3)], -1)
        a, b = slope[:, :2], slope[:, 2:]
        gain = np.linalg.solve(np.eye(1) + b.T @ p @ b, b.T @ p @ a)
        closed = a - b @ gain
        p = q + gain.T @ gain + closed.T @ p @ closed  # Joseph's form
        np.testing.assert_allclose(gains[i].numpy(), gain, rtol=2e-3, atol=2e-3)
        np.testing.assert_allclose(values[i].numpy(), p, rtol=5e-3, atol=5e-3)


def test_a_plant_that_nothing_lifts_has_no_ways(monkeypatch):
    monkeypatch.setattr(trajectory_library, "LENGTHS", (20, 40))
    env, rests = setting(pull=0.02)
    assert TrajectoryLibrary.of(env, rests, torch.Generator().manual_seed(0))[0] is None


def mass(target=0.0, **kwargs):
    """A mass on a line, pushed by at most 1 m/s^2."""
    plant = Plant("p v", lambda p, v, push: [v, push], inputs="push")
    reward = TrackingReward((4.0,), rate_weight=0.0, bonus=0.0, error_shape="linear", width=0.02)
    task = Tracking(plant.signature, RandomStep([target], [target]), ("p",), ("v",), reward, max_steps=40, **kwargs)
    return ControlEnv(plant, task, 0.1, 1)


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


def test_a_way_counts_where_it_is_nearest_to_rest_by_the_regulators_value_until_it_leaves_the_limits():
    """The value is x' P x; P solves the discrete Riccati equation of the mass, here by SciPy."""
    env = mass(bounds={"p": 2.0})
    regulator = Regulator.of(env, find_task_equilibria(env), *WEIGHTS)
    a, b = np.array([[1, 0.1], [0, 1.0]]), np.array([[0.005], [0.1]])
    found = solve_discrete_are(a, b, np.diag([10.0, 1.0]), np.eye(1))
    ways = torch.tensor([[[1.0, 0.0], [0.5, -1.0], [2.1, 0.0], [0.0, 0.0]], [[-2.0, 0.5]] * 3 + [[math.nan, 0.0]]])
    told = _log_values(regulator, ways.transpose(0, 1), torch.zeros(2, 1)).mT
    wanted = [
        [math.log(np.array(x) @ found @ np.array(x)) for x in way] for way in ([[1, 0], [0.5, -1]], [[-2, 0.5]] * 3)
    ]
    assert told[0, :2].tolist() == pytest.approx(wanted[0], rel=1e-3) and told[0, 2:].isinf().all()
    assert told[1, :3].tolist() == pytest.approx(wanted[1], rel=1e-3) and told[1, 3] == math.inf
    free = mass()  # of no limits: what runs away has no value, and the rest the least
    regulator = Regulator.of(free, find_task_equilibria(free), *WEIGHTS)
    ways = torch.tensor([[[0.0, 0.0]], [[1e30, -1e30]], [[1e-3, 0.0]]])
    told = _log_values(regulator, ways, torch.zeros(1, 1)).flatten().tolist()
    assert math.isfinite(told[0]) and told[1:] == [math.inf, math.inf]


def test_the_search_finds_the_quick_way_home():
    """From 1 m at rest: full push one way, then the other, takes 2 sqrt(1 / 1) = 2 s, which is 20 periods."""
    env = mass()
    regulator = Regulator.of(env, find_task_equilibria(env), *WEIGHTS)
    x = torch.tensor([[1.0, 0.0], [-1.0, 0.0]])
    ways = _search(env, regulator, x, torch.zeros(2, 1), 22, torch.Generator().manual_seed(0))
    assert ways.states.shape == (23, 2, 2) and ways.inputs.shape == (22, 2, 1)
    torch.testing.assert_close(ways.states, _roll(env, ways.states[0], ways.inputs))
    assert ways.states.abs().amax(-1).amin(0).max() < 0.1 and ways.states[:15].abs().amax(-1).min() > 0.1
    sign = torch.tensor([[1.0], [-1.0]])
    assert (sign * ways.inputs[2] < -0.5).all() and (sign * ways.inputs[15] > 0.3).all()


def test_an_episode_too_short_for_a_slow_plant_is_on_its_way_to_rest_and_one_that_goes_elsewhere_is_not():
    plant = Plant("x", lambda x, u: [0.2 * (u - x)])
    reward = TrackingReward((4.0,), error_shape="linear", bonus=0.0, width=0.02)
    task = Tracking(plant.signature, RandomStep([0.5], [0.5]), ("x",), (None,), reward, max_steps=60)
    env = ControlEnv(plant, task, 0.02, 1)
    rows = Rows.draw(env, 4, torch.Generator().manual_seed(0))
    slow = Regulator.of(env, find_task_equilibria(env), 1e-3, 1e-3)
    for pilot, arrives in ((slow, True), (lambda observation: 0.0 * slow(observation) - 0.5, False)):
        end = imagine(env, pilot, rows, 60).states[-1]
        assert float((end - 0.5).abs().min()) > 0.05
        assert at_rest(env, pilot, slow, rows, 60).tolist() == [arrives] * 4
        assert at_rest(env, pilot, slow, rows, 10).tolist() == [arrives] * 4
    # From 1 to -1.6, it is nearer to 0.5 at the end than 20 periods before, for it has just come by.
    start, ends = Rows.start(torch.ones(4, 1), rows.params, rows.held.shape[1]), list[bool]()
    for periods in (40, 60):
        end = imagine(env, by := lambda observation: 0.0 * slow(observation) - 1.6, start, periods).states[-1]
        ends.append(bool((end > 0.5).all()))
    assert ends == [True, False] and not at_rest(env, by, slow, start, 60).any()
