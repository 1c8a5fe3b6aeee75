"""The sparse world model: dx/dt = Xi' Theta(x, u), or x[k+1] = x[k] + h Xi' Theta(x[k], u[k]), fitted to transitions.

| name         | symbol          | unit                     | source                          |
| ------------ | --------------- | ------------------------ | ------------------------------- |
| library      | Theta(x, u)     | that of each function    | the paper, eq. (library)        |
| coefficients | Xi              | dx per unit of Theta     | the paper, eq. SINDY-EQ         |
| threshold    | lambda          | 1                        | the paper, 0.9; see `Regression` |

Departure: the paper regresses derivatives; here changes over sampling intervals are regressed on the functions
averaged over the intervals, which is exact for inputs held by a zero-order hold.

A difference equation has the functions where its steps begin, and its changes over a step h are what it says.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from dynasindy.findings import Finding, note, weak
from dynasindy.safe_io import read_json, reading, write_json
from dynasindy.sentences import setting
from dynasindy.sindy.codegen import Field, Writer, generate, simulate
from dynasindy.sindy.covariance import Covariance, of_rates
from dynasindy.sindy.delay import delay_inputs, rows_after_delay
from dynasindy.sindy.fit_report import FitReport, Refined
from dynasindy.sindy.functions import FunctionError, formula_texts, registering
from dynasindy.sindy.library import Constraints, Feature, Library, equations
from dynasindy.sindy.named_libraries import GENERAL, LibraryBuilder, build_library
from dynasindy.sindy.reconstruction import (
    RegressionData,
    rate_states,
    reconstruct,
    settle_lag_states,
    simulate_hidden_states,
)
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import DEPENDENT, SAMPLES_EACH, Regression, Rows, TriangularFactor
from dynasindy.sindy.shooting import CHOSEN_STRETCHES, COARSE, RunsAway, relative_step, substeps_for
from dynasindy.sindy.trajectory_fit import selection_rows
from dynasindy.sindy.world_model import WorldModel
from dynasindy.systems.base import PRECISIONS, Diverged, Signature
from dynasindy.systems.integrators import moved, plain, trajectory
from dynasindy.systems.machine import Machine
from dynasindy.systems.steps import UNTOLD
from dynasindy.systems.transitions import Transitions

FORMAT = "dynasindy sparse model 1"
FEWEST_EACH = 3
"""Samples for each function below which a library that a word names is cut to the size of the data. Of fewer, the inner
samples that `needed_at_edge` fits to would not be two for each. Where states were not all measured it is one."""
POINTS = 64
"""Points within the ranges of states and inputs at which a model's fastest motion is looked for."""
MOVED = 1e-3
"""Part of a first guess by which a number has moved that was fitted."""
LONGEST = 1e9
"""Longest step and delay that a file may have [s]."""
LARGEST_SYSTEM = 200
"""Number of states beyond which a model is taken for damaged."""
STEPS, EXACT = 0.5, 1e-6
"""Share of a differential equation's error on data kept back below which a difference equation is taken instead, and an
error [ranges a second] that no plan can feel."""
LARGEST_FACTOR = 1000
"""Numbers of a coefficient's correlations beyond which it is as well."""


