"""Fixed situations in which controllers are compared, and how a policy is run in them.

A scenario is a reference, a number of rows (one per drawn reference, run as one batch) and a length. It may
replace the plant, for the whole run or within windows of time, and what lies between policy and plant:
`dynasindy.evaluation.disturbances` has wind, detuned parameters, sensor noise and a delayed actuator.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import pydantic
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dynasindy.agents.replay import require_finite_rollout
from dynasindy.control.controller import acting
from dynasindy.control.observer import Observer
from dynasindy.control.sensing import Sensing
from dynasindy.envs import ControlEnv, Reference, Step, Tracking
from dynasindy.envs.control_env import FARTHEST
from dynasindy.evaluation.disturbances import SensorNoise
from dynasindy.evaluation.metrics import CONTROL, STEP, TRACKING, Summary, steady_seconds, tracking_metrics
from dynasindy.findings import Finding, note, weak
from dynasindy.limits import Positive, check_memory
from dynasindy.progress import report_progress
from dynasindy.safe_io import checked_class, file_name, write_csv, write_json
from dynasindy.systems import Signature, System
from dynasindy.systems.base import WHOLE, turn_of
from dynasindy.text import format_duration

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Reads `observation` (or `state` and `reference`) of a tensordict and writes `action`."""
PolicyWrapper = Callable[[Policy, ControlEnv], Policy]
Window = tuple[float, float]
INSIDE = 0.75
"""Part of the ends of a state that bounds are proposed at, where an environment ends runs beyond them."""
RESTLESS = 0.01
"""Mean change of an input from one control period to the next, in the steady state, beyond which it is told [ranges of
the input]."""
ROUNDING = 1e-4
"""What a reference may lie beyond its ends by, as float32 rounds it [ranges of the targets]."""
SINGLE = 1e-6
"""The same as a share of the ends themselves, where the range is none or small."""


@checked_class
@pydantic.dataclasses.dataclass(frozen=True, config={"arbitrary_types_allowed": True})
class Scenario:
    """One fixed situation.

    Attributes:
        name: Short name, also of its files and rows in tables.
        reference: What to track; None draws from the environment's own task, always the same for a seed, and is all
            that a task without references takes.
        episodes: Rows of the batch, one reference each.
        seconds: Length of the run [s]; None is `lengths` episodes of the task.
        plant: Makes the disturbed plant from the nominal one; None leaves it as it is.
        windows: Times `(start, end)` at which the disturbed plant holds [s]; None is the whole run.
        wrappers: What lies between policy and plant, in order; each gets the policy and the environment.
        seed: Of drawn references and initial states.
        lengths: Length of the run, where `seconds` does not say it [lengths of an episode].

    Raises:
        ValueError: The name is none of a file, `episodes`, `lengths` or `seconds` is not positive, or the windows are
            not in order within the run.
    """

    name: str
    reference: Reference | None = None
    episodes: Positive = 1
    seconds: Annotated[float, pydantic.Field(gt=0)] | None = 20.0
    plant: Callable[[System], System] | None = None
    windows: Sequence[Window] | None = None
    wrappers: Sequence[PolicyWrapper] = ()
    seed: int = 0
    lengths: Annotated[float, pydantic.Field(gt=0)] = 1.0

    def __post_init__(self) -> None:
        file_name(self.name, "scenario")
        end = math.inf if self.seconds is None else self.seconds
        edges = [0.0, *(edge for window in self.windows or () for edge in window), end]
        if any(start > end for start, end in pairwise(edges)):
            raise ValueError(
                f"windows of scenario '{self.name}' must be (start, end) pairs in order within 0 and {end} s"
            )

    def length(self, env: ControlEnv) -> float:
        """Return how long the run is where it is flown [s].

        Raises:
            ValueError: It is shorter than a control period.
        """
        seconds = self.seconds or self.lengths * env.task.max_steps * env.dt
        if round(seconds / env.dt) < 1:
            raise ValueError(f"scenario.seconds is {seconds} s; give a control period of {env.dt} s or more")
        return seconds


