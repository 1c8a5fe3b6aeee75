"""Situations that no policy was trained for and no setting was tuned on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import torch
from torch import Tensor

from benchmarks.courses import Flight, chirp, ramps, rim, stairs
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.disturbances import SensorNoise
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate, step_references
from dynasindy.sensing import Sensing
from dynasindy.tasks import Step, Tracking

BEYOND = 0.2
"""Part by which targets lie outside of the range of the training targets, about its centre."""
SPREAD = 0.5
"""Part of each state's range within which flights away from rest begin."""
STAIR, HELD = 10.0, 5.0
"""Length of a stair, and of its end that counts as steady [s]."""
LEVELS = [[0.2, 0.3], [0.45, -0.1], [0.1, -0.45], [-0.2, 0.1], [-0.45, 0.35], [0.3, -0.3], [0.4, 0.2], [-0.1, 0.0]]
"""Targets of the stairs, azimuth and pitch [rad]."""
TIMES = [0.0, 2.0, 12.0, 17.0, 37.0, 42.0, 46.0, 50.0]
TARGETS = [[0.0, 0.0], [0.0, 0.0], [0.4, 0.3], [0.4, 0.3], [-0.4, -0.4], [-0.4, -0.4], [0.0, 0.0], [0.0, 0.0]]
"""Where the ramps turn [s], and the targets there [rad]."""
SWEEP = ([0.2, 0.15], 0.2, 60.0)
"""Amplitudes of the chirp [rad], its last frequency [Hz], four times that of any training wave, and its length [s]."""

Judged = tuple[str, str, Evaluation, Tensor]


def holding(
    env: ControlEnv,
    policy: Policy,
    low: Sequence[float],
    high: Sequence[float],
    noise: Sequence[float],
    seed: int,
    sensing: Sensing | None = None,
) -> Iterable[Judged]:
    """Yield name, metric, flights and errors `(rows, n_r)` of a policy that was trained to hold targets.

    Args:
        env: The plant.
        policy: The policy.
        low: Lower ends of the targets it was trained on [rad].
        high: Upper ends [rad].
        noise: Standard deviation of the measurement of each state in flight; the training data were exact.
        seed: Of the noise on states that are seen as they are.
        sensing: Sensors and observer through which the policy sees the plant, the noise on what they measure.
    """
    steps = step_references(low, high, 64)
    noisy = [partial(SensorNoise, std=noise, seed=seed)]
    flights = {
        "step": (env, Scenario("step", steps, 64)),
        "edges": (env, Scenario("edges", Step(rim(low, high)), 16)),
        "beyond": (env, Scenario("beyond", Step(rim(low, high, BEYOND)), 16)),
        "away": (env.with_task(Flight(_task(env), spread=SPREAD)), Scenario("away", steps, 64)),
        "noise_in_flight": (env, Scenario("noise_in_flight", steps, 64, wrappers=noisy)),
    }
    for name, (plant, scenario) in flights.items():
        result = evaluate(plant, policy, scenario, sensing)
        yield name, "mean_abs_error_last_5s", result, result.metrics["steady_state_error"]
    yield _stairs(env, policy, sensing)


def following(env: ControlEnv, policy: Policy, sensing: Sensing | None = None) -> Iterable[Judged]:
    """Yield the same of a policy that was trained to follow steps, sines and squares."""
    for name, course, seconds in (("ramp", ramps(TIMES, TARGETS), TIMES[-1]), ("chirp", chirp(*SWEEP), SWEEP[2])):
        result = evaluate(env.with_task(Flight(_task(env), course)), policy, Scenario(name, seconds=seconds), sensing)
        yield name, "rmse", result, result.metrics["rmse"]
    yield _stairs(env, policy, sensing)


def _stairs(env: ControlEnv, policy: Policy, sensing: Sensing | None) -> Judged:
    """Return the errors at the ends of the stairs, one row per stair."""
    flight = Flight(_task(env), stairs(LEVELS, STAIR))
    result = evaluate(env.with_task(flight), policy, Scenario("staircase", seconds=STAIR * len(LEVELS)), sensing)
    error = (result.references - result.outputs).abs()[0]
    ends = torch.chunk(error, len(LEVELS))
    return (
        "staircase",
        "mean_abs_error_last_5s",
        result,
        torch.stack([end[-round(HELD / env.dt) :].mean(0) for end in ends]),
    )


def _task(env: ControlEnv) -> Tracking:
    """Return the task of an environment.

    Raises:
        TypeError: It tracks no reference.
    """
    if not isinstance(env.task, Tracking):
        raise TypeError(f"task {type(env.task).__name__} tracks no reference; give an environment with a Tracking task")
    return env.task
