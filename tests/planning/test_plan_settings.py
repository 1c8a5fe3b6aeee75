"""Which settings follow from which plant."""

import math

import pytest
import torch
from plants import Linear, Plant
from scipy.linalg import solve_discrete_are

from dynasindy.agents import Actor
from dynasindy.control.period import _settles
from dynasindy.envs import ControlEnv, RandomStep, Tracking, TrackingReward
from dynasindy.planning import GradientPlanning
from dynasindy.planning.plan_settings import PlanSettings, choose_plan_settings, find_task_equilibria
from dynasindy.systems import Tras, Xi


def spring(stiffness, damping, pull):
    """x' = v, v' = stiffness x - damping v + pull u."""
    return Linear([[0.0, 1.0], [stiffness, -damping]], [[0.0], [pull]], names="xv")


def imagined(plant, dt=0.05, low=(-0.5,), high=(0.5,), outputs=("x",), rates=("v",), max_steps=400):
    ends = {"low": low, "high": high, "max_steps": max_steps}
    task = Tracking(plant.signature, RandomStep(low, high), outputs, rates, TrackingReward((4.0,)), **ends)
    return ControlEnv(plant, task, dt, 1)


def pace(*made_of, **more):
    return choose_plan_settings(env := imagined(*made_of, **more), find_task_equilibria(env))


@pytest.mark.parametrize("plant", [Tras, Xi])
def test_the_twin_rotor_keeps_the_settings_that_it_was_measured_with(plant):
    found = pace(
        plant(), low=(-0.5, -0.5), high=(0.5, 0.4), outputs=("alpha_a", "alpha_p"), rates=("Omega_a", "Omega_p")
    )
    assert (found.window, found.lr, found.updates, found.patience, found.substeps) == (60, 1e-2, 280, 3, 1)
    assert not found.warm_start and found.longest == found.window


def test_a_plant_that_runs_away_is_held_and_trained_in_smaller_steps():
    calm, wild = pace(spring(-1.0, 1.0, 4.0)), pace(spring(4.0, 0.0, 4.0))
    assert wild.warm_start and not calm.warm_start
    # p'' = 4 p: exp(2 t) doubles every ln(2) / 2 s.
    assert "unstable" in wild.why and "0.35 s" in wild.why
    # p'' = -p - p': both modes decay as exp(-t / 2), by half every 2 ln(2) s.
    assert "unstable" not in calm.why and "half every 1.4 s" in calm.why
    assert wild.lr < calm.lr


def test_a_motion_slower_than_the_window_is_planned_over_whole_where_a_phase_gains_nothing():
    """To hold p the input takes v away, which leaves v to itself: v' = -0.015 v, 7 times 67 periods."""
    plant = Plant("p v", lambda p, v, u: [v - p + u, 0.005 * u - 0.01 * v])
    env = imagined(plant, 1.0, outputs=("p",), rates=(None,), max_steps=120)
    settings = {"lr": 1e-30, "rollouts": 16, "check_every": 4, "patience": 1, "gain_range": 0.0, "warm_start": False}
    planner = GradientPlanning(env, Actor(env.task.n_o, 1, hidden=(8, 8)), **settings)
    planned = planner.plan()
    assert planner.settings()["window"] == 100 and planned.imagined <= 16 * 80 * planned.updates  # for the same price


def test_a_double_integrator_runs_away_although_no_mode_grows():
    # After 20 s a deviation of the rate has made one of 20 of the position: below the bound; after 80 s above it.
    slow = pace(spring(0.0, 0.0, 4.0), dt=0.05)
    assert not slow.warm_start and "20 times" in slow.why
    assert pace(spring(0.0, 0.0, 1.0), dt=0.2).warm_start


@pytest.mark.parametrize(("rate", "steps"), [(15.0, 1), (45.0, 3), (1e3, 34)])
def test_a_fast_mode_takes_smaller_steps(rate, steps):
    # A damping of d leaves modes near -d and -1/d: at 0.05 s a step of 1 / d takes d / 20 steps, two thirds beyond 10.
    assert pace(spring(-1.0, rate, 4.0)).substeps == steps


