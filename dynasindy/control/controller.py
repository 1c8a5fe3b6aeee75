"""A controller: state observer, integral action and policy, stepped once per control period, and its file.

It does what an evaluation does to a policy, but for one plant, without a simulation of it: the measurements come from
outside. A file has all that it is made of as plain numbers and names; nothing in it is run when it is read:

| key         | what it holds                                                                                         |
| ----------- | ----------------------------------------------------------------------------------------------------- |
| `signature` | names, units and ranges of the states, names of the inputs                                            |
| `task`      | control period [s], Runge-Kutta steps in it, mechanical stops, tracked states, how the observation is |
|             | made, limits of the inputs, ends of the targets, null where they are not known, and of the states in  |
|             | which episodes begin; an end of a stop that is null is not there                                      |
| `policy`    | weights of each layer, float32 in base 64, `(n_out, n_in)` row by row, and biases                     |
| `integral`  | numbers of the integral action, or null                                                               |
| `observer`  | sensors, process noise, and the model, as in model.json; or null                                      |
"""

from __future__ import annotations

import base64
import copy
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from dynasindy.agents.networks import MLP
from dynasindy.control.observer import Belief, Observer
from dynasindy.envs import ControlEnv, Sensors, Step, Tracking, TrackingReward, references
from dynasindy.safe_io import DamagedFileError, read_json, reading, write_json
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Stops
from dynasindy.text import did_you_mean, unit_suffix

if TYPE_CHECKING:
    from dynasindy.control.c_code import Native

Array = NDArray[np.float64]
Values = float | Sequence[float] | Array | Tensor | Mapping[str, float]
"""Numbers in the order of the signature, or by name."""
Policy = Callable[[TensorDictBase], TensorDictBase]
"""Reads `observation`, writes `action`."""


