"""What is wanted of a system: observation, reward, references and initial states of an episode."""

from __future__ import annotations

import copy
import ctypes
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Self

import torch
from torch import Tensor

from dynasindy.envs import references
from dynasindy.envs.references import N_PARAMS, Reference
from dynasindy.envs.reward import ERROR_SHAPES, TrackingReward
from dynasindy.sentences import setting
from dynasindy.systems import Signature
from dynasindy.systems.base import Ends, sample_states
from dynasindy.systems.compiler import addresses, c_text, find_library


class Task(ABC):
    """What a `ControlEnv` asks of a task; pure functions of tensors, so real and imagined steps share them.

    As it is here it has no references; a task that draws any overrides `params_shape`, `sample` and `reference`.

    Args:
        signature: Names and ranges of the system's states and inputs.
        max_steps: Control periods per episode.

    Raises:
        ValueError: max_steps is not positive.
    """

    n_o: int
    """Length of the observation."""
    n_r: int = 0
    """Number of tracked outputs."""
    output_names: tuple[str, ...] = ()
    """Names of the tracked states."""
    own: bool = False
    """Whether the goal is what the plant itself pays; `earned` then is what is believed of that."""
    starts: Tensor | None = None
    """States in which the plant begins episodes, `(n, n_x)`, where it says so; a task may begin its own there."""
    input_limits: Tensor
    """Least and largest inputs, `(2, n_u)`: those of the actuators, or what a log has tried of what its equations bend
    in."""

    def __init__(self, signature: Signature, max_steps: int) -> None:
        if max_steps < 1:
            raise ValueError(f"max_steps must be at least 1 control period, got {max_steps}; the paper has 400")
        self.signature = signature
        self.max_steps = max_steps
        self.input_limits = torch.tensor(signature.input_limits or ((-1.0, 1.0),) * signature.n_u).mT

    def with_starts(self, starts: Tensor) -> Self:
        """Return the same task, told that the plant begins episodes at one of some states `(n, n_x)`."""
        other = copy.copy(self)
        other.starts = starts
        return other

    @property
    def limited(self) -> bool:
        """Whether inputs have narrower limits than -1 and 1."""
        low, high = self.input_limits
        return bool((low > -1).any()) or bool((high < 1).any())

    def limit(self, action: Tensor) -> Tensor:
        """Return actions `(*batch, n_u)` kept within the limits of the inputs."""
        low, high = self.input_limits.to(action)
        return action.clamp(low, high)

    @property
    def linear(self) -> bool:
        """Whether the observations are linear in the states, with slopes that are the same at all times."""
        return False

    @property
    def start_ends(self) -> Tensor:
        """Ends of the states in which episodes begin, `(2, n_x)`; zero where nothing says where."""
        if self.starts is None:
            return torch.zeros(2, self.signature.n_x)
        return torch.stack([self.starts.amin(0), self.starts.amax(0)])

    @property
    def unit(self) -> float:
        """Reward that counts as one where models are judged."""
        return 1.0

    @property
    def params_shape(self) -> torch.Size:
        """Shape of one episode's parameters."""
        return torch.Size((0,))

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw the parameters of new episodes, `(*batch, *params_shape)`."""
        return torch.zeros(*batch, *self.params_shape)

    @abstractmethod
    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw initial states, `(*batch, n_x)`."""

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return torch.zeros_like(t.expand(*t.shape[:-1], self.n_r))

    @abstractmethod
    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return what the agent sees, `(*batch, n_o)`, of states `(*batch, n_x)` at times `t` [s]."""

    @abstractmethod
    def reward(self, x: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return the reward of a control period, `(*batch,)`, from the states at its ends, inputs apart."""

    def effort(self, u: Tensor) -> Tensor | None:
        """Return what the actions of a control period `(*batch, n_u)` cost, `(*batch,)`; None for nothing."""
        return None

    def earned(self, x: Tensor, u: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return what a control period earns, its reward less its effort, `(*batch,)`."""
        reward = self.reward(x, x_next, params, t_next, at_stop)
        effort = self.effort(u)
        # Most tasks ask nothing for inputs, and a single environment feels three operations more.
        return reward if effort is None else reward - effort.to(x)

    def learn(self, x: Tensor, u: Tensor, x_next: Tensor, paid: Tensor) -> None:  # noqa: B027 - most rewards are known
        """Learn from what real periods have paid, `(N,)`, of states and inputs `(N, n)`."""

    def summary(self) -> str:
        """Return in one line what was learnt; nothing for most tasks."""
        return ""

    def state_dict(self) -> dict[str, Any]:
        """Return what was learnt."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027 - most tasks learn nothing
        """Restore what `state_dict` returned."""


FENCE_WIDTH = 0.05
"""Way beyond a bound at which its cost turns from quadratic to linear [ranges of the state]."""


class Tracking(Task):
    """Track a reference per output; the paper's task with outputs azimuth and pitch.

    The observation is the states divided by their ranges, the tracking errors e = r - y (paper, eq. for e)
    divided by `error_scale` and, if asked, the rates of the reference.

    Args:
        signature: Names and ranges of the system's states and inputs.
        reference: Distribution of references.
        outputs: Names of the tracked states.
        rates: Names of their rates, whose changes the reward damps; None for an output without one, and nothing for a
            first-order plant.
        reward: Reward of a control period.
        max_steps: Control periods per episode (paper: 400).
        observe_rate: Append the rates of the reference to the observation, for moving references.
        error_scale: Error that counts as 1 in the observation [target ranges].
        low: Lower end of the target range, per output; with `high` it is the unit of errors and rates. None for both
            takes the units of the outputs as they are.
        high: Upper end of the target range, per output.
        start: Where episodes begin: state to value, or to the two ends of a range from which it is drawn; zero for the
            others.
        bounds: Limits of the plant that end an excitation or a real episode: state to a value, for both sides of zero,
            or to two ends.

    Raises:
        ValueError: No output is named, a named state does not exist, the numbers of outputs, rates, references and
            error weights differ, error_scale or max_steps is not positive, or a target range or a start is none.
    """

    # Departure: the paper's S_tt lists the six states alone; without the errors no policy could know where
    # to go, and its text says that errors are observed.

    def __init__(
        self,
        signature: Signature,
        reference: Reference,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        rates: Sequence[str | None] = ("Omega_a", "Omega_p"),
        reward: TrackingReward | None = None,
        max_steps: int = 400,
        observe_rate: bool = False,
        error_scale: float = 0.5,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        start: Mapping[str, Ends] | None = None,
        bounds: Mapping[str, Ends] | None = None,
    ) -> None:
        super().__init__(signature, max_steps)
        if not outputs:
            raise ValueError(
                f"the task tracks nothing; the states are {', '.join(signature.state_names)}: name some in "
                f"{setting('plant.outputs')}, with the ends of their targets in {setting('plant.low')} and "
                f"{setting('plant.high')}, or take task=own, which earns what an environment itself pays"
            )
        reward = TrackingReward() if reward is None else reward
        counts = {len(outputs), len(rates) or len(outputs), reference.n_r}
        if len(counts | {len(reward.error_weights)} - {1}) != 1:
            raise ValueError(
                f"outputs {list(outputs)}, rates {list(rates)}, {reference.n_r} references and "
                f"{len(reward.error_weights)} reward.error_weights must be equally many, but for rates, of which there "
                "may be none at all, and weights, one of which serves all; complete plant.outputs and plant.rates, in "
                "which null stands for the rate of an output that has none, as in rates: [r, null]"
            )
        if not error_scale > 0:
            raise ValueError(f"error_scale must be positive, got {error_scale}; give it in ranges of the targets")
        if len(set(outputs)) < len(outputs):
            raise ValueError(f"the task tracks an output twice: {', '.join(outputs)}; name each once in plant.outputs")
        if own := [name for name, rate in zip(outputs, rates, strict=False) if name == rate]:
            raise ValueError(f"task.rates names '{own[0]}' as its own rate; name the state that is it in plant.rates")
        self.output_names = tuple(outputs)
        self.outputs = [signature.state_index(name, "task.outputs") for name in outputs]
        self.rated = [k for k, name in enumerate(rates) if name is not None]
        self.rates = [signature.state_index(name, "task.rates") for name in rates if name is not None]
        self.references = reference
        self.reward_function = reward
        self.observe_rate = observe_rate
        self.error_scale = error_scale
        self.n_r = reference.n_r
        self.n_o = signature.n_x + (2 if observe_rate else 1) * self.n_r
        self._extents = _boxes(signature, self.outputs, low, high)
        self.ends = None if low is None or high is None else (tuple(map(float, low)), tuple(map(float, high)))
        self.start = signature.start_ranges(start or {}, "task.start")
        self.bounds = signature.state_limits(bounds or {}, "task.bounds")
        # Where a state begins of which nothing is said, a log or the plant itself may say.
        signature.require_start_within(self.start, self.bounds, start or {}, "task")
        for place, name, *ends in zip(self.outputs, outputs, *(self.ends or ((), ())), strict=False):
            least, most = self.bounds[:, place].tolist()
            if not least <= ends[0] <= ends[1] <= most:
                raise ValueError(
                    f"the targets of '{name}' go from {ends[0]:g} to {ends[1]:g}, and task.bounds from {least:g} to "
                    f"{most:g}; allowed are targets within the bounds: correct plant.low, plant.high or plant.bounds"
                )
        self.fence = 0.0
        self.followers: Mapping[int, int] = {}
        self._given = set(start or {})

    @property
    def rate_names(self) -> list[str | None]:
        """Names of the rates of the outputs, None for an output without one; empty where none has one."""
        names = {k: self.signature.state_names[place] for k, place in zip(self.rated, self.rates, strict=True)}
        return [names.get(k) for k in range(self.n_r)] if names else []

    @property
    def params_shape(self) -> torch.Size:
        """Shape of one episode's reference parameters, `(n_r, 5)`."""
        return torch.Size((self.n_r, N_PARAMS))

    @property
    def error_columns(self) -> slice:
        """Columns of the observation that hold the scaled errors."""
        return slice(self.signature.n_x, self.signature.n_x + self.n_r)

    @property
    def start_ends(self) -> Tensor:
        """Ends of the states in which episodes begin, `(2, n_x)`; `start`, unless the plant says where."""
        if self.starts is not None:
            return super().start_ends
        ends = self.start.clone()
        for follower, state in self.followers.items():
            ends[:, follower] += ends[:, state]
        return ends

    def with_reference(self, reference: Reference) -> Tracking:
        """Return the same task with another distribution of references.

        Raises:
            ValueError: The number of outputs differs.
        """
        if reference.n_r != self.n_r:
            raise ValueError(
                f"references of {reference.n_r} outputs do not fit a task of {self.n_r} outputs, "
                f"{', '.join(self.output_names)}; give one value per output"
            )
        return self._changed(references=reference)

    def fenced(self, weight: float) -> Tracking:
        """Return the same task with a cost for leaving the bounds, of so much per range of a state and period.

        So cost inputs beyond their limits, where these are narrower than -1 and 1.
        """
        return self._changed(fence=weight if bool(self.bounds.isfinite().any()) or self.limited else 0.0)

    def with_box(self, extents: Sequence[float]) -> Tracking:
        """Return the same task with another target range, whose extents are taken as they are.

        Args:
            extents: Extent of the target range, positive, per output [units of the outputs].

        Raises:
            ValueError: The number of outputs differs.
        """
        if len(extents) != self.n_r:
            names = ", ".join(self.output_names)
            raise ValueError(f"a target range of extents {list(extents)} does not fit {names}; give one for each")
        return self._changed(_extents=tuple(extents))

    def following(self, followers: Mapping[int, int]) -> Tracking:
        """Return the same task in which states that follow other ones begin at these, as at rest.

        What is said of where such a state begins is its difference from the other one, unless `start` names it.

        Args:
            followers: Places of states that follow others, and of those.
        """
        names = self.signature.state_names
        return self._changed(followers={i: state for i, state in followers.items() if names[i] not in self._given})

    def as_logged(self, typical: Tensor, known: Mapping[str, tuple[float, float]] | None = None) -> Tracking:
        """Return the same task for a plant that is known by a log alone.

        Where no start was given, episodes begin where the log mostly was, outputs at the targets nearest to that. An
        output that moved far beyond its targets, as an arm that was spun, gets a range of three times its targets: in
        that of the log a policy could hardly tell one target from another.

        Args:
            typical: Ends of what is usual in the log, `(2, n_x)`, such as its median twice.
            known: Inputs that shall not leave what the log has tried, and its ends.
        """
        scales, typical = list(self.signature.x_scale), typical.double().clone()
        both = torch.tensor([(known or {}).get(name, (-1.0, 1.0)) for name in self.signature.input_names]).mT
        least, most = self.input_limits
        # Where the log has nothing between the limits that were given, these hold.
        within = both.clamp(least, most).where((both[0] <= most) & (both[1] >= least), self.input_limits)
        for k, i in enumerate(self.outputs):
            if self.ends is None:
                continue
            low, high = (ends[k] for ends in self.ends)
            typical[:, i] = typical[:, i].clamp(low, high)
            if (reach := max(-low, high)) > 0:
                scales[i] = min(scales[i], 3 * reach)
        signature, start = replace(self.signature, x_scale=tuple(scales)), typical.to(self.start)
        return self._changed(input_limits=within, signature=signature, start=self.start if self._given else start)

    def with_input_limits(self, limits: Sequence[Sequence[float]]) -> Tracking:
        """Return the same task whose inputs stay within some limits.

        Args:
            limits: Least and largest value of each input, `(2, n_u)`, in [-1, 1].

        Raises:
            ValueError: There is not one least and one largest input for each, in [-1, 1].
        """
        n_u = self.signature.n_u
        ends = torch.tensor(limits)
        if ends.shape != (2, n_u) or not bool((ends.abs() <= 1).all() and (ends[0] <= ends[1]).all()):
            raise ValueError(
                f"the limits of the inputs are {str(limits)[:40]}; give {n_u} least and {n_u} largest inputs from -1 "
                "to 1"
            )
        return self._changed(input_limits=ends)

    def _changed(self, **attributes: Any) -> Tracking:
        other = copy.copy(self)
        vars(other).update(attributes)
        return other

    def boxes(self) -> Tensor:
        """Return the extent of the target range, `(n_r,)`: the largest among the outputs of the same unit."""
        return torch.tensor(self._extents, dtype=torch.float64)

    def state_ranges(self) -> Tensor:
        """Return the range of each state, `(n_x,)`: of an output that of its targets, of others their typical size."""
        found = torch.tensor(self.signature.x_scale, dtype=torch.float64)
        found[self.outputs] = self.boxes()
        return found

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw reference parameters of new episodes, `(*batch, n_r, 5)`."""
        return self.references.sample(batch, generator)

    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Return the state in which episodes begin, `(*batch, n_x)`: the origin, unless `start` says otherwise."""
        if self.starts is not None:
            return self.starts[torch.randint(len(self.starts), batch, generator=generator)]
        x = sample_states(self.start, batch, generator)
        for follower, state in self.followers.items():
            x[..., follower] += x[..., state]
        return x

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return references.value(params, t)

    def error(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return e = desired - actual (paper, eq. for e), `(*batch, n_r)`."""
        return references.value(params, t) - x[..., _columns(self.outputs)]

    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return scaled states, errors and, if asked, reference rates [target ranges per second], `(*batch, n_o)`."""
        parts = [
            x / x.new_tensor(self.signature.x_scale),
            self.error(x, params, t) / self._unit(x, self.error_scale),
        ]
        if self.observe_rate:
            parts.append(references.rate(params, t) / self._unit(x, 1.0))
        return torch.cat(parts, -1)

    @property
    def linear(self) -> bool:
        """Whether the observations are linear in the states: those of this class are, whatever is tracked."""
        kind = type(self)
        return kind.observation is Tracking.observation and kind.error is Tracking.error

    def seen(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return the states `(*batch, n_x)` and the references `(*batch, n_r)` of observations."""
        x = observation[..., : self.signature.n_x] * observation.new_tensor(self.signature.x_scale)
        error = observation[..., self.error_columns] * self._unit(x, self.error_scale)
        return x, x[..., self.outputs] + error

    def reward(self, x: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return the reward of a control period, `(*batch,)`, from the states at its ends."""
        # dOmega = Omega_current - Omega_previous
        places = _columns(self.rates)
        change = x_next[..., places] - x[..., places] if self.rates else torch.zeros_like(x[..., :1])
        unit = self._unit(x, 1.0)
        of_rates = unit[..., self.rated] if 0 < len(self.rates) < self.n_r else unit
        reward = self.reward_function(self.error(x_next, params, t_next) / unit, change / of_rates, at_stop)
        if not self.fence:
            return reward
        outside = _beyond(x_next, self.bounds) / x.new_tensor(self.signature.x_scale)
        return reward - self.fence * ERROR_SHAPES["linear"](outside, FENCE_WIDTH).sum(-1)

    def effort(self, u: Tensor) -> Tensor | None:
        """Return what inputs beyond their limits cost, `(*batch,)`; None where these are not fenced."""
        if not self.fence or not self.limited:
            return None
        low, high = self.input_limits
        outside = _beyond(u, self.input_limits) / (high - low).clamp_min(FENCE_WIDTH).to(u)
        return self.fence * ERROR_SHAPES["linear"](outside, FENCE_WIDTH).sum(-1)

    def _unit(self, like: Tensor, share: float) -> Tensor:
        return like.new_tensor([share * extent for extent in self._extents])


def _beyond(values: Tensor, ends: Tensor) -> Tensor:
    """Return how far values `(*batch, n)` lie beyond their ends `(2, n)`."""
    low, high = ends.to(values)
    return (values - high).clamp_min(0.0) + (low - values).clamp_min(0.0)


def _columns(places: list[int]) -> slice | list[int]:
    """Return places as a slice where they follow each other: to look a list up costs more than to subtract."""
    first, count = places[0] if places else 0, len(places)
    return slice(first, first + count) if places == list(range(first, first + count)) else places


def _boxes(
    signature: Signature, outputs: Sequence[int], low: Sequence[float] | None, high: Sequence[float] | None
) -> tuple[float, ...]:
    """Return the extent of each output's targets; that of its range where the targets of a unit are one value each."""
    if low is None and high is None:
        return (1.0,) * len(outputs)
    low, high = low or (), high or ()
    if not len(low) == len(high) == len(outputs) or not all(a <= b for a, b in zip(low, high, strict=True)):
        raise ValueError(
            f"the target range low={list(low)}, high={list(high)} needs low <= high for each output; mend plant"
        )
    units = [signature.state_units[i] for i in outputs]
    widest = {unit: max(b - a for a, b, u in zip(low, high, units, strict=True) if u == unit) for unit in units}
    return tuple(float(widest[unit] or signature.x_scale[i]) for unit, i in zip(units, outputs, strict=True))


REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
COUNTS = ("n_x", "n_r", "n_rates", "observe_rate", "shape")
PLACES = ("outputs", "rates", "rated")
VECTORS = ("scale", "unit", "error_unit", "weight")
NUMBERS = ("rate_weight", "bonus", "tolerance", "stop_penalty", "width", "dt")


class TrackingMachine:
    """Observations, references and rewards of a `Tracking` task, as its torch code computes them.

    Args:
        library: `c/tracking.c`, compiled for the type of the states.
        task: The task.
        dt: Control period [s].
        dtype: Type of states, parameters and references.
    """

    def __init__(self, library: ctypes.CDLL, task: Tracking, dt: float, dtype: torch.dtype) -> None:
        self._made_of = task, dt, dtype
        reward, unit, real = task.reward_function, task.boxes().tolist(), REALS[dtype]
        rated = task.rated if len(task.rates) < task.n_r else range(task.n_r)
        shape, one = list(ERROR_SHAPES).index(reward.error_shape), len(reward.error_weights) == 1
        counts = task.signature.n_x, task.n_r, len(task.rates), task.observe_rate, shape
        weights = reward.error_weights * (task.n_r if one else 1)
        vectors = task.signature.x_scale, unit, [task.error_scale * extent for extent in unit], weights
        places = [(ctypes.c_int * len(of))(*of) for of in (task.outputs, task.rates, list(rated))]
        fields = [*((name, ctypes.c_int) for name in COUNTS), *((name, ctypes.c_void_p) for name in PLACES + VECTORS)]
        kind = type("Task", (ctypes.Structure,), {"_fields_": [*fields, *((name, real) for name in NUMBERS)]})
        self._held: list[Any] = [*places, *((real * len(of))(*of) for of in vectors)]
        numbers = (*(getattr(reward, name) for name in NUMBERS[:-1]), dt)
        self._task = kind(*counts, *(ctypes.addressof(each) for each in self._held), *numbers)
        self._code, self.n_o, self.n_r = library, task.n_o, task.n_r

    @classmethod
    def of(cls, task: Task, dt: float, dtype: torch.dtype) -> TrackingMachine | None:
        """Return the machine code of a task; None of another than `Tracking`, or without a compiler."""
        if type(task) is not Tracking or type(task.reward_function) is not TrackingReward or task.fence:
            return None
        library = _library(dtype) if dtype in REALS else None
        return None if library is None else cls(library, task, dt, dtype)

    def __reduce__(self) -> tuple[Any, ...]:
        """Have copies and pickles make their own."""
        return TrackingMachine.of, self._made_of

    def judge(
        self, x: Tensor | None, following: Tensor, params: Tensor, steps: Tensor, touched: Tensor | None
    ) -> dict[str, Tensor]:
        """Return `observation`, `reference` and, of a period, `reward`, `(*batch, 1)`; see `bind` for its arguments."""
        batch = following.shape[:-1]
        if following.dim() != 2 or following.stride(-1) != 1:
            following = following.contiguous()
        params = params.to(following).expand(*batch, self.n_r, N_PARAMS).contiguous()
        steps = steps.expand(*batch, 1).contiguous()
        shown = {
            "observation": torch.empty(*batch, self.n_o, dtype=torch.float32),
            "reference": following.new_empty(*batch, self.n_r),
        }
        if x is not None and touched is not None:
            x, touched = x.expand_as(following).contiguous(), touched.expand(batch).contiguous()
            shown["reward"] = torch.empty(*batch, 1, dtype=torch.float32)
        self.bind(x, following, params, steps, touched, list(shown.values()))()
        return shown

    def bind(
        self,
        x: Tensor | None,
        following: Tensor,
        params: Tensor,
        steps: Tensor,
        touched: Tensor | None,
        results: Sequence[Tensor],
    ) -> Callable[[], None]:
        """Return the call that judges what lies in these tensors when it is made; all are contiguous but `following`.

        Args:
            x: States at the start of the period, `(*batch, n_x)`; None if nothing is earned.
            following: States at its end, `(*batch, n_x)`, whose rows may lie apart.
            params: Parameters of the references, `(*batch, n_r, 5)`.
            steps: Control periods since the episodes began, int64 `(*batch, 1)`.
            touched: Whether a stop was touched, bool `(*batch,)`; None if nothing is earned.
            results: Where the observations, `(*batch, n_o)`, the references, `(*batch, n_r)`, and, if something is
                earned, the rewards, `(*batch,)`, are written to.
        """
        rows, stride = ctypes.c_long(steps.numel()), following.stride(-2) if following.dim() > 1 else 0
        read, written = (
            addresses(x, following),
            addresses(params, steps, touched, *results, *[None] * (3 - len(results))),
        )
        arguments = ctypes.byref(self._task), rows, *read, ctypes.c_long(stride), *written
        held = self, x, following, params, steps, touched, results  # the code knows only where they lie

        def _judge(code: ctypes.CDLL = self._code, kept: object = held) -> None:
            code.judge(*arguments)

        return _judge


@cache
def _library(dtype: torch.dtype) -> ctypes.CDLL | None:
    text = c_text("envs", "tracking.c")
    single = dtype == torch.float32
    words = {"real": "float" if single else "double"}
    text = re.sub(r"@(\w+)@", lambda gap: words.get(gap[1], gap[1] + "f" * single), text)
    return find_library(text, "a tracking task is judged", fast=False)