@pytest.mark.parametrize(("limits", "little"), [((-0.5, 0.5), False), ((0.2, 0.6), True)])
def test_the_policy_of_a_plant_whose_input_may_do_little_begins_as_a_regulator(limits, little):
    """Half of the range of the input, and a fifth of it: a stop of the log, within which its plant is known."""
    plant = spring(-1.0, 1.0, 4.0)
    env = imagined(plant, low=(0.9,), high=(2.0,))
    env = ControlEnv(plant, env.task.with_input_limits([limits[:1], limits[1:]]), 0.05, 1)
    found = choose_plan_settings(env, find_task_equilibria(env))
    assert found.warm_start == little == ("20 %" in found.why)


def test_a_plant_without_a_rest_keeps_the_defaults():
    found = pace(spring(-100.0, 1.0, 1.0), low=(0.5,))
    assert found == PlanSettings(why=found.why)
    # 0.5 m against a stiffness of 100 takes 50 of what pulls with 1.
    assert "64 of 64" in found.why and "x = 0.5" in found.why and "u = 50" in found.why


def test_without_references_a_model_takes_the_steps_of_the_plant(settle):
    plant = spring(4.0, 0.0, 1.0)  # which runs away: with targets it would be held
    env = ControlEnv(plant, settle(plant.signature))
    assert find_task_equilibria(env) is None
    found = choose_plan_settings(env, None, 5)
    assert found == PlanSettings(100, 3e-3, 400, 8, 5, why="the task has no references")


def settling(plant, v, share=0.05):
    return _settles(imagined(plant), torch.tensor([[0.0, v]] * 3), torch.zeros(3, 1), share)


ROOM = Plant("x v", lambda x, v, u: [u - 2 * x + v, 0.001 * (x - 2 * v)])
"""A heater warms the air x, and the air slowly a wall v."""


@pytest.mark.parametrize("share", [0.2, 0.05])
def test_a_slow_wall_does_not_count_where_the_air_is_held(share):
    """As if the wall stood still: x' = u - 2 x at the least cost of 100 x^2 + u^2 has its pole at -sqrt(4 + 100)."""
    assert settling(ROOM, 0.0, share) == pytest.approx(-math.log(share) / math.sqrt(104), abs=0.06)
    assert settling(ROOM, 0.0, 1e-4) > 100  # the wall takes 500 s, and the air shows a little of it


def test_the_fate_of_a_deviation_of_a_difference_equation_is_told_by_what_a_step_multiplies_it_by(mapped):
    """By -0.6 every 0.5 s it is half after 0.68 s, by -1.5 it doubles every 0.85 s, and by -1.01 every 34.8 s."""
    for a, b, told in (
        (-0.6, 1.0, "half every 0.68 s"),
        (-1.5, 2.0, "doubles every 0.85 s"),
        (-1.01, 2.0, "doubles every 35 s"),
        (1.0, 1.0, "hardly changes"),
    ):
        env = mapped(a, b)
        found = choose_plan_settings(env, find_task_equilibria(env))
        assert told in found.why and found.warm_start == (abs(a) > 1)
        assert found.substeps == 1  # whose steps are its own, however fast it is


def test_a_difference_equation_settles_as_its_regulated_map_does(mapped):
    """x[k+1] = 0.6 x + 0.4 u under the least cost of 100 x^2, in ranges of 1.6, and u^2."""
    env, a, b, q = mapped(0.6, 0.4, box=0.8), 0.6, 0.4, 100 / 1.6**2
    p = float(solve_discrete_are([[a]], [[b]], [[q]], [[1.0]]).item())
    left, periods = a / (1 + b**2 * p), 0
    while left**periods > 0.01:
        periods += 1
    places = torch.zeros(3, 1), torch.zeros(3, 1)
    assert _settles(env, *places, 0.01) == pytest.approx(0.5 * periods)