class IntegralAction:
    """A policy that is shown its error plus the error's integral.

    The policy holds any target, so that shifting what it sees by `integral` moves the output until the error is
    zero; no training is needed. What is no steady error is not integrated, so that nothing winds up: no error beyond
    `band`, as after a step or in a gust, and of an error that changes at `rate` half of it.

    Args:
        policy: Reads `observation`, writes `action`.
        env: Where it acts, with a `Tracking` task.
        gain: Integral gain [1/s].
        band: Largest error that is integrated [target ranges].
        limit: Largest integral [target ranges].
        rate: Rate of change of an error at which half of it is integrated [target ranges per second].

    Raises:
        TypeError: The task tracks no reference.
        ValueError: A number is not positive.
    """

    def __init__(
        self,
        policy: Callable[[TensorDictBase], TensorDictBase],
        env: ControlEnv | ControlSetup,
        gain: float = 0.7,
        band: float = 0.06,
        limit: float = 0.3,
        rate: float = 0.1,
    ) -> None:
        if not isinstance(env.task, Tracking):
            raise TypeError(f"task {type(env.task).__name__} has no error to integrate; use a tracking task")
        if not all(number > 0 for number in (gain, band, limit, rate)):
            raise ValueError(
                f"integral action needs gain, band, limit and rate > 0, not {gain}, {band}, {limit}, {rate}"
            )
        self.policy, self.task, self.dt = policy, env.task, env.dt
        self.gain, self.band, self.limit, self.rate = gain, band, limit, rate
        self.integral: Tensor | None = None

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action for the shifted error and advance the integral; step 0 begins at zero."""
        task, x, params = self.task, tensordict["state"], tensordict["task_params"]
        steps = tensordict["step_count"]
        t = steps.to(x.dtype) * self.dt
        box = task.boxes().to(x)
        error = task.error(x, params, t) / box
        if self.integral is None or self.integral.shape != error.shape:
            self.integral = torch.zeros_like(error)
        self.integral = self.integral.masked_fill(steps == 0, 0.0)
        seen = tensordict.copy()
        observation, columns = tensordict["observation"], task.error_columns
        shift = (self.integral / task.error_scale).to(observation)
        beside = columns.start, observation.shape[-1] - columns.stop
        seen["observation"] = observation + torch.nn.functional.pad(shift, beside)
        moving = torch.zeros_like(error)  # an output without a rate tells nothing of its motion
        if task.rates:
            slower = references.rate(params, t)[..., task.rated] - x[..., task.rates]
            moving[..., task.rated] = slower / box[..., task.rated] / self.rate
        steady = (error.abs() < self.band) / (1 + moving.square())
        self.integral = (self.integral + self.gain * self.dt * steady * error).clamp(-self.limit, self.limit)
        return tensordict.set("action", self.policy(seen)["action"])


def acting(policy: Policy, env: ControlEnv | ControlSetup, pushed: bool = False) -> Policy:
    """Return a policy as it acts on a plant: within the limits of inputs, and against the push that is estimated.

    Args:
        policy: Reads `observation`, writes `action`.
        env: Where it acts; the task has the limits.
        pushed: Whether an observer estimates a push, under `observer`, which is counteracted.
    """
    return partial(_act, policy, env, pushed) if pushed or env.task.limited else policy


def _act(policy: Policy, env: ControlEnv | ControlSetup, pushed: bool, tensordict: TensorDictBase) -> TensorDictBase:
    """Write the action, or that for the state without the push and what counteracts it, within the limits."""
    if not pushed:
        return tensordict.set("action", env.task.limit(policy(tensordict)["action"]))
    x, t = tensordict["state"], tensordict["step_count"] * env.dt
    dx, du = tensordict["observer", "shift"].split([x.shape[-1], env.task.signature.n_u], -1)
    seen = tensordict.copy().set("state", x - dx)
    observation = env.task.observation(x - dx, tensordict["task_params"], t.to(x))
    action = policy(seen.set("observation", observation.to(tensordict["observation"])))["action"]
    return tensordict.set("action", env.task.limit(action + du.to(action)))


@dataclass
class ControlSetup:
    """Where a controller acts, without a plant.

    Attributes:
        task: What is wanted.
        dt: Control period [s].
        substeps: Runge-Kutta steps of its observer per control period.
        stops: Mechanical stops of the plant, if any.
    """

    task: Tracking
    dt: float
    substeps: int = 1
    stops: Stops | None = None


class Memory(NamedTuple):
    """What a controller remembers from one control period to the next; zeros are one that was just reset.

    Attributes:
        inputs: Commands that its observer needs, the newest at the end, `(*batch, memory, n_u)`; without an observer
            this part and the next two are empty.
        mean: Estimate of the observer, `(*batch, n)`.
        covariance: Of its errors, `(*batch, n, n)`.
        shift: What counteracts a push, `(*batch, n_x + n_u)`; empty where none is estimated.
        integral: Of its errors, `(*batch, n_r)`; empty without integral action.
    """

    inputs: Tensor
    mean: Tensor
    covariance: Tensor
    shift: Tensor
    integral: Tensor


class ControlLaw:
    """A control period as a function of tensors: `Controller` calls it, checks linearise it, ONNX is its trace.

    Args:
        policy: Reads `observation`, writes `action`.
        setup: Task, control period and stops.
        observer: Estimates the states from what is measured, if anything.
        integral: Settings of `IntegralAction`, if there is one.
        dtype: That of the observations.

    Attributes:
        shapes: Of each part of the memory, the batch apart.
    """

    def __init__(
        self,
        policy: Policy,
        setup: ControlSetup,
        observer: Observer | None,
        integral: Mapping[str, float] | None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.setup, self.observer, self.dtype = setup, observer, dtype
        self.integral = None if integral is None else IntegralAction(policy, setup, **integral)
        self.pushed = observer is not None and bool(observer.pushed)
        self._act = acting(self.integral or policy, setup, self.pushed)
        self.n_x, n_u = setup.task.signature.n_x, setup.task.signature.n_u
        n = 0 if observer is None else len(observer.scale)
        memory = 0 if observer is None else observer.sensors.delay + observer.late()[0] + 2
        shift, n_r = (self.n_x + n_u) * self.pushed, setup.task.n_r * (integral is not None)
        self.shapes = (memory, n_u), (n,), (n, n), (shift,), (n_r,)

    def reset(self) -> Memory:
        """Return the memory of a plant at rest, its inputs zero, of which nothing was measured."""
        return Memory(*(torch.zeros(shape, dtype=torch.float64) for shape in self.shapes))

    @torch.no_grad()
    def step(self, memory: Memory, y: Tensor, r: Tensor, rate: Tensor | float = 0.0) -> tuple[Tensor, Memory]:
        """Return the inputs of the control period that begins now, `(*batch, n_u)`, and what is remembered then.

        Args:
            memory: What is remembered.
            y: What was measured, NaN where nothing was, `(*batch, n_x)` float64.
            r: References, `(*batch, n_r)`.
            rate: How fast they move [per second], likewise.
        """
        x = y
        if (observer := self.observer) is not None:  # x is the state for the time at which the next action arrives
            first = (memory.covariance.diagonal(dim1=-2, dim2=-1) == 0).all(-1, keepdim=True)
            begun = observer.begin(y)
            moved, _, _ = observer.correct(observer.advance(Belief(memory.mean, memory.covariance), memory.inputs), y)
            mean = torch.where(first, begun.mean, moved.mean)
            covariance = torch.where(first.unsqueeze(-1), begun.covariance, moved.covariance)
            x, shift = observer.ahead(mean, memory.inputs), memory.shift
            if self.pushed:
                shift = observer.correction(x, memory.inputs, self.setup.task.outputs, shift)
            x, memory = x[..., : self.n_x], memory._replace(mean=mean, covariance=covariance, shift=shift)
        if self.integral is not None:
            self.integral.integral = memory.integral
        zero = torch.zeros_like(r)  # a line is a slow sine
        params = torch.stack([r, zero + rate, zero + 1 / (2 * math.pi), zero - self.setup.dt, zero], -1)
        steps = torch.ones(*x.shape[:-1], 1, dtype=x.dtype)  # none is the first, so that the integral goes on
        observation = self.setup.task.observation(x, params, steps * self.setup.dt).to(self.dtype)
        shown: dict[str, Any] = {"observation": observation, "state": x, "task_params": params, "step_count": steps}
        if self.pushed:
            shown["observer"] = TensorDict({"shift": memory.shift}, x.shape[:-1])
        u: Tensor = self._act(TensorDict(shown, x.shape[:-1]))["action"]
        if self.observer is not None:
            memory = memory._replace(inputs=torch.cat([memory.inputs[..., 1:, :], u.unsqueeze(-2)], -2))
        if self.integral is not None and self.integral.integral is not None:
            memory = memory._replace(integral=self.integral.integral)
        return u, memory


class Controller:
    """Hold a plant at references, one control period at a time.

    Args:
        policy: Reads `observation`, writes `action`.
        setup: Task, control period and stops.
        observer: Estimates the states from what is measured; None takes all states as they are given.
        integral: Settings of `IntegralAction`, `{}` for its own; None for a policy that is not shown the integral of
            its error.

    Raises:
        ValueError: The observer has not learnt from data.
    """

    def __init__(
        self,
        policy: Policy,
        setup: ControlSetup,
        observer: Observer | None = None,
        integral: Mapping[str, float] | None = None,
    ) -> None:
        if observer is not None and not observer.learnt:
            raise ValueError("a controller got an observer that has not learnt from data; call its `learn` first")
        self.policy, self.setup, self.observer, self.integral = policy, setup, observer, integral
        self._warned, self._prepared = False, False
        self._native: Native | None = None
        self.reset()

    @property
    def signature(self) -> Signature:
        """Names, units and ranges of the plant's states and inputs."""
        return self.setup.task.signature

    @property
    def dt(self) -> float:
        """Control period [s]; `act` is to be called once in each."""
        return self.setup.dt

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the tracked states, in the order of the references."""
        return self.setup.task.output_names

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the states that are measured: all of them, or those that the observer is told."""
        channels = self.observer.sensors.channels if self.observer is not None else None
        return tuple(name for name in self.signature.state_names if channels is None or name in channels)

    @property
    def network(self) -> MLP:
        """The network of its policy.

        Raises:
            ValueError: The policy is of another kind.
        """
        module = getattr(self.policy, "module", self.policy)
        if not isinstance(module, MLP) or not module.squash:
            raise ValueError(
                f"no file holds a policy that is a {type(module).__name__}; allowed is the actor of an agent"
            )
        return module

    def __repr__(self) -> str:
        outputs, seen = (", ".join(self.signature.headings(names)) for names in (self.outputs, self.measured))
        parts = [part for part, there in (("observer", self.observer), ("integral action", self.integral)) if there]
        more = f", with {' and '.join(parts)}" if parts else ""
        inputs = ", ".join(self.signature.input_names)
        ends = "[-1, 1]"
        if self.setup.task.limited:
            ends = ", ".join(f"[{low:.3g}, {high:.3g}]" for low, high in self.setup.task.input_limits.mT.tolist())
        inputs = "; ".join([f"{inputs} in {ends} every {self.dt:g} s{more}", *self.signature.own_inputs(ranged=False)])
        return f"Controller(holds {outputs}; reads {seen}; sets {inputs})"

    def reset(self) -> None:
        """Forget what was measured; the next call of `act` takes the plant as at rest, its inputs zero.

        Policy, observer and setup are read anew, as they are at the first call of `act`.
        """
        self._law = ControlLaw(self.policy, self.setup, self.observer, self.integral)
        self._memory, self._begun = self._law.reset(), False
        if self._prepared:
            self._prepare()

    def __getstate__(self) -> dict[str, Any]:
        """Give a copy, a shallow one as well, numbers of its own of what was measured."""
        return {**self.__dict__, "_native": copy.copy(self._native)}

    @property
    def estimate(self) -> Array | None:
        """State of the plant at the last call of `act`, as far as the observer knows, `(n_x,)`; None without it."""
        if self.observer is None or not self._begun:
            return None
        mean = self._memory.mean.numpy() if self._native is None else self._native.state[1:]
        found: Array = mean[: self.signature.n_x].copy()
        return found

    def targets_in_words(self) -> list[str]:
        """Return the range of targets that each output was planned for, `h3 from 8 to 25 cm`; none if not known."""
        signature, ends = self.signature, self.setup.task.ends
        units = [signature.state_units[i] for i in self.setup.task.outputs]
        rows = zip(self.outputs, *(ends or ((), ())), units, strict=False)
        return [f"{name} from {low:g} to {high:g}{unit_suffix(unit)}" for name, low, high, unit in rows]

    def act(self, measurement: Values, reference: Values, rate: Values | None = None) -> Array:
        """Return the inputs of the control period that begins now, `(n_u,)`, in [-1, 1].

        The first call compiles the controller, where there is a compiler and the controller is one that
        `dynasindy.export.controller_sources` writes; the code is kept for later processes. If the parts of a controller
        are changed after it, make another controller of them.

        Args:
            measurement: What was measured now: states in the order of the signature, or by name. NaN, or a name that is
                left out, is not measured, which only a controller with an observer takes.
            reference: Where the outputs are to be, in the order of `outputs`, or by name [units of the outputs].
            rate: How fast the reference moves [per second]; 0 if omitted.

        A reference that lies farther beyond the targets of the plan than these span is warned of, once.

        Raises:
            ValueError: A number is missing, infinite, of a name that does not exist, or so large that no action
                follows from it; the controller is then as it was before the call.
        """
        if not self._prepared:
            self._prepare()
        y = self._numbers("measurement", measurement, self._names)
        y[self._unseen] = math.nan
        r = self._numbers("reference", reference, self._outputs)
        slope = np.zeros(len(r)) if rate is None else self._numbers("rate", rate, self._outputs)
        try:
            if self._native is not None:
                found = self._native.act(y, r, slope)
            else:
                self._require_finite(y, r, slope)
                action, memory = self._law.step(self._memory, *map(torch.from_numpy, (y, r, slope)))
                if not all(bool(values.isfinite().all()) for values in (action, *memory)):
                    raise ArithmeticError
                found, self._memory = action.double().numpy().copy(), memory
        except (ArithmeticError, ValueError) as error:
            self._require_finite(y, r, slope)
            raise ValueError(
                f"no action follows from measurement {y.tolist()} and reference {r.tolist()}, as numbers of policy or "
                "observer grow too large; the controller is as before: give values of the plant, or reset it"
            ) from error
        self._begun = True
        if not self._warned and (far := (r < self._near[0]) | (r > self._near[1])).any():
            self._warned, k = True, int(far.argmax())
            told = f"the reference of {self.outputs[k]} is {r[k]:g}, far beyond the plan ({self.targets_in_words()[k]})"
            warnings.warn(f"{told}: give one in this range, or plan for a wider one", stacklevel=2)
        return found

    def _prepare(self) -> None:
        from dynasindy.control.c_code import Native, controller_sources

        self._native = None
        with suppress(OSError, ValueError):  # no compiler, or a policy or a model that is not written in C
            self._native = Native(controller_sources(self))
        self._names, self._outputs = self.signature.state_names, self.outputs
        self._unseen = [i for i, name in enumerate(self._names) if name not in self.measured]
        low, high = np.array(self.setup.task.ends or ([-math.inf], [math.inf]))
        self._near = low - self.setup.task.boxes().numpy(), high + self.setup.task.boxes().numpy()
        self._prepared = True

    def _numbers(self, what: str, given: Values, names: Sequence[str]) -> Array:
        if isinstance(given, Mapping) and (unknown := [name for name in given if name not in names]):
            allowed = self.measured if what == "measurement" else names
            near = did_you_mean(unknown[0], list(allowed))
            raise ValueError(f"{what} has '{unknown[0]}'; allowed are {', '.join(allowed)}{near}")
        numbers: Any = given
        try:
            if isinstance(given, Mapping):
                # NaN is a measurement that is not there; that a reference is whole is seen to later.
                numbers = [float(given.get(name, 0.0 if what == "rate" else math.nan)) for name in names]
            elif isinstance(given, Tensor):
                numbers = given.detach().cpu()
            values: Array = np.array([] if numbers is None else numbers, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):  # text, or rows of different lengths
            values = np.array([])
        if values.size != len(names):
            by_name = ", or those that are measured by name" if what == "measurement" else ""
            told = f"has {values.size} numbers" if values.size else f"is {given}"
            raise ValueError(f"{what} {told}; give a number for each of {', '.join(names)}{by_name}")
        return values

    def _require_finite(self, y: Array, r: Array, slope: Array) -> None:
        """Refuse numbers that are not finite; measurements may be missing where an observer estimates the states."""
        more = "; only a controller with sensors and an observer does without a state"
        known = y if self.observer is None else np.where(np.isnan(y), 0.0, y)
        for what, values, names, hint in (
            ("measurement", known, self._names, more),
            ("reference", r, self._outputs, ""),
            ("rate", slope, self._outputs, ""),
        ):
            if (wrong := np.flatnonzero(~np.isfinite(values))).size:
                place = int(wrong[0])
                given = "nan, or was not given" if np.isnan(values[place]) else f"{values[place]}"
                raise ValueError(f"{what} of {names[place]} is {given}; give a finite number{hint}")


