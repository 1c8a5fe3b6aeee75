"""The data collection: excite the real system, and hold it where it would leave its limits.

The signal begins open loop. Where nobody knows whether the plant stays by itself (`excitation.first` below 1), it has a
small strength at first, which grows in every try. Where a state leaves its limits, the try ends and the next one begins
where episodes do, with the rest of the signal. From then on the signal lies on top of a linear-quadratic regulator,

    u = u_e - K (x - x_0) + strength * (signal - its mean),        dx/dt = A (x - x_0) + B u + c,   c + B u_e = 0,

of a linear model, fitted to the tries so far near the start x_0 (`_LocalModel`). Each try that leaves the limits all
the same halves the strength. Behind sensors the observer relies on that model, too, until there is a better one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dynasindy.dyna.experiment import Components, PlantComponents
from dynasindy.envs import ControlEnv, Excitation, Tracking
from dynasindy.findings import Finding, note, weak
from dynasindy.planning.regulator import regulated
from dynasindy.progress import report_progress
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import polynomial
from dynasindy.systems import Diverged, steps_needed
from dynasindy.systems.transitions import Transitions

NEAR = 1.0
"""Ranges around the start within which the linear model is fitted."""
ENOUGH = 2
"""Rows near the start per number of a linear equation; fewer would fit noise."""


@dataclass(frozen=True)
class _LocalModel:
    """A linear model of the plant near its start, dx/dt = A (x - x_0) + B u + c, from little data."""

    home: Tensor  # x_0, `(n_x,)`
    a: Tensor  # `(n_x, n_x)` [1/s]
    b: Tensor  # `(n_x, n_u)` [1/s]
    c: Tensor  # `(n_x,)` [1/s]
    model: SindyModel | None = None  # the same as a system, on which an observer can rely behind sensors


def _fit_local_model(rows: TensorDict, parts: PlantComponents) -> _LocalModel | None:
    """Return a linear model of what control periods `(T,)` showed near the start, None where that is too little."""
    signature, home = parts.plant.system.signature, rows["state"][0].double()
    scale, n_x, n_u = torch.tensor(signature.x_scale, dtype=torch.float64), signature.n_x, signature.n_u
    if parts.sensing is None:
        data = Transitions.from_periods(rows, parts.plant.log_dt)
        middle = (0.5 * (data.x + data.x_next) - home) / scale
        near = (middle.abs() <= NEAR).all(-1)
        if int(near.sum()) < ENOUGH * (n_x + n_u + 1):
            return None
        columns = torch.cat([middle, data.u, torch.ones_like(middle[:, :1])], -1)[near]
        slopes = ((data.x_next - data.x) / data.dt / scale)[near]
        # The smallest solution where the data leave a choice.
        a, b, c = torch.linalg.lstsq(columns, slopes, driver="gelsd").solution.split([n_x, n_u, 1])
        scale = scale.unsqueeze(-1)
        return _LocalModel(home, a.mT * scale / scale.mT, b.mT * scale, c[0] * scale.squeeze(-1))
    # By whole trajectories: rates that an observer without a model makes of angles come as late as a plant falls.
    away = ((rows["measurement"] - home) / scale).abs()
    data = Transitions.from_periods(rows[~(away > NEAR).any(-1)], parts.plant.log_dt)
    if len(data) < ENOUGH * (n_x + n_u + 1):
        return None
    names, rates = signature.state_names, parts.sensing.observer.sensors.rates or {}
    known = {a: b for a, b in rates.items() if a in names and b in names}
    refinement = Refinement(method="trajectory")
    model = SindyModel(signature, partial(polynomial, degree=1), Regression(method="bic"), refinement, known)
    try:
        model.fit(data)
    except Diverged:
        return None
    at = torch.cat([torch.zeros(1, n_x + n_u), torch.eye(n_x + n_u)]).double()
    at[:, :n_x] += home
    c, slopes = model(at[:, :n_x], at[:, n_x:]).split([1, n_x + n_u])
    a, b = (slopes - c).mT.split([n_x, n_u], -1)
    return _LocalModel(home, a, b, c[0], model)


BEYOND = 10.0
"""Ranges of a state, about the start, that limit the excitation of a plant that stays by itself and names no bounds."""
FEW = 3.0
"""Ranges of a state, about the start, that limit that of any other plant; an output goes no further beyond its start
and its targets than these lie apart."""
MUCH = 0.25
"""Part of the excitation that is left out from which on more data would help."""
MARGIN = 0.9
"""Largest mean input of the loop."""
LOOKED_AT = 100
"""Control periods, at least, that are simulated again in shorter steps."""


def excite(parts: PlantComponents, pilot: RegulatedExcitation | None = None) -> TensorDict:
    """Return the excitation's control periods on the real system, try after try, `(T,)`.

    Behind sensors, states are what the observer makes of the measurements.

    Args:
        parts: The plant, and the signal.
        pilot: The signal with the regulator under it that an earlier excitation found; the signal alone if omitted.
    """
    report_progress("excitation")
    pilot, steps = pilot or RegulatedExcitation(parts.excitation), parts.excitation.n_steps
    low, high = _excitation_limits(parts)
    tries: list[TensorDict] = []
    while (done := sum(len(rows) for rows in tries)) < steps:
        pilot.begun = done
        tries.append(_interact(parts.env, pilot, steps - done, (low, high)))
        last = tries[-1]["next"][-1]
        # A state that is no number any more leaves no row: then the try is short, and the task has not ended it.
        short = done + len(tries[-1]) < steps and not bool(last["done"].any())
        if short or not bool(_within(last["state"], low, high)):
            was_held = pilot.gain is not None
            pilot.close(torch.cat(tries), parts)
            # What is caught by now may be excited as before; what nothing holds has to be moved less.
            pilot.strength *= 0.5 if was_held or (pilot.gain is None and parts.excitation.first < 1) else 1.0
    return torch.cat(tries)


def _excitation_limits(parts: PlantComponents) -> tuple[Tensor, Tensor]:
    """Return the ends of the states within which the plant is excited, `(n_x,)` each."""
    scale, task = torch.tensor(parts.plant.system.signature.x_scale, dtype=torch.float64), parts.plant.task
    sides = torch.tensor([[-1.0], [1.0]], dtype=torch.float64)
    low, high = far = task.start_ends.double() + BEYOND * sides * scale
    if not isinstance(task, Tracking):
        return low, high
    if parts.excitation.first < 1:
        far = task.start_ends.double() + FEW * sides * scale
        if task.ends is not None:
            # A plant may go to another rest, as a reactor that ignites, which tells little of its targets.
            both = torch.cat([torch.tensor(task.ends, dtype=torch.float64), task.start_ends[:, task.outputs].double()])
            hull = torch.stack([both.amin(0), both.amax(0)])
            near, own = hull + sides * (hull[1] - hull[0]), far[:, task.outputs]
            far[:, task.outputs] = torch.where(hull[1] > hull[0], sides * torch.minimum(sides * near, sides * own), own)
    low, high = torch.where(task.bounds.isfinite(), task.bounds, far)
    return low, high


def excitation_findings(parts: PlantComponents, rows: TensorDict) -> list[Finding]:
    """Return how often the excitation began anew and where, what no model is fitted to, and what is odd of the plant.

    Args:
        parts: The plant and its limits.
        rows: What `excite` returned.
    """
    findings, task = list[Finding](), parts.plant.task
    ends = (rows["step_count"][1:, 0] == 0).nonzero().flatten()
    if len(ends):
        (low, high), signature = _excitation_limits(parts), parts.plant.system.signature
        last = rows["next", "state"][ends]
        counts = (~((last >= low) & (last <= high))).sum(0).tolist()
        units = zip(signature.state_names, signature.state_units, low.tolist(), high.tolist(), counts, strict=True)
        keys = "state", "unit", "low", "high", "times"
        beyond = [dict(zip(keys, each, strict=True)) for each in units if each[-1]]
        findings.append(note("excitation.restarts", times=len(ends), beyond=beyond))
    plant = parts.plant
    # Another simulator, or a rig, moves a plant of another type; behind sensors nobody knows where it was.
    if type(plant) is ControlEnv and not plant.delay and parts.sensing is None:
        report_progress("excitation", note="are the steps of the simulation short enough?")
        some = rows[:: max(1, len(rows) // LOOKED_AT)]
        x, u = some["state"], some["action"].to(some["state"].dtype)
        needed, apart = steps_needed(plant.system, x, u, plant.dt, plant.substeps, plant.stops)
        if needed != plant.substeps:
            far = float(apart) if math.isfinite(apart) else None
            findings.append(weak("plant.coarse_steps", apart=far, needed=needed))
    if count := int(rows["next", "at_stop"].sum()):
        much = count >= MUCH * rows.numel()
        findings.append((weak if much else note)("excitation.stops", count=count, total=rows.numel(), much=much))
    registered = getattr(parts.plant.system, "registered_steps", None)  # of a Gymnasium environment
    if registered is not None and task.max_steps > registered:
        findings.append(note("plant.longer_episodes", steps=task.max_steps, registered=registered))
    return findings


def _within(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    return ((x >= low) & (x <= high)).all(-1)


def _interact(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    steps: int,
    ends: tuple[Tensor, Tensor] | None = None,
) -> TensorDict:
    """Run a policy, exploring, for at most one episode, `(T,)`, which ends beyond limits of the states, if any."""
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        if ends is None:
            return env.rollout(steps, policy)
        rows: list[TensorDictBase] = []
        now = env.reset()
        while len(rows) < steps:
            rows.append(env.step(policy(now)))
            x = rows[-1]["next", "state"]
            if not bool(x.isfinite().all()) and len(rows) > 1:
                rows.pop()
            if not bool(_within(x, *ends)) or bool(rows[-1]["next", "done"].any()):
                break
            now = env.step_mdp(rows[-1])
        return torch.stack(rows).contiguous()


def explore(parts: Components) -> TensorDict:
    """Let the agent explore on the real system for an episode, `(T,)`.

    It ends where a state leaves the task's bounds, if there are any and the states are seen.
    """
    task, policy, ends = parts.plant.task, parts.agent.explore, None
    if parts.sensing is not None:
        policy = parts.sensing.controller(policy)
    elif isinstance(task, Tracking) and bool(task.bounds.isfinite().any()):
        ends = task.bounds[0], task.bounds[1]
    return _interact(parts.env, policy, parts.model_env.task.max_steps, ends)


class RegulatedExcitation:
    """The signal, and the regulator under it once there is one.

    Attributes:
        begun: Control periods of the signal that earlier tries have used.
        strength: Factor on the signal once it has grown.
        gain: K, `(n_u, n_x)`; None as long as the signal acts alone.
        home: x_0, `(n_x,)`, once there is a gain.
        mean: u_e, `(n_u,)`.

    Args:
        signal: The excitation.
    """

    def __init__(self, signal: Excitation) -> None:
        self.signal, self.begun, self.strength = signal, 0, 1.0
        self.gain: Tensor | None = None
        self.mean, self.home = signal.offset, torch.zeros(0)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action`."""
        later = tensordict.select("step_count").set("step_count", tensordict["step_count"] + self.begun)
        u: Tensor = self.signal(later)["action"]
        if self.gain is None and self.strength == self.signal.first == 1.0:
            return tensordict.set("action", u)
        added = self.strength * self.signal.growth(tensordict["step_count"]).to(u) * (u - self.signal.offset.to(u))
        held = self.mean  # where no regulator is
        if self.gain is not None:
            away = tensordict["state"].double() - self.home
            held = (self.mean - away @ self.gain.mT).clamp(-1.0, 1.0)
        return tensordict.set("action", (held.to(u) + added).clamp(-1.0, 1.0))

    def close(self, rows: TensorDict, parts: PlantComponents) -> None:
        """Fit a linear model to what was seen and regulate it; the loop stays as it is where nothing holds the model.

        Args:
            rows: The tries so far, `(T,)`.
            parts: The plant, its period and the ranges of its states.
        """
        found = _fit_local_model(rows, parts)
        if found is None:
            return
        scale = torch.tensor(parts.plant.system.signature.x_scale, dtype=torch.float64)
        solved = regulated(found.a, found.b, parts.plant.dt, 1.0 / scale.square())
        if solved is None:
            return
        self.home, self.gain = found.home, solved.gain
        against = torch.linalg.lstsq(found.b / scale.unsqueeze(-1), -found.c / scale, driver="gelsd").solution
        self.mean = against.clamp(-MARGIN, MARGIN)
        if parts.sensing is not None and found.model is not None:
            begins = [*(rows["step_count"].flatten() == 0).nonzero().flatten().tolist(), len(rows)]
            tries = [rows[first:end] for first, end in pairwise(begins)]
            parts.sensing.observer.lean(found.model, [parts.sensing.measured(tried) for tried in tries])
