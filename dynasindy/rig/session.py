"""An afternoon with a rig: excite it, identify it, plan while it rests, fly it, refine the model by what it flew."""

from __future__ import annotations

import csv
import inspect
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import torch
from pydantic import create_model

from dynasindy import workbench
from dynasindy.control import Controller, save
from dynasindy.control.controller import NAME
from dynasindy.envs import Excitation
from dynasindy.identification.identify import LoggedData, identify
from dynasindy.identification.source import Source
from dynasindy.planning import GradientPlanning
from dynasindy.rig.base import Array, Rig, RigClock, Wiring
from dynasindy.rig.flight import ROUNDING, FlightResult, Guard, run_flight
from dynasindy.rig.log import FlightRecord, Log
from dynasindy.sindy import SindyModel
from dynasindy.sindy.named_libraries import LibraryBuilder
from dynasindy.systems import Signature
from dynasindy.systems.base import WHOLE
from dynasindy.systems.transitions import Transitions
from dynasindy.text import did_you_mean

Tell = Callable[[str], None]
WARM = 3
"""Calls of a controller before it flies."""


@dataclass(frozen=True)
class Knowledge:
    """What is known of a plant before it moves.

    Attributes:
        library: Candidate functions of its equations.
        known: Equations that are known, by state; None where the logs have to tell which rates are missing.
        targets: Lower and upper end of the targets of each output [unit of the output].
        longest_delay: Longest delay of the inputs that is looked for [s]; None where the data are to tell.
        planning: Settings of `GradientPlanning`.
        ranged: Whether the ranges of the states are known; if not, they are those of the logs.

    Raises:
        ValueError: A setting of the planning does not exist, or is out of its range.
    """

    library: str | Sequence[str] | LibraryBuilder
    known: Mapping[str, str] | None
    targets: Mapping[str, tuple[float, float]]
    longest_delay: float | None = None
    planning: Mapping[str, Any] = field(default_factory=dict)
    ranged: bool = True

    def __post_init__(self) -> None:
        taken = inspect.signature(GradientPlanning).parameters.values()
        allowed = sorted({each.name for each in taken if each.kind is each.KEYWORD_ONLY} - {"others", "seed"})
        if wrong := [name for name in self.planning if name not in allowed]:
            near = did_you_mean(wrong[0], allowed)
            raise ValueError(f"'{wrong[0]}' is no setting of the planning; allowed are {', '.join(allowed)}{near}")
        hints = get_type_hints(GradientPlanning.__init__, include_extras=True)
        fields: dict[str, Any] = {name: (hints[name], ...) for name in self.planning}
        create_model("planner", **fields)(**self.planning)  # refuses what is out of range

    def require_of(self, signature: Signature) -> None:
        """Refuse, before anything moves, what no model or no task of a plant can be made of.

        Raises:
            ValueError: A function, an equation or an output is not one of this plant.
        """
        signature = signature.with_rates(self.known or {})
        workbench.tracking_task(SindyModel(signature, self.library, known=self.known), self.targets)

    def within(self, wanted: Sequence[Sequence[float]] | None) -> list[list[float]]:
        """Return targets within the target range of the plant, `(n_targets, n_r)`, before anything moves.

        Args:
            wanted: One number per output each; None takes two, half of the way to the upper and to the lower ends.

        Raises:
            ValueError: One is not of this plant, or outside of the target range.
        """
        ends = list(self.targets.values())
        if wanted is None:
            return [[0.5 * (a + b) + 0.25 * sign * (b - a) for a, b in ends] for sign in (1, -1)]
        for target in wanted:
            if len(target) != len(ends) or not all(a <= v <= b for v, (a, b) in zip(target, ends, strict=True)):
                raise ValueError(
                    f"targets has {list(target)}; give one number for each of {', '.join(self.targets)}, within "
                    f"plant.low={[a for a, _ in ends]} and plant.high={[b for _, b in ends]}"
                )
        return [[float(value) for value in target] for target in wanted]