class SindyModel(WorldModel):
    """A vector field that is a sparse sum of candidate functions.

    Args:
        signature: names, units and ranges of the plant.
        library: candidate functions: a library, its builder, a name of `libraries.NAMED`, or functions in words. One
            that a name selects is cut to the size of the data, by each fit anew.
        regression: settings of the sparse regression; the paper's by default.
        refinement: settings of the refinement on the prediction error; none by default.
        known: equations that are known, e.g. `{"alpha_a": "Omega_a"}`: the state's rate is that function, nothing else.
        allowed: functions that may occur in an equation, by state; all by default.
        fixed: coefficients that are given, by state and function name.
        initial: first guess of the equations, by state and function name, instead of a regression: for plants with a
            state that no sensor sees in any form.
        machine_code: whether states are moved by machine code, where a C compiler is found.
        time: `continuous` identifies a differential equation, `discrete` a difference equation, whose step is the
            sampling time of the data, `auto` the one that predicts the end of the first data better. What is `known` of
            rates then holds in a differential equation alone.

    `covariance` tells after a fit how well the coefficients are known; None where nothing does. `findings` holds what
    `dynasindy.identify` found, `linear_inputs` the names of the inputs that moved in straight lines between the samples
    of the log, where others are held, `memory` on how much of the past states were best estimated [s], 0 where nothing
    told, `process_noise` with which [ranges of the states per root of a second], `stride` how many sampling intervals
    lie between the samples that were fitted, and `places` which functions are left of a library that was cut to the
    size of the data; it is empty where the library is whole.

    Raises:
        ValueError: a name of a state, an input or a function does not exist, or `time` is another word.
    """

    coefficients: Tensor

    def __init__(
        self,
        signature: Signature,
        library: str | Sequence[str] | Library | LibraryBuilder = "paper_table",
        regression: Regression | None = None,
        refinement: Refinement | None = None,
        known: Mapping[str, str] | None = None,
        allowed: Mapping[str, Sequence[str]] | None = None,
        fixed: Mapping[str, Mapping[str, float]] | None = None,
        initial: Mapping[str, Mapping[str, float]] | None = None,
        machine_code: bool = True,
        time: Literal["continuous", "discrete", "auto"] | None = None,
    ) -> None:
        super().__init__(signature)
        self.findings: tuple[Finding, ...] = ()
        self.linear_inputs: tuple[str, ...] = ()
        self.memory, self.process_noise, self.stride = 0.0, 0.0, 1
        if time not in (None, "continuous", "discrete", "auto"):
            word = setting("world_model.time")
            raise ValueError(f"{word} is {time!r}; allowed are continuous, discrete and auto: choose one")
        self.machine_code, self.library = machine_code, build_library(library, signature)
        if time is not None and (time == "discrete") != (self.library.step is not None):
            self.library = self.library.with_step(UNTOLD if time == "discrete" else None)
        self.named, self.places = library if isinstance(library, str) else None, list[int]()
        self.register_buffer("coefficients", torch.zeros(len(self.library), signature.n_x, dtype=torch.float64))
        self._field: Field | None = None
        self._field_of: tuple[Tensor, int, Library] | None = None
        self._fastest: float | None = None
        self.regression, self.refinement = regression or Regression(), refinement
        self.constraints = Constraints.build(self.library, known or {}, allowed or {}, fixed or {})
        self.given_known = known  # None says that nobody knows, {} that there is nothing to be known
        self._uncut, self._either = (self.library, self.constraints), None
        if time == "auto":
            # The rate of a place is that of a moment: over a step it moves by what its rate becomes, too.
            self._either = self.constraints, Constraints.build(self.library, {}, allowed or {}, fixed or {})
        guess = Constraints.build(self.library, {}, {}, initial or {}, "plant.initial").offset
        self.initial = None if initial is None else guess
        self.initial_delay: float | None = None  # of the inputs in that guess [s]; None: not known
        self.samples = 0  # of the latest fit
        self.coefficients = self.constraints.offset.clone()
        self.covariance: Covariance | None = None

    @property
    def step(self) -> float | None:
        """Step of its difference equation [s], `UNTOLD` before a fit; None of a differential equation."""
        return self.library.step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Compute dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""
        self._forget()
        if self._field is None:
            self._field = generate(self.library, self.coefficients.cpu())
        return self._field(x, u)

    def compiled(self, x: Tensor, u: Tensor) -> Machine | None:
        """Return the model as machine code for such states and inputs, in the memory of the CPU."""
        if not self.machine_code or x.dtype not in PRECISIONS or type(self).forward is not SindyModel.forward:
            return None
        self._forget()
        return self._machine(x, u, lambda dtype: Machine(Writer(self.library, self.coefficients).program(), dtype))

    def _forget(self) -> None:
        """Forget what was written of equations that have changed."""
        made_of, version, library = self._field_of or (None, 0, None)
        # The tensor itself is compared and so kept alive: its id may be that of a later one once it is gone.
        if made_of is self.coefficients and version == self.coefficients._version and library is self.library:
            return
        self._field = self._fastest = None
        self._machines.clear()
        self.library.require_finite(self.coefficients)
        self._field_of = self.coefficients, self.coefficients._version, self.library

    def __getstate__(self) -> dict[str, object]:
        """Leave generated code out of copies and pickles; it is written again when needed."""
        return {**super().__getstate__(), "_field": None, "_field_of": None}

    def substeps(self, dt: float, turned: float = COARSE) -> int:
        """Return into how many Runge-Kutta steps a time [s] is divided for its fastest motion within its ranges.

        Args:
            dt: The time [s].
            turned: The longest step, times the fastest rate.
        """
        if self.step is not None:
            return 1
        self._forget()
        if self._fastest is None:
            n_x, n_u = self.signature.n_x, self.signature.n_u
            points = 2 * torch.rand(POINTS, n_x + n_u, generator=torch.Generator().manual_seed(0)).double() - 1
            points[::2, :n_x] *= points[1::2, :n_x] > 0  # any of the states at rest, where dry friction is steepest
            x = points[:, :n_x] * torch.tensor(self.signature.x_scale, dtype=torch.float64)
            self._fastest = relative_step(self.library, self.coefficients, x, points[:, n_x:], 1.0)
        return substeps_for(self._fastest * dt, turned)

    def predict(self, x: Tensor, u: Tensor, dt: float, substeps: int = 1) -> Tensor:
        """Predict states one sampling time ahead, `(*batch, n_x)`, by `substeps` Runge-Kutta steps."""
        # State-major memory: every row of an elementwise operation is contiguous.
        x, u = (t.movedim(-1, 0).contiguous().movedim(0, -1) for t in (x, u))
        return moved(self, x, u, dt, substeps)

    def simulate(self, x0: Tensor, u: Tensor, dt: float, substeps: int = 1, u_end: Tensor | None = None) -> Tensor:
        """Predict trajectories open loop.

        Args:
            x0: start states, `(*batch, n_x)`.
            u: inputs at the start of each interval, `(*batch, T, n_u)`.
            dt: sampling time [s].
            substeps: Runge-Kutta steps per interval.
            u_end: inputs at its end, to which they move in a straight line, `(*batch, T, n_u)`; held if omitted.

        Returns:
            States, `(*batch, T + 1, n_x)`, the start first.
        """
        batch = np.broadcast_shapes(x0.shape[:-1], u.shape[:-2])  # by torch it would cost an import of sympy
        x0, u = x0.expand(*batch, -1), u.expand(*batch, -1, -1)
        last = None if u_end is None else u_end.expand_as(u)
        double = x0.dtype == u.dtype == torch.float64 and x0.device.type == u.device.type == "cpu"
        own = type(self).forward is SindyModel.forward and not self._forward_hooks
        if self.machine_code and own and double and plain(x0, u, self.coefficients):  # nothing is compiled
            rows = math.prod(batch)  # without inputs, -1 in a shape would be ambiguous
            flat = x0.reshape(rows, x0.shape[-1]), u.reshape(rows, *u.shape[-2:])
            ends = None if last is None else last.reshape(flat[1].shape)
            found = simulate(self.library, self.coefficients, *flat, dt, substeps, ends)
            return torch.cat([x0.unsqueeze(-2), found.reshape(*u.shape[:-1], -1)], -2)
        ends = None if last is None else last.movedim(-2, 0)
        states = torch.cat([x0.unsqueeze(0), trajectory(self, x0, u.movedim(-2, 0), dt, substeps, ends)])
        return states.movedim(0, -2)

    @property
    def followed(self) -> dict[str, str]:
        """States that only follow, as a' = k (s - a), each with the state or input s that it follows."""
        found, used = {}, self.constraints.free | (self.constraints.offset != 0)
        counts = used.sum(0).tolist()
        for i, name in enumerate(self.signature.state_names):
            factors = [*self.library.features[int(used[:, i].int().argmax())].factors] if counts[i] == 1 else []
            if [factor.function for factor in factors] == ["ahead"] and factors[0].variables[1] == name:
                found[name] = factors[0].variables[0]
        return found

    @property
    def followers(self) -> dict[int, int]:
        """Places of the states that only follow another state, and of that."""
        names = self.signature.state_names
        return {names.index(name): names.index(s) for name, s in self.followed.items() if s in names}

    def guess_states(self, data: Transitions) -> Transitions:
        """Return a recording with a guess of what was not measured: rates by differences, what lags as at rest.

        Args:
            data: the recording, NaN where a state was not measured.
        """
        return settle_lag_states(reconstruct(data, rate_states(self.library, self.constraints)), self.followers)

    def get_extra_state(self) -> dict[str, object]:
        """Return what `state_dict` keeps besides the coefficients, as the fitted factors and the delay."""
        return {
            "count": self.samples,
            "places": self.places,
            "shapes": [shape.frequency for shape in self.library.shapes],
            "delay": self.delay,
            "step": self.step,
            "covariance": self.covariance and tuple(self.covariance),
        }

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *others: Any) -> None:
        """Cut the library as it was when the state was kept, or not at all, before coefficients are read."""
        state = state_dict.get(f"{prefix}_extra_state")
        if state is not None and self._either is not None:
            self._become(discrete=state.get("step") is not None)
        if state is not None and (places := state.get("places", [])) != self.places:  # not in older states
            self._keep(places)
        super()._load_from_state_dict(state_dict, prefix, *others)

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `get_extra_state` returned."""
        self.samples = state["count"]
        self.library = self.library.with_shapes(state["shapes"]).with_step(state.get("step"))
        self.covariance = (known := state.get("covariance")) and Covariance(*known)  # not in older states
        self.delay, self._field_of = state["delay"], None

    def fit(self, transitions: Transitions) -> FitReport:
        """Identify the model from transitions alone, forgetting earlier data.

        Args:
            transitions: samples; those that touch a stop are no smooth dynamics and belong left out.

        Returns:
            What was found and how well it fits.

        Raises:
            ValueError: there are fewer samples than functions, or a sample is not finite; the model stays as it was.
            Diverged: a coefficient is not finite; the model stays as it was.
        """
        go_back = self.kept()
        try:
            chosen = self._choose_time(transitions) if self._either is not None and not self.samples else ()
            if again := self._cuts and 0 < len(self.places) == len(self.library):
                self._keep([])  # other data may need other functions
            self.library = self.library.with_step(None if self.step is None else UNTOLD)
            report = self._identify(transitions, again)
            return replace(report, findings=(*chosen, *report.findings))
        except BaseException:
            go_back()
            raise

    def _choose_time(self, transitions: Transitions) -> tuple[Finding, ...]:
        """Take difference equations where they predict the last quarter of the data clearly better."""
        whole = len(transitions) // transitions.substeps
        kept = torch.arange(len(transitions)) >= (3 * whole // 4) * transitions.substeps
        errors = list[float]()
        for discrete in (False, True):
            trial = copy.deepcopy(self)
            trial._become(discrete)
            trial._either, trial.refinement = None, None
            try:
                trial.fit(transitions.select(~kept))
                data = trial._checked(transitions.select(kept))
                missed = trial.predict(data.x, data.u, data.dt, trial.substeps(data.dt)) - data.x_next
                errors.append(float((missed / torch.tensor(self.signature.x_scale)).square().mean().sqrt() / data.dt))
            except (ValueError, Diverged):
                errors.append(math.inf)
        if not max(errors[1], EXACT) < STEPS * errors[0]:
            return ()
        self._become(discrete=True)
        return (note("fit.steps", error=errors[1], continuous=errors[0]),)

    def _become(self, discrete: bool) -> None:
        """Become a difference equation, whose rates nothing is known of, or a differential one, if it is not yet."""
        if self._either is not None and discrete != (self.step is not None):
            self._uncut = self._uncut[0].with_step(UNTOLD if discrete else None), self._either[discrete]
            self._keep([])

    def _identify(self, transitions: Transitions, cut_before: bool) -> FitReport:
        """Fit to transitions alone; a library that was `cut_before` is cut again: the whole one may take too long."""
        start = time.process_time()
        data, constraints, cut = self._checked(transitions), self.constraints, list[Finding]()
        rates, first = rate_states(self.library, constraints), None
        guess = self.guess_states(data)
        hidden = data.x.isnan().all(0) & data.x_next.isnan().all(0)
        if self.initial is not None:
            first = torch.where(constraints.free, self.initial, constraints.offset)
            units, unscaled = _units_of_guess(self.library, first, constraints.free, hidden)
            if unscaled:
                constraints = Constraints(constraints.free & ~units, torch.where(units, first, constraints.offset))
                cut.append(note("fit.unscaled", states=unscaled))
            acting = delay_inputs(guess, self.initial_delay or 0.0)
            led = simulate_hidden_states(self.library, first, data, acting, rates)
            started = _start_lag_states(self.library, first, led, self.followers)
            guess = replace(started, u=data.u, u_end=data.u_end)
        seen = RegressionData(data, guess, rates)
        rows = seen.rows(self.library)
        # Where states were not all measured, regressions choose badly, and trajectories from the whole library.
        fewest = 1 if seen.half else FEWEST_EACH
        few = len(data) < fewest * len(self.library) or (cut_before and not seen.half)
        if self._cuts and few:
            rows, cut = self._cut(rows)  # where there is no first guess
            constraints = self.constraints
        factor, library = TriangularFactor(rows), self.library
        if first is None:
            self._solve(factor, seen.dependent)
            if self.refinement is None:
                self.covariance = of_rates(self.coefficients, self.constraints.free, *rows)
        else:
            self.set_coefficients(first)
        self.delay = 0.0
        refined = self._refine(seen, None if first is None else self.initial_delay, constraints)
        if self.library is not library or self.delay:  # the functions are others now, and so are their averages
            late = replace(seen, longest=self.delay).delayed(self.delay)
            factor = TriangularFactor(late.rows(self.library))
        self.samples, findings = len(data), (*cut, *refined.findings)
        if self.refinement is not None:
            active = (self.coefficients != 0).any(-1).nonzero().flatten().tolist()
            shapes = {f.base: None for k in active for f in self.library.features[k].factors if f.fitted}
            still = [f for f in shapes if abs(f.frequency - f.fitted) <= MOVED * abs(f.fitted)]
            findings += (*(weak("fit.shape", function=Feature.of([f]).name(), guess=f.fitted) for f in still),)
        return FitReport(
            self.library,
            self.coefficients.clone(),
            factor,
            time.process_time() - start,
            # The factor may be that of fewer rows, each of them the average of many transitions.
            int(rows_after_delay(data, self.delay).sum()),
            refined.missed,
            findings,
            data.dt,
            self.covariance,
            frozenset(n for i, n in enumerate(self.signature.state_names) if hidden[i] and i not in rates),
        )

    def fit_derivatives(self, x: Tensor, u: Tensor, dx: Tensor) -> None:
        """Identify the model from states `(N, n_x)`, inputs `(N, n_u)` and their exact derivatives `(N, n_x)`.

        Raises:
            ValueError: it is a difference equation, which has no derivatives.
        """
        if self.step is not None:
            raise ValueError("a difference equation has no derivatives to be fitted to; use fit, or time='continuous'")
        x, u, dx = (t.to(torch.float64) for t in (x, u, dx))
        self._solve(TriangularFactor((self.library(x, u), dx)))

    def __str__(self) -> str:
        """Return the equations, a line for each state."""
        return "\n".join(self.equations())

    def __repr__(self) -> str:
        """Return what it is a model of, in one line."""
        used, names = int((self.coefficients != 0).sum()), self.signature
        inputs, kind = ", ".join(names.input_names), "differential" if self.step is None else "difference"
        return f"SindyModel({kind} equations of {', '.join(names.state_names)} under {inputs}; {used} coefficients)"

    def equations(self, digits: int = 4) -> list[str]:
        """Write one equation per state, e.g. `Omega_p' = -0.414 Omega_p + ...`."""
        return equations(self.library, self.coefficients, digits)

    def set_coefficients(self, coefficients: Tensor) -> None:
        """Replace Xi, `(n_features, n_x)`.

        Raises:
            ValueError: the shape does not fit the library.
        """
        if coefficients.shape != self.coefficients.shape:
            raise ValueError(
                f"coefficients got shape {tuple(coefficients.shape)}; allowed is {tuple(self.coefficients.shape)}: "
                "one row per function, one column per state"
            )
        self.coefficients = coefficients.detach().to(torch.float64).clone()
        self.covariance = None  # what was known of others says nothing of these

    def save(self, path: str | Path) -> None:
        """Write the model as readable JSON, with what was known of its equations before the data."""
        write_json(path, self.record(), indent=1, finite=False)

    @classmethod
    def load(cls, path: str | Path) -> SindyModel:
        """Read a model that `save` wrote; it predicts as the saved one did, to the last digit.

        Of the settings the file holds the `refinement`, with which `forecast` fits the model to other data; the
        `regression` of a later fit is set on what is returned.

        Raises:
            FileNotFoundError: the file does not exist.
            ValueError: the file is not such a model, or needs a function that is not registered.
        """
        return cls.of_record(read_json(Path(path)), path)

    def record(self) -> dict[str, Any]:
        """Return signature, library, coefficients, constraints, how well they are known, and the equations in words.

        Coefficients are of rates of change; a `step` [s] says that they are those of a difference equation.
        """
        library, states, table = self.library, self.signature.state_names, self.coefficients.tolist()
        data: dict[str, Any] = {
            "format": FORMAT,
            "equations": self.equations(),
            "signature": asdict(self.signature),
            "coefficients": {
                s: {n: table[k][i] for k, n in enumerate(library.names) if table[k][i]} for i, s in enumerate(states)
            },
            "library": {f.name(): f.to_list() for f in library.features},
        }
        optional = {
            "functions": formula_texts(f.function for feature in library.features for f in feature.factors),
            "delay": self.delay,
            "linear_inputs": list(self.linear_inputs),
            "memory": self.memory,
            "stride": self.stride,
            "process_noise": self.process_noise,
            "step": library.step,
            "uncertainty": self.covariance and _uncertainty(library, *self.covariance),
            "refinement": self.refinement and asdict(self.refinement),
        }
        data |= {name: value for name, value in optional.items() if value}
        if not bool(self.constraints.free.all()):
            rows = zip(states, self.constraints.free.mT.tolist(), self.constraints.offset.mT.tolist(), strict=True)
            data["constraints"] = {
                s: {
                    "free": [name for name, may in zip(library.names, free, strict=True) if may],
                    "given": {name: value for name, value in zip(library.names, offset, strict=True) if value},
                }
                for s, free, offset in rows
            }
        return data

    @classmethod
    def of_record(cls, given: object, source: str | Path) -> SindyModel:
        """Return the model whose `record` is given, exact to the last digit.

        Args:
            given: the record.
            source: where it is from, for the message.

        Raises:
            DamagedFileError: it is not of this format, or damaged.
            FunctionError: the library uses a function that is not registered and of which the data has no formula, or
                one that is another function here.
        """
        with reading(source):
            if not isinstance(given, dict) or given.get("format") != FORMAT:
                raise ValueError(f"it is not of the format {FORMAT!r} that SindyModel.save writes")
            try:
                with registering(given.get("functions", {})):
                    return _read(given)
            except RuntimeError as error:  # of torch, or of too many brackets
                raise ValueError(str(error)) from error
            except FunctionError as error:
                raise FunctionError(f"{source} cannot be used here: {error}") from error

    def _checked(self, transitions: Transitions) -> Transitions:
        """Return transitions as they are fitted, from which a difference equation takes its step."""
        data, shape = transitions.to(torch.float64), (transitions.x.shape[1], transitions.u.shape[1])
        if shape != (self.signature.n_x, self.signature.n_u):
            raise ValueError(
                f"fit got {shape[0]} states and {shape[1]} inputs; allowed are {self.signature.n_x} and "
                f"{self.signature.n_u}, as in the signature: check the columns"
            )
        library, data = (self.library, data) if self.step is None else _step_rows(self.library, data)
        least, why = len(self.library), "one per function"
        if self._cuts and (linear := SAMPLES_EACH * sum(shape)) < least:
            least, why = linear, f"{SAMPLES_EACH} per state and input"
        if len(data) < least:
            kind = "samples" if self.step is None else "whole steps without gaps"
            raise ValueError(
                f"fit got {len(data)} {kind}; allowed are {least} or more, {why}: collect more data "
                "or choose a smaller library"
            )
        self.library = library
        return data

    def _refine(self, recording: RegressionData, late: float | None, known: Constraints) -> Refined:
        """Refine the coefficients, and return what was found: what is there where there is no refinement."""
        before = Refined(self.library, self.coefficients, self.delay)
        if self.refinement is None:
            return before
        try:
            found = self.refinement.run(before[:2], known, recording, late, self.named in GENERAL)
        except RunsAway as error:
            raise Diverged(f"model learning: {error}") from error
        refined = self.library.require_finite(found.coefficients, "refinement")
        if self.coefficients[known.free].any() and not refined[known.free].any():
            return before._replace(findings=(weak("fit.dropped"),))
        self.set_coefficients(refined)
        self.covariance = found.covariance
        self.library, self.delay = found.library, found.delay
        rows = selection_rows(known.free, self.refinement.error == "innovation")
        total = len(recording.measured)
        if self.refinement.method == "integral" or not self.refinement.select or total <= rows:
            return found
        chosen = note("fit.chosen_on", rows=rows, total=total, stretches=CHOSEN_STRETCHES)
        return found._replace(findings=(*found.findings, chosen))

    @property
    def _cuts(self) -> bool:
        """Whether the library is one for any plant, of which no first guess says what is needed."""
        return self.named in GENERAL and self.initial is None

    def _cut(self, rows: Rows) -> tuple[Rows, list[Finding]]:
        """Cut a library that a word names to the size of the data, and return its rows and what was done."""
        known, whole = self.constraints, self.library
        sizes = [feature.complexity for feature in whole.features]
        kept = _screened(rows, known.free, known.offset, sizes, max(1, len(rows[0]) // SAMPLES_EACH))
        if len(kept) == len(whole):
            return rows, []
        self._keep([self.places[k] for k in kept] if self.places else kept)  # it may have been cut before, of more data
        self.library = whole.subset(kept)  # with its step, and the numbers in its functions
        found = note("fit.library_cut", library=self.named, kept=len(kept), whole=len(whole), samples=len(rows[0]))
        return (rows[0][:, kept], rows[1]), [found]

    def _keep(self, places: list[int]) -> None:
        """Keep functions of the whole library, all of them where no place is given, and forget what was learnt."""
        library, known = self._uncut
        if places:
            library, known = library.subset(places), Constraints(known.free[places], known.offset[places])
        self.library, self.constraints, self.places = library, known, places
        self.coefficients = known.offset.clone()

    def _solve(self, factor: TriangularFactor, dependent: float = DEPENDENT) -> None:
        regression = replace(self.regression, dependent=dependent) if dependent > DEPENDENT else self.regression
        found = regression.solve(factor, self.constraints.free, self.constraints.offset)
        self.set_coefficients(self.library.require_finite(found, "regression"))


def _screened(rows: Rows, free: Tensor, offset: Tensor, complexity: Sequence[float], most: int) -> list[int]:
    """Return places of `most` functions: the simplest, then those that explain most of what these leave over."""
    # Sure independence screening (Fan and Lv 2008). Functions of one complexity come in together while there is room.
    theta, dx = rows[0], rows[1] - rows[0] @ offset
    rank, chosen = torch.tensor(complexity), (offset != 0).any(-1)
    for each in rank.unique().tolist():
        more = chosen | ((rank == each) & free.any(-1))
        if int(more.sum()) > most:
            break
        chosen = more
    basis = torch.linalg.qr(theta[:, chosen]).Q
    columns, left = (part - basis @ (basis.mT @ part) for part in (theta, dx))
    columns = columns / columns.norm(dim=0).maximum(1e-6 * theta.norm(dim=0)).clamp_min(1e-300)
    explained = (columns.mT @ left).square() / left.square().sum(0).clamp_min(1e-300)
    gain = explained.where(free & (left.norm(dim=0) > 1e-6 * dx.norm(dim=0)), 0.0).amax(-1).where(~chosen, 0.0)
    best = gain.argsort(descending=True)[: max(0, most - int(chosen.sum()))]
    chosen[best[gain[best] > 2 * math.log(len(rank)) / len(theta)]] = True  # more than chance gives the best of so many
    return chosen.nonzero().flatten().tolist()


def _step_rows(library: Library, data: Transitions) -> tuple[Library, Transitions]:
    """Return the library with the step of a recording, and its control periods in which all states were measured."""
    data = _by_period(data)
    if never := data.x.isnan().all(0).nonzero().flatten().tolist():
        names = ", ".join(library.signature.state_names[i] for i in never)
        raise ValueError(
            f"a difference equation needs all of its states measured, and {names} never was; leave it out of the "
            f"states and of {setting('plant.known')}, or give {setting('world_model.time')}=continuous"
        )
    seen = (data.x.isfinite() & data.x_next.isfinite()).all(-1)
    rows = data if bool(seen.all()) else data.select(seen)
    return library.with_step(data.dt), rows


def _by_period(data: Transitions) -> Transitions:
    """Return a recording without the samples within its control periods, of which the equation says nothing."""
    n = data.substeps
    if n == 1:
        return data
    if len(data) % n or bool((data.segment.reshape(-1, n) != data.segment[::n].unsqueeze(-1)).any()):
        raise ValueError(
            f"a difference equation was given {len(data)} samples that are not whole control periods of {n}; give "
            "whole ones, or one sample per control period"
        )
    return data.decimate(n)


DEGREES = {"id": 1.0, "abs": 1.0, "sqrt": 0.5, "sign": 0.0}
"""Elementary functions of one variable that are c^p times themselves where it is c times itself, and p."""


def _units_of_guess(library: Library, xi: Tensor, free: Tensor, hidden: Tensor) -> tuple[Tensor, list[str]]:
    """Return coefficients of a first guess that set the units of hidden states that nothing tells, and these states."""
    # In another unit each coefficient is multiplied by a power of one number. Units are told by coefficients that
    # are given, and by functions that are no powers, as a sine or a bend at a level.
    names, used = library.signature.state_names, xi != 0
    degrees = torch.tensor([[_degree(f, name) for name in names] for f in library.features], dtype=torch.float64)
    degrees = torch.where(used.any(-1, keepdim=True), degrees, 0.0)
    units = torch.eye(len(names), dtype=torch.float64)
    exponents = torch.where(used.unsqueeze(-1), units - degrees.nan_to_num().unsqueeze(1), 0.0)
    exponents *= hidden & ~degrees.isnan().any(0)
    known = torch.cat([units[:1] * 0, exponents[used & ~free]])

    def _more(row: Tensor) -> bool:
        wider = torch.linalg.matrix_rank(torch.cat([known, row.unsqueeze(0)]))
        return bool(wider > torch.linalg.matrix_rank(known))

    unscaled = [name for i, name in enumerate(names) if bool(exponents[..., i].any()) and _more(units[i])]
    chosen = torch.zeros_like(used)
    for k, i in sorted((used & free).nonzero().tolist(), key=lambda place: not hidden[place[1]]):
        if _more(exponents[k, i]):
            chosen[k, i], known = True, torch.cat([known, exponents[k, i].unsqueeze(0)])
    return chosen, unscaled


def _degree(feature: Feature, name: str) -> float:
    """Return the power with which a function grows with a variable; NaN if it is no power."""
    mine = [factor for factor in feature.factors if name in factor.variables]
    return sum(each.power * (math.nan if each.fitted else DEGREES.get(each.function, math.nan)) for each in mine)


def _start_lag_states(library: Library, xi: Tensor, guess: Transitions, followers: Mapping[int, int]) -> Transitions:
    """Return a recording in which states that follow begin each stretch where a first model needs them."""
    # From another begin such a state is off by a part that decays with its own time, which rates of change tell.
    field, ends, inputs = generate(library, xi), [guess.x, guess.x_next], (guess.u, guess.last_inputs)
    seconds = (torch.arange(len(guess)) - guess.segment_starts()).double() * guess.dt
    _, stretch = guess.segment.unique(return_inverse=True)
    for follower in followers:
        others = [i for i in range(xi.shape[1]) if i != follower and bool(xi[:, i].any())]
        unit, fast = torch.eye(xi.shape[1], dtype=xi.dtype)[follower], float(xi[:, follower].sum())
        offs = [torch.exp(-fast * (seconds + k * guess.dt)).unsqueeze(-1) * unit for k in (0, 1)]
        rates, moved = (
            0.5 * sum(field(end + size * off, u)[:, others] for end, off, u in zip(ends, offs, inputs, strict=True))
            for size in (0, 1)
        )
        slope, left = moved - rates, (ends[1] - ends[0])[:, others] / guess.dt - rates
        weight, none = 1 / left.square().mean(0).clamp_min(1e-300), seconds.new_zeros(int(stretch.max()) + 1)
        sums = [none.index_add(0, stretch, (slope * each * weight).sum(-1)) for each in (left, slope)]
        part = (sums[0] / sums[1].clamp_min(1e-300)).nan_to_num(0.0, 0.0, 0.0)[stretch].unsqueeze(-1)
        ends = [end + part * off for end, off in zip(ends, offs, strict=True)]
    return replace(guess, x=ends[0], x_next=ends[1])


def _uncertainty(library: Library, features: Tensor, places: Tensor, factor: Tensor) -> dict[str, Any]:
    """Return standard errors, and rows of the factor of their correlations, a line of numbers each."""
    names, states = library.names, library.signature.state_names
    # The triangular factor of the same covariance has no more columns than there are coefficients.
    factor = torch.linalg.qr(factor.mT, mode="r")[1].mT
    factor = factor * factor.diagonal().sign().where(factor.diagonal() != 0, 1.0)
    errors = factor.norm(dim=-1)
    rows = (factor / errors.clamp_min(1e-300).unsqueeze(-1)).tolist()
    told: dict[str, Any] = {"standard_errors": {s: {} for s in states}, "correlation_factor": {s: {} for s in states}}
    each = zip(features.tolist(), places.tolist(), errors.tolist(), rows, strict=True)
    for k, (feature, state, error, row) in enumerate(each):
        told["standard_errors"][states[state]][names[feature]] = error
        told["correlation_factor"][states[state]][names[feature]] = " ".join(map(repr, row[: k + 1]))
    return told


def _covariance(library: Library, data: dict[str, Any] | None) -> Covariance | None:
    if data is None:
        return None
    each = [
        (library.index(name), i, error, data["correlation_factor"][state][name].split())
        for i, state in enumerate(library.signature.state_names)
        for name, error in data["standard_errors"][state].items()
    ]
    features, states, errors, texts = zip(*each, strict=True)
    rows = [torch.tensor([*map(float, text)], dtype=torch.float64) for text in texts]
    if any(not 0 < len(row) <= LARGEST_FACTOR for row in rows) or min(errors) < 0:
        raise TypeError("its uncertainty has no standard errors of 0 or more, each with its correlations")
    sizes = torch.tensor(errors, dtype=torch.float64).unsqueeze(-1)
    factor = sizes * torch.nn.utils.rnn.pad_sequence(rows, batch_first=True)
    return Covariance(torch.tensor(features), torch.tensor(states), factor)


def _read(data: dict[str, Any]) -> SindyModel:
    words, step = data["signature"], data.get("step")
    delay, memory, noise = (data.get(key, 0.0) for key in ("delay", "memory", "process_noise"))
    if any(isinstance(each, bool) for each in (step, delay, memory, noise)):
        raise TypeError(
            f"its delay is {delay}, its memory {memory}, its process noise {noise} and its step {step}; allowed are "
            "numbers"
        )
    if not all(isinstance(given, list) for given in words.values()) or len(words["state_names"]) > LARGEST_SYSTEM:
        raise TypeError(f"its signature is no lists of names, units and ranges of up to {LARGEST_SYSTEM} states")
    if not all(0 <= each <= LONGEST for each in (delay, memory, noise)) or (
        step is not None and not 0 < step <= LONGEST
    ):
        raise TypeError(
            f"its delay is {delay} s, its memory {memory} s, its process noise {noise} and its step {step} s; allowed "
            f"are numbers up to {LONGEST:g}"
        )
    signature, given = Signature(**words), data.get("constraints", {})
    library = Library(signature, map(Feature.from_list, data["library"].values()), step=step)
    allowed, fixed = ({state: each[key] for state, each in given.items()} for key in ("free", "given"))
    model = SindyModel(signature, library, allowed=allowed, fixed=fixed)
    place, found = {name: k for k, name in enumerate(library.names)}, torch.zeros_like(model.coefficients)
    for i, state in enumerate(signature.state_names):
        for name, value in data["coefficients"][state].items():
            found[place[name] if name in place else library.index(name), i] = value
    model.set_coefficients(found)
    model.delay, model.memory, model.process_noise = float(delay), float(memory), float(noise)
    model.stride = data.get("stride", 1)
    if type(model.stride) is not int or not 1 <= model.stride <= LONGEST:
        raise TypeError(f"its stride is {model.stride}; allowed are whole numbers from 1 to {LONGEST:g}")
    model.covariance = _covariance(library, data.get("uncertainty"))
    model.refinement = Refinement(**data["refinement"]) if data.get("refinement") else None
    numbers = [found, model.constraints.offset, *([model.covariance.factor] if model.covariance else [])]
    if not all(bool(each.isfinite().all()) for each in numbers):
        raise TypeError("some of its numbers are not finite")
    model.linear_inputs = tuple(data.get("linear_inputs", ()))
    if not set(model.linear_inputs) <= set(signature.input_names):
        raise TypeError(f"linear_inputs are {str(model.linear_inputs)[:80]}, of which some are no inputs")
    return model
