"""An afternoon with a rig: excite it, identify it, plan while it rests, fly it, refine the model by what it flew."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynasindy import workbench
from dynasindy.control import Controller, save
from dynasindy.control.files import NAME
from dynasindy.evaluation.source import Source
from dynasindy.excitation import Excitation
from dynasindy.rig.base import Array, Rig, Wiring
from dynasindy.rig.flight import Flown, Guard, fly
from dynasindy.rig.shown import Shown
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models import SindyModel
from dynasindy.world_models.libraries import LibraryBuilder

Tell = Callable[[str], None]
WARM = 3
"""Calls of a controller before it flies."""


@dataclass(frozen=True)
class Knowledge:
    """What is known of a plant before it moves.

    Attributes:
        library: Candidate functions of its equations.
        known: Equations that are known, by state.
        targets: Lower and upper end of the targets of each output [unit of the output].
        longest_delay: Longest delay of the inputs that is looked for [s]; None for two control periods.
        planning: Settings of `GradientPlanning`.
    """

    library: str | Sequence[str] | LibraryBuilder
    known: Mapping[str, str]
    targets: Mapping[str, tuple[float, float]]
    longest_delay: float | None = None
    planning: Mapping[str, Any] = field(default_factory=dict)

    def require_of(self, signature: Signature) -> None:
        """Refuse, before anything moves, what no model or no task of a plant can be made of.

        Raises:
            ValueError: A function, an equation or an output is not one of this plant.
        """
        workbench.tracking(SindyModel(signature, self.library, known=self.known), self.targets)


def targets_within(knowledge: Knowledge, wanted: Sequence[Sequence[float]] | None) -> list[list[float]]:
    """Return targets within the target range of the plant, `(n_targets, n_r)`, before anything moves.

    Args:
        knowledge: Tells outputs and target range.
        wanted: One number per output each; None takes two, half of the way to the upper and to the lower ends.

    Raises:
        ValueError: One is not of this plant, or outside of the target range.
    """
    ends = list(knowledge.targets.values())
    if wanted is None:
        return [[0.5 * (a + b) + 0.25 * sign * (b - a) for a, b in ends] for sign in (1, -1)]
    for target in wanted:
        if len(target) != len(ends) or not all(a <= v <= b for v, (a, b) in zip(target, ends, strict=True)):
            raise ValueError(
                f"targets has {list(target)}; give one number for each of {', '.join(knowledge.targets)}, within "
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
        flights: What came of each flight.
        shown: What the flights of controllers show, by the name of their logs.
    """

    rig: Rig
    wiring: Wiring
    guard: Guard
    folder: Path
    tell: Tell = print
    flights: list[Flown] = field(default_factory=list)
    shown: dict[str, Shown] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether a flight was ended by a fault."""
        return any(flown.fault is not None for flown in self.flights)

    def excite(self, signal: Excitation) -> Flown:
        """Move the rig by a signal, open loop, and log it to `excitation.csv`."""
        levels = signal.samples(self.wiring.dt).double().numpy()

        def _act(y: Array, t: float) -> Array:
            level: Array = levels[round(t / self.wiring.dt)]
            return level

        return self._fly("excitation", _act, len(levels))

    def learn(self, knowledge: Knowledge, seed: int = 0) -> Controller:
        """Identify the rig from all logs so far and plan a controller, while it rests.

        Returns:
            The controller, which also stands in the folder, beside the model.

        Raises:
            ValueError: The logs do not allow a fit.
            Diverged: The model explodes.
        """
        log = self._logs()
        model = workbench.identify(log, knowledge.library, knowledge.known, longest_delay=knowledge.longest_delay)
        model.save(self.folder / "model.json")
        for line in model.equations():
            self.tell(f"  {line}")
        self.tell("planning while the rig rests")
        controller = workbench.plan(
            model, knowledge.targets, log, dt=self.wiring.dt, seed=seed, **dict(knowledge.planning)
        )
        save(controller, self.folder / NAME)
        return controller

    def fly(self, controller: Controller, targets: Sequence[Sequence[float]], seconds: float) -> Flown:
        """Hold one target after the other, so many seconds each, and log it to `flight_N.csv`.

        Raises:
            ValueError: The controller is one for another plant, period or sensors; nothing has moved.
        """
        self._require(controller)
        for line in controller.signature.own_inputs():
            self.tell(f"  {line}; the rig gets the controller's number, and has to turn it into its own unit")
        for _ in range(WARM):  # the first calls take longer than all others, the first correction among them
            controller.act(np.zeros(self.wiring.signature.n_x), targets[0])
        controller.reset()
        held = max(1, round(seconds / self.wiring.dt))

        rows = [target for target in targets for _ in range(held)]

        def _act(y: Array, t: float) -> Array:
            return controller.act(y, rows[min(round(t / self.wiring.dt), len(rows) - 1)])

        name = f"flight_{len(self.flights)}"
        flown = self._fly(name, _act, len(rows))
        fault = "" if flown.fault is None else f"{flown.fault.kind}: {flown.fault}"
        shown = Shown.of(self.folder / f"{name}.csv", self.wiring.signature, controller.outputs, rows, fault)
        self.shown[name] = shown
        self.tell(f"  {shown.words()}")
        return flown

    def _require(self, controller: Controller) -> None:
        """Make sure that a controller is one for this rig.

        Raises:
            ValueError: It is not.
        """
        wiring, names = self.wiring, self.wiring.signature.state_names
        sensors = controller.observer and controller.observer.sensors.channels
        wanted = set(sensors) if sensors else set(names)
        theirs = controller.signature
        if (theirs.state_names, theirs.input_names) != (names, wiring.signature.input_names):
            raise ValueError(
                f"the controller is one for states {', '.join(theirs.state_names)} and inputs "
                f"{', '.join(theirs.input_names)}, the rig has {', '.join(names)} and "
                f"{', '.join(wiring.signature.input_names)}; give another"
            )
        if abs(controller.dt - wiring.dt) > 1e-9 * wiring.dt:
            raise ValueError(f"the controller has a period of {controller.dt:g} s, the rig {wiring.dt:g} s; give dt=")
        if missing := sorted(wanted - set(wiring.measured)):
            raise ValueError(
                f"the controller reads {missing[0]}, which the rig does not measure; plan one for its sensors"
            )

    def _fly(self, name: str, act: Callable[[Array, float], Array], periods: int) -> Flown:
        self.tell(f"{name.replace('_', ' ')}: {periods * self.wiring.dt:g} s")
        flown = fly(self.rig, act, self.wiring, periods, self.folder / f"{name}.csv", self.guard)
        self.flights.append(flown)
        self.tell(f"  {flown}")
        return flown

    def _logs(self) -> Source:
        """Return all logs as one, each a segment; nothing is kept to judge on, as the rig itself is flown next."""
        signature = self.wiring.signature
        columns = {
            name: {"name": name if known else "", "unit": unit}
            for name, unit, known in zip(signature.state_names, signature.state_units, self.wiring.seen, strict=True)
        }
        inputs = {name: name for name in signature.input_names}
        paths = sorted([*self.folder.glob("excitation.csv"), *self.folder.glob("flight_*.csv")])
        logs = [workbench.read(path, columns, inputs, dt=self.wiring.dt, validation_share=0) for path in paths]
        data = Transitions.cat([log.training for log in logs])
        notes = tuple(f"{path.name}: {note}" for path, log in zip(paths, logs, strict=True) for note in log.notes)
        return replace(logs[0], training=data, signature=signature, notes=notes)
