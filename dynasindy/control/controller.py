"""A controller: state observer, integral action and policy, stepped once per control period.

It does what an evaluation does to a policy, but for one plant, without a simulation of it: the measurements come from
outside. `dynasindy.control.files` keeps it in one file, which has all that it is made of.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from dynasindy.control.integral import IntegralAction
from dynasindy.sensing import Observer
from dynasindy.sensing.observer import Belief
from dynasindy.sensing.offset import Policy, acting
from dynasindy.systems import Signature, Stops
from dynasindy.tasks import Tracking
from dynasindy.tasks.references import N_PARAMS
from dynasindy.text import did_you_mean

Values = float | Sequence[float] | NDArray[np.float64] | Tensor | Mapping[str, float]
"""Numbers in the order of the signature, or by name."""


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
        self._warned = False
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

    def __repr__(self) -> str:
        names, units = self.signature.state_names, self.signature.state_units
        outputs = ", ".join(f"{name} [{units[names.index(name)]}]" for name in self.outputs)
        measured = self._measured()
        seen = ", ".join(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True) if name in measured)
        parts = [part for part, there in (("observer", self.observer), ("integral action", self.integral)) if there]
        more = f", with {' and '.join(parts)}" if parts else ""
        inputs = ", ".join(self.signature.input_names)
        ends = "[-1, 1]"
        if self.setup.task.limited:
            ends = ", ".join(f"[{low:.3g}, {high:.3g}]" for low, high in self.setup.task.input_limits.mT.tolist())
        inputs = "; ".join([f"{inputs} in {ends} every {self.dt:g} s{more}", *self.signature.own_inputs(ranged=False)])
        return f"Controller(holds {outputs}; reads {seen}; sets {inputs})"

    def reset(self) -> None:
        """Forget what was measured; the next call of `act` takes the plant as at rest, its inputs zero."""
        self._integral = None if self.integral is None else IntegralAction(self.policy, self.setup, **self.integral)
        whole = self._integral or self.policy
        pushed = self.observer is not None and bool(self.observer.pushed)
        self._act = acting(whole, self.setup, pushed)
        self._belief: Belief | None = None
        self._periods = 0
        self._shift = torch.zeros(0, dtype=torch.float64)
        if self.observer is not None:
            n_u = self.signature.n_u
            self._inputs = torch.zeros(self.observer.memory, n_u)
            self._shift = torch.zeros(self.signature.n_x + n_u, dtype=torch.float64)

    @property
    def estimate(self) -> NDArray[np.float64] | None:
        """State of the plant at the last call of `act`, as far as the observer knows, `(n_x,)`; None without it."""
        if self._belief is None:
            return None
        mean: NDArray[np.float64] = self._belief.mean[: self.signature.n_x].numpy().copy()
        return mean

    def targets_in_words(self) -> list[str]:
        """Return the range of targets that each output was planned for, `h3 from 8 to 25 cm`; none if not known."""
        signature, ends = self.signature, self.setup.task.ends
        units = [signature.state_units[i] for i in self.setup.task.outputs]
        rows = zip(self.outputs, *(ends or ((), ())), units, strict=False)
        return [f"{name} from {low:g} to {high:g} {unit}" for name, low, high, unit in rows]

    @torch.no_grad()
    def act(self, measurement: Values, reference: Values, rate: Values | None = None) -> NDArray[np.float64]:
        """Return the inputs of the control period that begins now, `(n_u,)`, in [-1, 1].

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
        y = self._numbers("measurement", measurement, self.signature.state_names, math.nan)
        if self.observer is not None:
            y[[i for i, name in enumerate(self.signature.state_names) if name not in self._measured()]] = math.nan
        self._require("measurement", y, self.signature.state_names, gaps=self.observer is not None)
        r = self._numbers("reference", reference, self.outputs, math.nan)
        slope = self._numbers("rate", {} if rate is None else rate, self.outputs, 0.0)
        for name, values in (("reference", r), ("rate", slope)):
            self._require(name, values, self.outputs, gaps=False)
        self._warn_far(r)
        action = self._answer(y, r, slope)
        self._periods = 1
        if self.observer is not None:
            self._inputs = torch.cat([self._inputs[1:], action.unsqueeze(0)])
        found: NDArray[np.float64] = action.double().numpy().copy()
        return found

    def _measured(self) -> list[str]:
        """Return the names of the states that are measured: all of them, or those that the observer is told."""
        names = self.signature.state_names
        channels = self.observer.sensors.channels if self.observer is not None else None
        return [name for name in names if channels is None or name in channels]

    def _refused(self, what: str, name: str, names: Sequence[str]) -> ValueError:
        """Return the error that a name of nothing ends in, with what can be given."""
        measured = self._measured() if what == "measurement" else list(names)
        estimated = ", ".join(each for each in names if each not in measured)
        more = f"; leave out {estimated}, which the controller estimates" if estimated else ""
        hint = did_you_mean(name, measured)
        return ValueError(f"{what} has '{name}', which does not exist; allowed are {', '.join(measured)}{more}{hint}")

    def _warn_far(self, r: Tensor) -> None:
        """Warn once of a reference that lies more than a target range beyond the targets of the plan."""
        task = self.setup.task
        if self._warned or task.ends is None:
            return
        low, high = torch.tensor(task.ends, dtype=torch.float64)
        far = torch.maximum(r - high, low - r) > task.boxes()
        if bool(far.any()):
            self._warned, k = True, int(far.nonzero()[0])
            warnings.warn(
                f"the reference of {self.outputs[k]} is {r[k].item():g}; the controller was planned for "
                f"{self.targets_in_words()[k]}, and nothing is known of what it does so far from that: give a "
                "reference in this range, or plan for a wider one",
                stacklevel=4,
            )

    def _answer(self, y: Tensor, r: Tensor, slope: Tensor) -> Tensor:
        """Return the action, `(n_u,)`; estimate and integral stay as they were where it is no number."""
        belief, shift = self._belief, self._shift
        integral = None if self._integral is None else self._integral.integral
        try:
            action: Tensor = self._act(self._seen(y, r, slope))["action"]
            kept = [action, self._shift]
            kept += [] if self._belief is None else [self._belief.mean, self._belief.covariance]
            kept += [] if self._integral is None or self._integral.integral is None else [self._integral.integral]
            if not all(bool(values.isfinite().all()) for values in kept):
                raise ArithmeticError
        except (ArithmeticError, torch.linalg.LinAlgError) as error:  # type: ignore[attr-defined]
            self._belief, self._shift = belief, shift
            if self._integral is not None:
                self._integral.integral = integral
            raise ValueError(
                f"no action follows from measurement {y.tolist()} and reference {r.tolist()}, as numbers grow beyond "
                "all limits; the controller is as before: give values of the plant's range, or call its reset"
            ) from error
        return action

    def _seen(self, y: Tensor, r: Tensor, slope: Tensor) -> TensorDict:
        """Return what the policy is shown."""
        x, held = (y, {}) if self.observer is None else self._estimated(self.observer, y)
        steps = torch.tensor([self._periods])  # 0 begins, whatever comes later goes on
        t = steps.to(x) * self.dt
        params = _line(r, slope, float(t))
        observation = self.setup.task.observation(x, params, t).float()
        shown = {"observation": observation, "state": x, "task_params": params, "step_count": steps, "observer": held}
        return TensorDict(shown if held else {k: v for k, v in shown.items() if k != "observer"})

    def _estimated(self, observer: Observer, y: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the state for the time at which the next action arrives, and what counteracts the push."""
        if self._belief is None:
            self._belief = observer.begin(y)
        else:
            self._belief, _, _ = observer.correct(observer.advance(self._belief, self._inputs), y)
        mean = observer.ahead(self._belief.mean, self._inputs)
        if observer.pushed:
            self._shift = observer.correction(mean, self._inputs, self.setup.task.outputs, self._shift)
        return mean[: self.signature.n_x], {"shift": self._shift}

    def _numbers(self, what: str, given: Values, names: Sequence[str], missing: float) -> Tensor:
        """Return numbers in the order of names, float64."""
        if isinstance(given, Mapping):
            if unknown := [name for name in given if name not in names]:
                raise self._refused(what, unknown[0], names)
            if what == "reference" and (absent := [name for name in names if name not in given]):
                raise ValueError(f"{what} lacks {absent[0]}; give where each of {', '.join(names)} is to be")
            given = [float(given.get(name, missing)) for name in names]
        values = torch.as_tensor(given, dtype=torch.float64).flatten()
        if values.numel() != len(names):
            by_name = ", or those that are measured by name" if what == "measurement" else ""
            raise ValueError(f"{what} has {values.numel()} numbers; give one for each of {', '.join(names)}{by_name}")
        return values.clone()

    @staticmethod
    def _require(what: str, values: Tensor, names: Sequence[str], gaps: bool) -> None:
        wrong = values.isinf() if gaps else ~values.isfinite()
        if bool(wrong.any()):
            place = int(wrong.nonzero()[0])
            more = (
                "; only a controller with sensors and an observer does without a state" if what == "measurement" else ""
            )
            raise ValueError(f"{what} of {names[place]} is {values[place].item()}; give a finite number{more}")


def _line(r: Tensor, slope: Tensor, t: float) -> Tensor:
    """Return the parameters of a reference that is at `r` at time t and moves by `slope`, `(n_r, 5)`.

    A sine of 1 rad/s at its zero has its amplitude as slope.
    """
    params = torch.zeros(len(r), N_PARAMS, dtype=r.dtype)
    params[:, 0], params[:, 1], params[:, 2], params[:, 3] = r, slope, 1 / (2 * math.pi), -t
    return params