FORMAT = "dynasindy controller 1"
NAME = "controller.json"
"""Its name in a run folder."""
FINEST = 1000
"""Runge-Kutta steps per control period that are read."""


def save(controller: Controller, path: str | Path) -> None:
    """Write a controller, with all that it is made of.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`, and the model of its observer a sparse one.
        path: File to write.

    Raises:
        ValueError: The policy or the observer's model is of another kind, which no file holds.
    """
    task, integral, observer = controller.setup.task, controller.integral, controller.observer
    moved = observer or controller.setup
    ends = asdict(moved.stops) if moved.stops else {}
    numbers = None if integral is None else IntegralAction(controller.policy, controller.setup, **integral)
    record = {
        "format": FORMAT,
        "signature": asdict(controller.signature),
        "task": {
            "dt": controller.dt,
            "substeps": moved.substeps,
            # JSON has no infinite numbers, and an end that is not there is null.
            "stops": {key: [end if math.isfinite(end) else None for end in each] for key, each in ends.items()} or None,
            "outputs": list(task.output_names),
            "rates": task.rate_names,
            "observe_rate": task.observe_rate,
            "error_scale": task.error_scale,
            "box": task.boxes().tolist(),
            "targets": task.ends,
            "start": dict(zip(controller.signature.state_names, task.start_ends.mT.tolist(), strict=True)),
            "input_limits": task.input_limits.tolist(),
        },
        "policy": [
            {"in": w.shape[1], "out": w.shape[0], "weight": _packed(w), "bias": _packed(b)}
            for w, b in ((layer.weight, layer.bias) for layer in controller.network.layers())
        ],
        "integral": numbers and {name: getattr(numbers, name) for name in ("gain", "band", "limit", "rate")},
        "observer": observer
        and {
            "sensors": asdict(observer.sensors),
            "state": observer.state_dict(),
            "model": observer.sparse_model.record(),
        },
    }
    write_json(Path(path), record)