@dataclass(frozen=True)
class Evaluation:
    """What came of a policy in a scenario.

    Attributes:
        scenario: Name of the scenario.
        signature: Names and units of the plant.
        columns: Indices of the tracked states; none of a task without references.
        time: `(T,)` times of the root entries of the trajectory [s].
        trajectory: `[episodes, T]` as `ControlEnv.rollout` writes it; behind sensors, `estimate` is what was seen.
        metrics: Per row, see `dynasindy.evaluation.metrics`.
        windows: Times `(start, end)` at which the plant was disturbed [s], where that was not all the time.
        boxes: Extents of the outputs' targets, `(n_r,)`, of an angle one turn at most; one of each unit if empty.
        ends: Lower and upper end of the targets of each tracked state [its unit]; empty if no task tells them.
    """

    scenario: str
    signature: Signature
    columns: tuple[int, ...]
    time: Tensor
    trajectory: TensorDictBase
    metrics: dict[str, Tensor]
    windows: tuple[Window, ...] = ()
    boxes: tuple[float, ...] = ()
    ends: tuple[tuple[float, float], ...] = ()

    @property
    def steady_seconds(self) -> float:
        """Length of its final part, which counts as steady state [s]."""
        return steady_seconds(self.seconds / len(self.time), len(self.time))

    @property
    def steady_periods(self) -> int:
        """Number of control periods at its end that count as steady; where references jump, two thirds of a hold."""
        usual = round(self.steady_seconds / (self.seconds / len(self.time)))
        jumps = (self.references.diff(dim=1) != 0).any(-1)
        ends = [[-1, *row.nonzero().flatten().tolist(), len(self.time) - 1] for row in jumps]
        longest = max((b - a for row in ends for a, b in pairwise(row)), default=usual)
        return min(usual, 2 * longest // 3) if 2 * longest > usual else usual  # of a wave none is held

    @property
    def resting(self) -> Tensor:
        """Whether the references of each episode rest in the steady state, bool `(episodes,)`."""
        last = self.references[:, -self.steady_periods :]
        return (last == last[:, -1:]).all(-1).all(-1)

    @property
    def told_steady_seconds(self) -> float | None:
        """Length of the steady state in a table to read [s]; None where no reference rests, as that of a sine."""
        return self.steady_seconds if bool(self.resting.any()) else None

    @property
    def title(self) -> str:
        """What a table of it was measured on; errors and returns compare at equal lengths only."""
        count, what = len(self.outputs), "reference" if self.columns else "episode"
        facts = [f"{count} {what}{'s' * (count > 1)}", format_duration(self.seconds)]
        windows = ([format_duration(edge, self.seconds) for edge in window] for window in self.windows)
        facts += [f"disturbed from {begin} to {end}" for begin, end in windows]
        return f"Scenario '{self.scenario}' ({', '.join(facts)})"

    @property
    def units(self) -> dict[str, str]:
        """Unit of each tracked state."""
        return {name: self.state_units[name] for name in self.output_names}

    @property
    def state_units(self) -> dict[str, str]:
        """Unit of each state."""
        return dict(zip(self.signature.state_names, self.signature.state_units, strict=True))

    @property
    def state_order(self) -> list[int]:
        """Indices of all states, those that are tracked first."""
        return [*self.columns, *(k for k in range(self.signature.n_x) if k not in self.columns)]

    @property
    def seconds(self) -> float:
        """Length of the run [s]."""
        return float(self.time[-1] + self.time[1] - self.time[0])

    @property
    def outputs(self) -> Tensor:
        """Tracked states, `(episodes, T, n_r)`."""
        return self.trajectory["state"][..., list(self.columns)]

    @property
    def references(self) -> Tensor:
        """References, `(episodes, T, n_r)`."""
        return self.trajectory["reference"]

    @property
    def inputs(self) -> Tensor:
        """Inputs, `(episodes, T, n_u)`."""
        return self.trajectory["action"]

    @property
    def returns(self) -> Tensor:
        """Sums of rewards, `(episodes,)`."""
        return self.trajectory["next", "reward"].sum((-1, -2))

    @property
    def errors(self) -> Tensor:
        """Absolute errors, `(episodes, T, n_r)` float64 [target ranges]."""
        boxes = torch.tensor(self.boxes or (1.0,) * len(self.columns), dtype=torch.float64)
        return (self.outputs - self.references).double().abs() / boxes

    @property
    def lost(self) -> Tensor:
        """Whether the plant left all sensible states in an episode, so that it was over, bool `(episodes,)`."""
        states = self.trajectory["next", "state"]
        ends = FARTHEST * torch.tensor(self.signature.x_scale, dtype=states.dtype)
        return (states.abs() >= ends).any(-1).any(-1)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the tracked states."""
        return tuple(self.signature.state_names[i] for i in self.columns)

    @property
    def representative_episode(self) -> tuple[int, str]:
        """The episode to be drawn, by nothing that a controller does: figures of several show the same one.

        Its row in the evaluation stands beside which it is, why this one, and how many did better; the only one has no
        such words.

        Where all episodes begin in one state it is the first one of the scenario. Where they do not, it is the one that
        begins farthest from its reference, in target ranges, as a pendulum that hangs and is to stand; of a task
        without references, the one that earns least in its first period.
        """
        number, tracked = len(self.inputs), bool(self.columns)
        if number == 1:
            return 0, ""
        starts = self.trajectory["state"][:, 0]
        row, why = 0, ""
        if bool((starts != starts[0]).any()) and tracked:
            row, why = int(self.errors[:, 0].amax(-1).argmax()), ", which starts farthest from its target"
        elif bool((starts != starts[0]).any()):
            first = self.trajectory["next", "reward"][:, 0].flatten()
            row, why = int(first.argmin()), ", which starts where least is earned"
        costs = self.errors.mean(1).amax(-1) if tracked else -self.returns
        better = int((costs < costs[row]).sum())
        others = f"{better} others {'have a smaller error' if tracked else 'earn more'}"
        return row, f"episode {row + 1} of {number}{why}; {others}"

    @property
    def beyond_targets(self) -> list[Finding]:
        """Which references lie beyond the ends of the targets that were given for the plant."""
        findings = []
        for i, (low, high) in enumerate(self.ends):
            name, unit = self.output_names[i], self.units[self.output_names[i]]
            asked = self.references[..., i]
            least, most = float(asked.min()), float(asked.max())
            room = max(ROUNDING * (high - low), SINGLE * max(abs(low), abs(high)))
            if least < low - room or most > high + room:
                facts = {"output": name, "scenario": self.scenario, "unit": unit, "least": least, "most": most}
                findings.append(note("control.beyond_targets", **facts, low=low, high=high))
        return findings

    @property
    def restless(self) -> list[Finding]:
        """Which inputs go on moving while all targets rest: a plant is held, and a valve wears out."""
        if not bool(self.resting.all()):
            return []
        names, limits = self.signature.input_names, self.signature.input_limits
        changes = self.inputs[:, -self.steady_periods :].double().diff(dim=1).abs().mean((0, 1)).tolist()
        shares = (change / (high - low) for change, (low, high) in zip(changes, limits or (WHOLE,) * len(names)))
        return [
            weak("control.restless", input=name, percent=100 * share)
            for name, share in zip(names, shares, strict=True)
            if share > RESTLESS
        ]

    def ended_runs(self, ends: Tensor | None) -> list[Finding]:
        """Say how many runs a Gymnasium environment ended by itself, and within which bounds it may not.

        Args:
            ends: Least and largest value of each state in its observations, `(2, n_x)`; None of other plants.
        """
        moved = self.trajectory["next"].get("moved", None)
        if ends is None or moved is None or not bool((over := ~moved[:, -1, 0]).any()):
            return []
        steps = moved[over].sum((1, 2)) - 1
        # Both ends of the last period: what was reached before did not end the run.
        after, before = self.trajectory["next", "state"][over, -1], self.trajectory["state"][over, steps]
        at, was = ((x <= ends[0]) | (x >= ends[1]) for x in (after, before))
        reached = (at & ~was).any(0) & ends.isfinite().all(0)
        inner = (ends.mean(0) + INSIDE * (ends - ends.mean(0))).mT.tolist()
        sides = zip(self.signature.state_names, inner, reached.tolist(), strict=True)
        bounds = {name: [float(f"{end:.2g}") for end in both] for name, both, here in sides if here}
        return [weak("run.ended", runs=int(over.sum()), total=len(over), bounds=bounds)] if bounds else []

    def summary(self) -> Summary:
        """Return flat, JSON-ready figures: `return`, `stop_share` and `<metric>/<axis or input>`.

        `own_return` is what a Gymnasium environment itself pays; other plants have none.

        Errors and control figures are means over the rows. Overshoot and times are medians over the rows that are
        steps, because one step that never settles has an infinite time; a median that is infinite, or that no row
        defines, is None. `settled/<axis>` is the share of steps that settle, `steps/<axis>` how many rows are steps.
        `least/<state>` and `most/<state>` are the ends between which a state that is not tracked moves.
        """
        figures: Summary = {
            "return": _number(self.returns.mean()),
            "stop_share": _number(self.trajectory["next", "at_stop"].float().mean()),
        }
        if (own := self.trajectory["next"].get("own_reward", None)) is not None:
            figures["own_return"] = _number(own.sum((-1, -2)).mean())
        for i, axis in enumerate(self.output_names):
            for name in TRACKING:
                figures[f"{name}/{axis}"] = _number(self.metrics[name][:, i].mean())
            for name in STEP:
                figures[f"{name}/{axis}"] = _number(self.metrics[name][:, i].nanquantile(0.5))
            times = self.metrics["settling_time"][:, i]
            steps = times[~times.isnan()]
            figures[f"settled/{axis}"] = _number(steps.isfinite().float().mean())
            figures[f"steps/{axis}"] = float(len(steps))
        for i in self.state_order[len(self.columns) :]:
            name, ends = self.signature.state_names[i], self.trajectory["state"][..., i].aminmax()
            figures |= {f"least/{name}": _number(ends[0]), f"most/{name}": _number(ends[1])}
        for i, name in enumerate(self.signature.input_names):
            for metric in CONTROL:
                figures[f"{metric}/{name}"] = _number(self.metrics[metric][:, i].mean())
        return figures

    def save(self, folder: Path) -> list[Path]:
        """Write `<scenario>.json` (the summary) and `<scenario>.csv` (the episode that is drawn).

        Args:
            folder: Where; made if missing.

        Returns:
            The files.
        """
        figures, table = (folder / f"{self.scenario}.{suffix}" for suffix in ("json", "csv"))
        row, _ = self.representative_episode
        record = {"scenario": self.scenario, "rows": len(self.outputs), **self.summary()}
        write_json(figures, record)
        signature = self.signature
        header = [*signature.state_names, *signature.input_names]
        header += [f"reference_{name}" for name in self.output_names]
        parts = (self.trajectory["state"], self.inputs, self.references)
        values = torch.cat([self.time.unsqueeze(-1), *(part[row] for part in parts)], -1)
        write_csv(table, signature.headings(["time", *header]), values.tolist())
        return [figures, table]


def step_references(low: Sequence[float], high: Sequence[float], number: Positive = 64, seed: int = 0) -> Step:
    """Return `number` fixed step references that fill a target range evenly (scrambled Sobol points).

    The first, which figures show, is the one nearest to three quarters of the upper ends.

    Args:
        low: Lower end per output; keep to what the plant can hold [unit of the output].
        high: Upper end per output [unit of the output].
        number: How many; a power of two fills it best.
        seed: Of the scrambling; the same seed gives the same references.

    Raises:
        ValueError: `low` and `high` differ in length.
    """
    if len(low) != len(high):
        raise ValueError(f"plant.low={list(low)} and plant.high={list(high)} differ in length; give one end per output")
    points = torch.quasirandom.SobolEngine(len(low), scramble=True, seed=seed).draw(number)
    lower, upper = (torch.tensor([float(end) for end in ends]) for ends in (low, high))
    targets, worth_a_figure = torch.lerp(lower, upper, points), 0.75 * upper
    return Step(targets[(targets - worth_a_figure).square().sum(-1).argsort()].tolist())


@torch.no_grad()
def evaluate(
    env: ControlEnv,
    policy: Policy,
    scenario: Scenario,
    observer: Observer | None = None,
    phase: str = "",
    seconds: float | None = None,
) -> Evaluation:
    """Run a policy, without exploration, in a scenario.

    The environment and all random generators are left as they were.

    Args:
        env: Environment whose plant, task and control period are meant.
        policy: Policy to run; its exploration is off.
        scenario: Situation to run it in.
        observer: Observer by whose estimates, and sensors, the policy sees the plant; the metrics see it as it is.
            Noise of the scenario is then added to the measurements.
        phase: What is under way, in words; the scenario's name says it by default.
        seconds: Length of the run [s]; that of the scenario if omitted.

    Returns:
        Trajectory, metrics and times of the run.

    Raises:
        TypeError: The scenario has a reference and the task tracks none.
        Diverged: The policy gives an action that is not finite, the plant moves to no number, or the task gives a
            reward that is not finite. A plant that runs away is left at the end of `FARTHEST` ranges.
    """
    scenario = replace(scenario, seconds=scenario.length(env) if seconds is None else seconds)
    task = copy.copy(env.task)
    if scenario.reference is not None:
        if not isinstance(task, Tracking):
            raise TypeError(
                f"task {type(task).__name__} tracks no reference; give scenario=task, or scenario.reference=null"
            )
        task = task.with_reference(scenario.reference)
    task.max_steps = round(scenario.length(env) / env.dt)
    check_memory(
        4.0 * scenario.episodes * task.max_steps * (2 * task.n_o + (2 + env.substeps) * env.system.signature.n_x),
        f"scenario.episodes={scenario.episodes} of {task.max_steps * env.dt:g} s (scenario.seconds)",
    )
    calm = env.with_task(task, seed=scenario.seed)
    calm.left_beyond = FARTHEST
    wrapped = policy if observer is None else acting(policy, calm, bool(observer.pushed))
    sensing, sensors = None, None if observer is None else observer.sensors
    noise = torch.zeros(env.system.signature.n_x, dtype=torch.float64)
    for wrap in scenario.wrappers:
        wrapped = wrap(wrapped, calm)
        noise = wrapped.std if isinstance(wrapped, SensorNoise) else noise
        if sensors is not None and isinstance(wrapped, SensorNoise):  # of what the observer reads, which it knows not
            std = dict(zip(env.system.signature.state_names, wrapped.std.tolist(), strict=True))
            sensors, wrapped = sensors.noisier(std), wrapped.policy
    state = task.initial_state(torch.Size((scenario.episodes,)), calm.rng)
    start: TensorDictBase = calm.start_from(state)
    if observer is not None and sensors is not None:
        sensing = Sensing(calm, observer, torch.Generator().manual_seed(scenario.seed), sensors)
        start, noise = sensing.begin(start), sensors.variance(env.system.signature).sqrt()
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.random.fork_rng():
        trajectory = _run(calm, wrapped, scenario, start, sensing, phase or f"policy in scenario '{scenario.name}'")
    # Root entries: state and reference at the moment an action is chosen, so that a step begins at time zero.
    time, signature = torch.arange(trajectory.shape[-1], dtype=torch.float64) * calm.dt, env.system.signature
    outputs = [signature.state_index(name) for name in task.output_names]
    y, r, u = trajectory["state"][..., outputs], trajectory["reference"], trajectory["action"]
    # Of an angle no error is small beside many turns: one turn is the most that errors are a share of.
    turns = torch.tensor([turn_of(signature.state_units[i]) for i in outputs], dtype=torch.float64)
    boxes = task.boxes().minimum(turns) if isinstance(task, Tracking) else torch.ones(len(outputs))
    windows = tuple((start, end) for start, end in scenario.windows or ()) if scenario.plant else ()
    until, floor = min((start for start, _ in windows), default=math.inf), noise[outputs].nan_to_num(posinf=0.0)
    metrics = tracking_metrics(time, y, r, u, boxes, until, floor)
    ends = tuple(zip(*task.ends, strict=True)) if isinstance(task, Tracking) and task.ends else ()
    extents, columns = tuple(boxes.tolist()), tuple(outputs)
    return Evaluation(scenario.name, signature, columns, time, trajectory, metrics, windows, extents, ends)


def _run(
    calm: ControlEnv, policy: Policy, scenario: Scenario, start: TensorDictBase, sensing: Sensing | None, phase: str
) -> TensorDictBase:
    """Roll the policy out phase by phase, each phase with its own plant."""
    end = scenario.seconds or 0.0
    parts, total = list[TensorDictBase](), round(end / calm.dt)

    def _told(env: EnvBase, step: TensorDictBase) -> None:
        report_progress(phase, int(step["step_count"].max()), total, "control periods")

    windows = [(0.0, end)] if scenario.windows is None else scenario.windows
    edges = [round(edge / calm.dt) for edge in (0.0, *(edge for window in windows for edge in window), end)]
    for k, (begins, ends) in enumerate(pairwise(edges)):  # every second one is a window
        if begins == ends:
            continue
        plant = calm.with_system(scenario.plant(calm.system)) if k % 2 and scenario.plant else calm
        env = plant if sensing is None else TransformedEnv(plant, sensing.on(plant))
        part = env.rollout(ends - begins, policy, _told, auto_reset=False, tensordict=start, break_when_any_done=False)
        start = env.step_mdp(part[..., -1])
        parts.append(part)
    report_progress(phase, total, total, "control periods")  # of the last step the environment tells no more
    trajectory: TensorDictBase = torch.cat(parts, -1) if len(parts) > 1 else parts[0]
    require_finite_rollout(trajectory.transpose(0, 1).reshape(-1), f"evaluation in scenario '{scenario.name}'")
    if sensing is not None:  # true states and rewards stand in the places of the estimated ones
        trajectory = trajectory.copy()
        trajectory["estimate"], trajectory["state"] = trajectory["state"], trajectory["true_state"]
        for key in ("state", "reward"):
            trajectory["next", key] = trajectory["next", f"true_{key}"]
    return trajectory


def _number(value: Tensor) -> float | None:
    return value.item() if torch.isfinite(value) else None
