"""The closed loop of plant and controller as one map of one vector, over one control period, batched, in float64.

| part of z  | what it holds                                             | numbers                          |
| ---------- | --------------------------------------------------------- | -------------------------------- |
| `x`        | state of the plant                                        | n_x                              |
| `late`     | measurements that are under way, oldest first             | delay of the sensors, times n_x  |
| `pending`  | inputs that have not acted on the plant yet, oldest first | delay of the model, times n_u    |
| `inputs`   | commands that the observer remembers, oldest first        | with an observer                 |
| `mean`     | estimate of the observer at its last measurement          | with an observer                 |
| `shift`    | what counteracts an estimated push                        | where the observer estimates one |
| `integral` | integral of the errors                                    | with integral action             |

The covariance of the observer is carried beside z. At rest the observer is not surprised, and its gain, all that the
covariance is for, acts on nothing: to first order the vector alone decides.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.control import Controller
from dynasindy.control.controller import ControlLaw, ControlSetup, Memory
from dynasindy.control.observer import Belief
from dynasindy.evaluation.metrics import steady_seconds
from dynasindy.planning.margins import MOVEMENT
from dynasindy.progress import track
from dynasindy.sindy import SindyModel
from dynasindy.systems import integrate, steps_needed
from dynasindy.systems.integrators import MOST_DOUBLINGS
from dynasindy.systems.steps import Rates, split_delay

PERIODS = 400
"""Control periods of a flight whose length is not given, those of the paper's episodes; a slow plant gets more time."""
FINE = MOVEMENT / 100
"""How far from each other a control period and one of steps half as long may end [ranges of a state]."""
TRIED = 256
"""States whose periods are compared, drawn within the bounds and a range from where episodes begin, outputs from the
middle of their targets."""
SETTLED = 600
"""Control periods after which the covariance of the observer is taken as steady."""
FULL = 0.99
"""Part of its way from the middle to a limit at which an input counts as saturated."""


def at_limit(u: Tensor, limits: Tensor) -> Tensor:
    """Return which inputs `(*batch, n_u)` are at one of their limits `(2, n_u)`, bool."""
    low, high = limits.to(u)
    return (2 * u - low - high).abs() > FULL * (high - low)


def _longest_step(model: SindyModel, setup: ControlSetup) -> float:
    """Return the longest Runge-Kutta step by which a model is moved well [s]: shorter ones end where it does."""
    generator, task, substeps = torch.Generator().manual_seed(0), setup.task, max(1, setup.substeps)
    x, u = (
        2 * torch.rand(TRIED, width, generator=generator, dtype=torch.float64) - 1
        for width in (model.signature.n_x, model.signature.n_u)
    )
    low, high = task.input_limits.double()
    centre = task.start_ends.double().mean(0)
    centre[task.outputs] = torch.tensor(task.ends or [centre[task.outputs].tolist()], dtype=torch.float64).mean(0)
    size = torch.tensor(model.signature.x_scale, dtype=torch.float64)
    x, u = (centre + size * x).clamp(*task.bounds.double()), low + (high - low) * (u + 1) / 2
    number, _ = steps_needed(model, x, u, setup.dt, substeps, setup.stops, FINE)
    return setup.dt / (number or substeps * 2**MOST_DOUBLINGS)


@dataclass(frozen=True)
class LoopSimulation:
    """Flights of one length.

    Attributes:
        x: States, `(rows, T + 1, n_x)`.
        u: Inputs held in between, `(rows, T, n_u)`.
        r: References, `(rows, n_r)`.
        outputs: Indices of the tracked states.
        dt: Control period [s].
        limits: Least and largest inputs, `(2, n_u)`.
    """

    x: Tensor
    u: Tensor
    r: Tensor
    outputs: list[int]
    dt: float
    limits: Tensor

    @property
    def last(self) -> int:
        """How many samples at the end count as steady."""
        return max(1, round(steady_seconds(self.dt, self.u.shape[1]) / self.dt))

    @property
    def steady_error(self) -> Tensor:
        """Mean absolute error of each output over the last seconds, `(rows, n_r)`; infinite where a flight diverged."""
        error = (self.x[:, -self.last :, self.outputs] - self.r.unsqueeze(1)).abs().mean(1)
        return error.nan_to_num(torch.inf, torch.inf)

    @property
    def end(self) -> Tensor:
        """Mean of each output over the last seconds, `(rows, n_r)`."""
        return self.x[:, -self.last :, self.outputs].mean(1)

    @property
    def slew(self) -> Tensor:
        """Largest change of each input from a period to the next, the first one from zero, `(rows, n_u)`."""
        first = torch.zeros_like(self.u[:, :1])
        return torch.cat([first, self.u], 1).diff(dim=1).abs().amax(1)

    @property
    def saturated(self) -> Tensor:
        """Share of the control periods in which each input is at its limit, `(rows, n_u)`."""
        return at_limit(self.u, self.limits).double().mean(1)

    def away(self, reach: Tensor) -> Tensor:
        """Return which flights have run away: they end out of reach of their target, or in no number, bool `(rows,)`.

        Args:
            reach: Distance of each output from its target beyond which it is out of reach, `(n_r,)`.
        """
        apart = (self.x[:, -self.last :, self.outputs] - self.r.unsqueeze(1)).abs()
        return ~(apart <= reach).all(-1).all(-1)