def load(path: str | Path) -> Controller:
    """Read a controller that `save` wrote, from its file or from the run folder that holds it.

    Args:
        path: File, or folder of a run.

    Returns:
        The controller, as it was saved.

    Raises:
        FileNotFoundError: There is no such file.
        DamagedFileError: The file is damaged, or not of this format.
    """
    file = Path(path) / NAME if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise FileNotFoundError(
            f"{file} does not exist; give a saved controller, or the folder of a run that has ended"
        )
    record = read_json(file)
    if record.get("format") != FORMAT:
        raise DamagedFileError(f"{file} is not of the format {FORMAT!r}; give a {NAME} of a run folder")
    with reading(file):
        signature = Signature(**record["signature"])
        given = record["task"]
        outputs, substeps = list(given["outputs"]), given["substeps"]
        if type(substeps) is not int or not 1 <= substeps <= FINEST:
            raise ValueError(f"substeps is {str(substeps)[:40]!r}; allowed are whole numbers from 1 to {FINEST}")
        # Files that were written before targets and starts were kept, and before inputs had limits, have none.
        least, most = ([_number(value) for value in row] for row in given.get("targets") or ((), ()))
        task = Tracking(
            signature,
            Step([[0.0] * len(outputs)]),
            outputs,
            list(given["rates"]),
            TrackingReward(error_weights=(1.0,)),
            observe_rate=bool(given["observe_rate"]),
            error_scale=_number(given["error_scale"], 0.0),
            low=least or None,
            high=most or None,
            start=given.get("start"),
        )
        limits = given.get("input_limits", task.input_limits.tolist())
        task = task.with_input_limits([[_number(end) for end in row] for row in limits])
        task = task.with_box([_number(extent, 0.0) for extent in given["box"]])
        stops = None
        if (found := given["stops"]) is not None:
            low, high = (
                tuple(none if end is None else _number(end) for end in found[key])
                for key, none in (("low", -math.inf), ("high", math.inf))
            )
            stops = Stops(tuple(found["positions"]), tuple(found["rates"]), low, high)
            stops.rows(signature.n_x)  # refuses states that do not exist
        setup = ControlSetup(task, _number(given["dt"], 0.0), substeps, stops)
        policy = TensorDictModule(_network(record["policy"], task), in_keys=["observation"], out_keys=["action"])
        observer, known = None, record["observer"]
        if known is not None:
            model = SindyModel.of_record(known["model"], file)
            # The ranges may differ: of an output that a log shows far beyond its targets, policy and model have each
            # its own.
            if not model.signature.alike(signature):
                raise ValueError("the model of its observer has other states than the controller")
            own = {name: value for name, value in known["sensors"].items() if name != "process_noise"}  # in older files
            observer = Observer(model, Sensors(**own), setup)
            observer.load_state_dict(known["state"])
        integral = record["integral"]
        numbers = None if integral is None else {name: _number(value, 0.0) for name, value in integral.items()}
        return Controller(policy, setup, observer, numbers)


