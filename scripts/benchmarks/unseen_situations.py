"""Situations that no policy was trained for and no setting was tuned on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.disturbances import SensorNoise
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate, step_references
from dynasindy.sensing import Sensing
from dynasindy.tasks import Reference, Step, Task, Tracking

Course = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Reference and its rate, `(*batch, n_r)` each, at times `(*batch, 1)` [s]."""


class Flight(Tracking):
    """A tracking task whose reference is any function of time, or that begins anywhere.

    Args:
        task: A tracking task; its reward and observation stay.
        course: The reference; that of the task if omitted.
        spread: Start states are drawn uniformly within this part of the states' ranges, to both sides of zero.
    """

    def __init__(self, task: Task, course: Course | None = None, spread: float = 0.0) -> None:
        assert isinstance(task, Tracking)
        super().__init__(
            task.signature,
            task.references,
            task.output_names,
            task.rate_names,
            task.reward_function,
            task.max_steps,
            task.observe_rate,
            task.error_scale,
        )
        self.course, self.spread = course, spread

    def with_reference(self, reference: Reference) -> Flight:
        """Return the same flight, along the course if it has one."""
        return Flight(super().with_reference(reference), self.course, self.spread)

    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw states, `(*batch, n_x)`."""
        scale = torch.tensor(self.signature.x_scale)
        return self.spread * scale * (2 * torch.rand(*batch, len(scale), generator=generator) - 1)

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return super().reference(params, t) if self.course is None else self.course(t)[0].to(params)

    def error(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return e = desired - actual, `(*batch, n_r)`."""
        return self.reference(params, t) - x[..., self.outputs]

    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return what the task shows, with the rate of the course where it shows one."""
        seen = super().observation(x, params, t)
        if self.course is not None and self.observe_rate:
            seen = torch.cat([seen[..., : -self.n_r], self.course(t)[1].to(seen)], -1)
        return seen


def ramps(times: Sequence[float], targets: Sequence[Sequence[float]]) -> Course:
    """Return a course of straight lines between targets.

    Args:
        times: When each target is met [s], increasing.
        targets: One list of targets per time, `(n, n_r)` [rad].
    """
    at = torch.tensor(list(times), dtype=torch.float64)
    met = torch.tensor([list(row) for row in targets], dtype=torch.float64)
    slopes = (met[1:] - met[:-1]) / (at[1:] - at[:-1]).unsqueeze(-1)

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        piece = (torch.searchsorted(at, t.double().contiguous(), right=True) - 1).clamp(0, len(slopes) - 1).squeeze(-1)
        return met[piece] + slopes[piece] * (t - at[piece].unsqueeze(-1)), slopes[piece]

    return _course


def stairs(targets: Sequence[Sequence[float]], seconds: float) -> Course:
    """Return a course that holds one target after the other.

    Args:
        targets: One list of targets per stair, `(n, n_r)` [rad].
        seconds: Length of a stair [s].
    """
    held = torch.tensor([list(row) for row in targets], dtype=torch.float64)

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        # A stair begins at its own time, which sums of control periods may miss by a rounding error.
        stair = ((t.double() + 1e-6) / seconds).long().clamp(0, len(held) - 1).squeeze(-1)
        return held[stair], torch.zeros_like(held[stair])

    return _course


def chirp(amplitude: Sequence[float], frequency: float, seconds: float) -> Course:
    """Return a sine whose frequency rises evenly from zero.

    Args:
        amplitude: One per output [rad].
        frequency: At the end [Hz].
        seconds: Length of the sweep [s].
    """
    size, growth = torch.tensor(list(amplitude), dtype=torch.float64), math.pi * frequency / seconds

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        angle = growth * t.double().square()
        return size * torch.sin(angle), size * 2 * growth * t.double() * torch.cos(angle)

    return _course


def rim(low: Sequence[float], high: Sequence[float], beyond: float = 0.0) -> list[list[float]]:
    """Return 16 targets on the edge of the target ranges of two outputs, its corners among them, five to a side.

    Args:
        low: Lower ends [rad].
        high: Upper ends [rad].
        beyond: Part by which the ranges are made larger about their centres.
    """
    sides = [k / 2 - 1 for k in range(5)]
    places = [(a, b) for a in sides for b in sides if max(abs(a), abs(b)) == 1]
    middle = [(one + other) / 2 for one, other in zip(low, high)]
    half = [(1 + beyond) * (other - one) / 2 for one, other in zip(low, high)]
    return [[m + h * s for m, h, s in zip(middle, half, place)] for place in places]


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


def judge_holding(
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
        "away": (env.with_task(Flight(env.task, spread=SPREAD)), Scenario("away", steps, 64)),
        "noise_in_flight": (env, Scenario("noise_in_flight", steps, 64, wrappers=noisy)),
    }
    for name, (plant, scenario) in flights.items():
        result = evaluate(plant, policy, scenario, sensing)
        yield name, "mean_abs_error_last_5s", result, result.metrics["steady_state_error"]
    yield _stairs(env, policy, sensing)


def judge_following(env: ControlEnv, policy: Policy, sensing: Sensing | None = None) -> Iterable[Judged]:
    """Yield the same of a policy that was trained to follow steps, sines and squares."""
    for name, course, seconds in (("ramp", ramps(TIMES, TARGETS), TIMES[-1]), ("chirp", chirp(*SWEEP), SWEEP[2])):
        result = evaluate(env.with_task(Flight(env.task, course)), policy, Scenario(name, seconds=seconds), sensing)
        yield name, "rmse", result, result.metrics["rmse"]
    yield _stairs(env, policy, sensing)


def _stairs(env: ControlEnv, policy: Policy, sensing: Sensing | None) -> Judged:
    """Return the errors at the ends of the stairs, one row per stair."""
    flight = Flight(env.task, stairs(LEVELS, STAIR))
    result = evaluate(env.with_task(flight), policy, Scenario("staircase", seconds=STAIR * len(LEVELS)), sensing)
    error = (result.references - result.outputs).abs()[0]
    ends = torch.chunk(error, len(LEVELS))
    return (
        "staircase",
        "mean_abs_error_last_5s",
        result,
        torch.stack([end[-round(HELD / env.dt) :].mean(0) for end in ends]),
    )