@dataclass
class Session:
    """A rig, and what was learnt of it so far.

    Attributes:
        rig: The plant.
        wiring: What of it is measured, and how often.
        guard: What a flight goes on with.
        folder: Where logs, model and controller are written.
        tell: Says where it is, a line at a time.
        clock: Tells the time and waits.
        flights: What came of each flight, by the name of its log.
        shown: What the flights of controllers show, by the name of their logs.
    """

    rig: Rig
    wiring: Wiring
    guard: Guard
    folder: Path
    tell: Tell = print
    clock: RigClock = time
    flights: dict[str, FlightResult] = field(default_factory=dict)
    shown: dict[str, FlightRecord] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether a flight was ended by a fault."""
        return any(flown.fault is not None for flown in self.flights.values())

    def excite(self, signal: Excitation) -> FlightResult | None:
        """Move the rig by a signal that begins at `signal.first` of its strength, open loop, into `excitation.csv`.

        An excitation that an earlier session in the same folder has finished is not repeated. One that was cut short
        is: its log is kept, and the new one is `excitation_N.csv`.

        Returns:
            What came of the flight; None if there was none.

        Raises:
            ValueError: The folder holds logs of another rig, or an input would go beyond what its actuator reaches;
                nothing has moved.
        """
        steps = signal.samples(self.wiring.dt).double()
        growth = signal.growth(torch.arange(len(steps))).unsqueeze(-1)
        levels: Array = (signal.offset + growth * (steps - signal.offset)).numpy()
        before = self.logs("excitation")
        if done := [path for path, rows in before.items() if rows >= len(levels)]:
            self.tell(f"excitation: {done[0]} is there, so the rig is not excited again")
            return None
        signature = self.wiring.signature
        low, high = np.array(signature.input_limits or (WHOLE,) * signature.n_u).T
        least, most = levels.min(0), levels.max(0)
        beyond = np.maximum(most - high, low - least)
        if (beyond > ROUNDING).any():
            amplitude = np.minimum(signal.amplitude.abs().numpy(), 0.5 * (high - low))
            offset = np.clip(signal.offset.numpy(), low + amplitude, high - amplitude)
            k, words = int(beyond.argmax()), [f"[{','.join(f'{v:.4g}' for v in each)}]" for each in (amplitude, offset)]
            raise ValueError(
                f"the excitation takes {signature.input_names[k]} from {least[k]:.3g} to {most[k]:.3g}, and its "
                f"actuator reaches {low[k]:.3g} to {high[k]:.3g}; nothing has moved: give plant.amplitude={words[0]} "
                f"plant.offset={words[1]}, or others within these limits"
            )
        self._tell_inputs(self.wiring.signature)

        name = f"excitation_{len(before)}" if before else "excitation"
        return self._fly(name, lambda y, t: levels[round(t / self.wiring.dt)], len(levels))

    def logs(self, kind: str) -> dict[Path, int]:
        """Return the logs in the folder, in the order in which they were flown, each with its number of rows.

        Args:
            kind: `excitation` or `flight`.

        Raises:
            ValueError: One is that of another rig.
        """
        found = {}
        for path in sorted(self.folder.glob(f"{kind}*.csv"), key=lambda path: (len(path.stem), path.stem)):
            with path.open(newline="", encoding="utf-8") as file:
                first, *rows = list(csv.reader(file)) or [[]]
            if first != (wanted := self.wiring.headings):
                raise ValueError(f"{path} has columns {', '.join(first)}, not {', '.join(wanted)}; give another folder")
            found[path] = len(rows)
        return found

    def samples(self, path: Path) -> tuple[Array, Array, Array]:
        """Return the times `(T,)` [s], states `(T, n_x)` and inputs `(T, n_u)` of a log, NaN for what is missing."""
        return Log.read(path, self.wiring.signature)

    def learn(self, knowledge: Knowledge, seed: int = 0) -> Controller:
        """Identify the rig from all logs so far and plan a controller, while it rests.

        Returns:
            The controller, which also stands in the folder, beside the model.

        Raises:
            ValueError: The logs do not allow a fit.
            Diverged: The model explodes.
        """
        log = self._source(knowledge.ranged)
        with warnings.catch_warnings(action="ignore"):  # they are among the findings
            model = identify(log, knowledge.library, knowledge.known, longest_delay=knowledge.longest_delay)
        for each in model.findings:
            self.tell(f"  {each.line()}")
        model.save(self.folder / "model.json")
        for equation in model.equations():
            self.tell(f"  {equation}")
        self.tell("planning while the rig rests")
        controller = workbench.plan(
            model, knowledge.targets, log, dt=self.wiring.dt, seed=seed, **dict(knowledge.planning)
        )
        save(controller, self.folder / NAME)
        return controller

    def run_flight(self, controller: Controller, targets: Sequence[Sequence[float]], seconds: float) -> FlightResult:
        """Hold one target after the other, so many seconds each, and log it to `flight_N.csv`.

        Raises:
            ValueError: The controller is one for another plant, period or sensors; nothing has moved.
        """
        mine, theirs = self.wiring.signature, controller.signature
        units, seen = dict(zip(mine.state_names, mine.state_units, strict=True)), self.wiring.measured
        read = [(n, u) for n, u in zip(theirs.state_names, theirs.state_units, strict=True) if n in controller.measured]
        comparisons = [
            ("the inputs", ", ".join(mine.input_names), ", ".join(theirs.input_names)),
            ("the control period in s", f"{self.wiring.dt:.9g}", f"{controller.dt:.9g}"),
            *((f"the unit of {name}", units[name] if name in seen else "not measured", unit) for name, unit in read),
        ]
        if mine.input_ends and not mine.same_input_ranges(theirs):
            comparisons.append(
                ("the range of the inputs", str(mine.input_ranges.tolist()), str(theirs.input_ranges.tolist()))
            )
        for what, own, planned in comparisons:
            if own != planned:
                raise ValueError(f"{what}: {own} on the rig, {planned} for the controller; give one that is alike")
        self._tell_inputs(theirs)
        names = mine.state_names

        def _seen(y: Array) -> dict[str, float]:
            return {name: value for name, value in zip(names, y.tolist(), strict=True) if name in theirs.state_names}

        for _ in range(WARM):  # the first calls take longer than all others, the first correction among them
            controller.act(_seen(np.zeros(len(names))), targets[0])
        controller.reset()
        held = max(1, round(seconds / self.wiring.dt))

        rows = [target for target in targets for _ in range(held)]

        def _act(y: Array, t: float) -> Array:
            return controller.act(_seen(y), rows[min(round(t / self.wiring.dt), len(rows) - 1)])

        numbers = (path.stem.removeprefix("flight_") for path in self.logs("flight"))
        name = f"flight_{max([1, *(int(number) + 1 for number in numbers if number.isdigit())])}"
        flown, path = self._fly(name, _act, len(rows)), self.folder / f"{name}.csv"
        shown = FlightRecord.of(path, controller.signature, controller.outputs, rows, flown.ended)
        self.shown[name] = shown
        self.tell(f"  {shown.summary()}")
        return flown

    def _tell_inputs(self, signature: Signature) -> None:
        for each in signature.own_inputs():
            self.tell(f"  {each}; the rig gets the controller's number, and has to turn it into its own unit")

    def _fly(self, name: str, act: Callable[[Array, float], Array], periods: int) -> FlightResult:
        self.tell(f"{name.replace('_', ' ')}: {periods * self.wiring.dt:g} s")
        flown = run_flight(self.rig, act, self.wiring, periods, self.folder / f"{name}.csv", self.guard, self.clock)
        self.flights[name] = flown
        self.tell(f"  {flown}")
        return flown

    def _source(self, ranged: bool) -> Source:
        """Return all useful logs as one, each a segment; nothing is kept to judge on, as the rig itself flies next."""
        signature = self.wiring.signature
        columns = {
            name: {"name": name if known else "", "unit": unit}
            for name, unit, known in zip(signature.state_names, signature.state_units, self.wiring.seen, strict=True)
        }
        inputs: dict[str, Any] = {name: name for name in signature.input_names}
        logs, findings, useless = [], [], []
        for path in (*self.logs("excitation"), *self.logs("flight")):
            try:
                log = Source.of(LoggedData(str(path), columns, inputs, dt=self.wiring.dt).recording(signature), 0)
            except ValueError as error:
                useless.append(str(error))
                continue
            logs.append(log)
            findings += [replace(each, values={**each.values, "file": path.name}) for each in log.findings]
        if not logs:
            raise ValueError(f"nothing can be learnt from the logs in {self.folder}: {'; '.join(useless) or 'none'}")
        for why in useless:
            self.tell(f"  left out: {why}")
        if not ranged:
            widest = (max(scales) for scales in zip(*(log.signature.x_scale for log in logs), strict=True))
            signature = replace(logs[0].signature, x_scale=tuple(widest))
        data = Transitions.cat([log.training for log in logs])
        return replace(logs[0], training=data, signature=signature, findings=tuple(findings))