def _network(layers: list[dict[str, Any]], task: Tracking) -> MLP:
    widths = [int(layers[0]["in"]), *(int(layer["out"]) for layer in layers)]
    if (widths[0], widths[-1]) != (task.n_o, task.signature.n_u):
        raise ValueError(
            f"its policy has {widths[0]} inputs and {widths[-1]} outputs, its task {task.n_o} and {task.signature.n_u}"
        )
    values = [
        (_unpacked(layer["weight"], n_out, n_in), _unpacked(layer["bias"], n_out))
        for layer, (n_in, n_out) in zip(layers, pairwise(widths), strict=True)
    ]
    found = MLP(widths[0], widths[-1], widths[1:-1], squash=True).requires_grad_(False)
    for own, (weight, bias) in zip(found.layers(), values, strict=True):
        own.weight.copy_(weight)
        own.bias.copy_(bias)
    return found


def _packed(values: Tensor) -> str:
    return base64.b64encode(values.detach().to(torch.float32).cpu().numpy().astype("<f4").tobytes()).decode()


def _unpacked(text: str, *shape: int) -> Tensor:
    values, wanted = np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32), math.prod(shape)
    if values.size != wanted or not np.isfinite(values).all():
        raise ValueError(f"its policy has {values.size} weights where {wanted} finite ones belong")
    return torch.from_numpy(values).reshape(shape)


def _number(value: object, low: float = -math.inf) -> float:
    """Return a finite number above another one; a file may hold anything."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low < value < math.inf:
        what = "a positive" if low == 0 else "a finite"
        raise ValueError(f"{str(value)[:40]!r} stands where {what} number belongs")
    return float(value)