class _Moved(NamedTuple):
    """The loop one control period later: its vector, the covariance of its observer, and the command in between."""

    z: Tensor
    covariance: Tensor
    u: Tensor


class ClosedLoop:
    """A controller that holds a model, without a clock: what `Controller.act` does, for many rows at a time.

    Args:
        controller: The controller, whose task, control period and stops are meant; it is not changed.
        model: The identified model, in the place of the plant; its inputs act as late as it says.
        step: Longest Runge-Kutta step of the model [s]; as long as its movements allow if omitted.

    Attributes:
        signature: Names, units and ranges of states and inputs.
        dt: Control period [s].
        parts: Where each part of z stands.
        scale: Range of each number of z, `(n,)`; of an output that of its targets.
        pending: How many inputs of earlier periods still have to act.

    Raises:
        ValueError: Controller and model have other states or inputs.
    """

    def __init__(self, controller: Controller, model: SindyModel, step: float | None = None) -> None:
        if not model.signature.alike(controller.signature):
            raise ValueError("the model has other states, units or inputs than the controller; give that of its run")
        self.controller, self.model, self.task = controller, model, controller.setup.task
        self.signature, self.dt = controller.signature, controller.dt
        if self.task.ends is None:  # nothing says how far its targets go
            self.task = self.task.with_box([controller.signature.x_scale[i] for i in self.task.outputs])
        self.stops, self.observer = controller.setup.stops, controller.observer
        self.longest = _longest_step(model, controller.setup) if step is None else step
        self.coefficients: Tensor | None = None
        self._late = split_delay(model.delay, self.dt)
        self.pending = self._late[0] + (self._late[1] > 0)
        # Differences of a step in single precision would be rounding, and little else.
        policy = copy.deepcopy(controller.policy)
        policy = policy.double() if isinstance(policy, torch.nn.Module) else policy
        self.law = ControlLaw(policy, controller.setup, self.observer, controller.integral, torch.float64)
        ranges, n_u = self.task.state_ranges(), self.signature.n_u
        late = 0 if self.observer is None else self.observer.sensors.delay
        scales = {"x": ranges, "late": ranges.repeat(late), "pending": torch.ones(self.pending * n_u).double()}
        for name, shape in zip(Memory._fields, self.law.shapes, strict=True):
            if name != "covariance":
                scales[name] = torch.ones(math.prod(shape), dtype=torch.float64)
        scales["shift"][: len(ranges)] = ranges[: len(scales["shift"])]
        scales["integral"] *= self.task.error_scale
        if self.observer is not None:
            scales["mean"] = self.observer.scale.double()
        ends = list(accumulate(map(len, scales.values()), initial=0))
        self.parts = {name: slice(*ends[k : k + 2]) for k, name in enumerate(scales)}
        self.size, self.scale = ends[-1], torch.cat([*scales.values()])

    def varied(self, coefficients: Tensor) -> ClosedLoop:
        """Return the same controller around other plants; nobody tells it, and its observer believes in the model.

        Args:
            coefficients: Xi of each plant, `(rows, n_features, n_x)`.
        """
        other = copy.copy(self)
        other.coefficients = coefficients
        return other

    def rows(self, index: Tensor) -> ClosedLoop:
        """Return the loop with some of its plants, if it has several."""
        return self if self.coefficients is None else self.varied(self.coefficients[index])

    def at(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the vector of a loop that has been in a state under an input for long, and knows it, `(*batch, n)`."""
        z = torch.zeros(*x.shape[:-1], self.size, dtype=torch.float64)
        z[..., self.parts["x"]] = x
        for name, values in (("late", x), ("pending", u), ("inputs", u)):
            part, width = self.parts[name], max(1, values.shape[-1])
            z[..., part] = values.repeat(*[1] * (values.dim() - 1), (part.stop - part.start) // width)
        if self.observer is not None:
            start = self.parts["mean"].start
            z[..., start : start + self.signature.n_x] = x
        return z

    def fly(self, x: Tensor, r: Tensor, seconds: float, phase: str = "steps to the targets") -> LoopSimulation:
        """Switch the controller on at states `(rows, n_x)`, after inputs of zero; it holds references `(rows, n_r)`.

        Args:
            x: States.
            r: References.
            seconds: Length of each flight [s].
            phase: What is under way, in words.
        """
        z = self.at(x.double(), torch.zeros(len(x), self.signature.n_u, dtype=torch.float64))
        return self.run(z, torch.zeros(len(x), *self.law.shapes[2], dtype=torch.float64), r.double(), seconds, phase)[0]

    def run(
        self, z: Tensor, covariance: Tensor, r: Tensor, seconds: float, phase: str
    ) -> tuple[LoopSimulation, Tensor, Tensor]:
        """Let loops run from vectors and covariances on; return what they do, and both at the end."""
        states, inputs, periods = [z[:, self.parts["x"]]], [], max(1, round(seconds / self.dt))
        for _ in track(phase, range(periods), periods, "control periods"):
            z, covariance, u = self.step(z, covariance, r)
            states.append(z[:, self.parts["x"]])
            inputs.append(u)
        x, u = torch.stack(states, 1), torch.stack(inputs, 1)
        return LoopSimulation(x, u, r, self.task.outputs, self.dt, self.task.input_limits), z, covariance

    @torch.no_grad()
    def steady_covariance(self, z: Tensor) -> Tensor:
        """Return the covariance of the observer where z stays and nothing is lost, `(*batch, n_o, n_o)`."""
        if self.observer is None:
            return torch.zeros(*z.shape[:-1], 0, 0, dtype=torch.float64)
        observer, y, mean = self.observer, self._measured(z), z[..., self.parts["mean"]]
        covariance = observer.begin(y).covariance.clone()
        inputs = z[..., self.parts["inputs"]].unflatten(-1, (-1, self.signature.n_u))
        ahead, slopes = observer.transition(mean, inputs)  # once: where nothing moves, the slopes stay as they are
        for _ in range(SETTLED):
            before = covariance
            covariance = observer.correct(observer.carried(Belief(mean, before), ahead, slopes), y)[0].covariance
            size = covariance.diagonal(dim1=-2, dim2=-1).unsqueeze(-1)
            if bool(((covariance - before).abs() < 1e-9 * size).all()):
                break
        return covariance

    @torch.no_grad()
    def step(
        self, z: Tensor, covariance: Tensor, r: Tensor, extra: Tensor | float = 0.0, noise: Tensor | float = 0.0
    ) -> _Moved:
        """Measure, act, and let the plant move for one control period.

        Args:
            z: Vectors of the loop, `(*batch, n)`.
            covariance: Of the observer, `(*batch, n_o, n_o)`; zero where the controller is switched on now.
            r: References, `(*batch, n_r)` [of the outputs].
            extra: What the inputs of the plant get on top of the command, `(*batch, n_u)`.
            noise: What is added to the measured states, `(*batch, n_x)`.
        """
        x, y = z[..., self.parts["x"]], self._measured(z)
        held = {
            name: z[..., self.parts[name]].unflatten(-1, shape)
            for name, shape in zip(Memory._fields, self.law.shapes, strict=True)
            if name != "covariance"
        }
        # One covariance may serve many rows, as the differences of a linearisation.
        shared = covariance if self.observer is None else covariance.expand(*z.shape[:-1], *covariance.shape[-2:])
        u, memory = self.law.step(Memory(covariance=shared, **held), y + noise, r)
        waiting = torch.cat([z[..., self.parts["pending"]], u + extra], -1)
        moved = {
            "x": self._move(x, waiting.unflatten(-1, (-1, u.shape[-1]))),
            "late": torch.cat([z[..., self.parts["late"]], x], -1)[..., x.shape[-1] :],
            "pending": waiting[..., u.shape[-1] :],
            **{name: getattr(memory, name).flatten(z.dim() - 1) for name in held},
        }
        return _Moved(torch.cat([moved[name] for name in self.parts], -1), memory.covariance, u)

    def _measured(self, z: Tensor) -> Tensor:
        ways = [z[..., self.parts[name]] for name in ("late", "x")]
        return torch.cat(ways, -1)[..., : self.signature.n_x]

    def _move(self, x: Tensor, inputs: Tensor) -> Tensor:
        """Return states one period later, under pending inputs and the new one, `(*batch, pending + 1, n_u)`."""
        whole, rest = self._late
        if rest:
            x = self._flow(x, inputs[..., -whole - 2, :], rest)
        return self._flow(x, inputs[..., -whole - 1, :], self.dt - rest)

    def _flow(self, x: Tensor, u: Tensor, seconds: float) -> Tensor:
        steps = max(1, math.ceil(seconds / self.longest - 1e-6))
        moving = self.model if self.coefficients is None else Rates(self._rates, self.model.step)
        return integrate(moving, x, u, seconds, steps, self.stops)[0][..., -1, :]

    def _rates(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(rows, n_x)` or `(rows, n, n_x)`, of plants with other coefficients under inputs that act."""
        assert self.coefficients is not None
        theta, xi = self.model.library(x, u), self.coefficients
        return (theta.unsqueeze(1) @ xi).squeeze(1) if theta.dim() == 2 else theta @ xi
