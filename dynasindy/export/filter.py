"""The numbers of an observer, as the C text of it needs them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from dynasindy.control.files import require_states
from dynasindy.export.names import number, reach
from dynasindy.sensing import Observer
from dynasindy.sensing.observer import NUDGE, UNKNOWN
from dynasindy.sindy import SindyModel
from dynasindy.systems import Stops
from dynasindy.systems.steps import Steps

NO_STEPS = Steps(0.0, 0, False)


@dataclass(frozen=True)
class Filter:
    """What the observer in C is made of.

    Attributes:
        model: The identified model.
        sensed: Places of the states that are measured.
        words: What stands in the gaps of the templates.
        flags: Which parts of the templates stay.
        sizes: States of the observer, measured states, past inputs, and Runge-Kutta steps of a period and ahead.
        n_stops: Stopped positions.
    """

    model: SindyModel
    sensed: tuple[int, ...]
    words: dict[str, object]
    flags: set[str]
    sizes: tuple[int, int, int, int, int]
    n_stops: int

    @classmethod
    def of(cls, observer: Observer) -> Filter:
        """Return the numbers of an observer.

        Raises:
            ValueError: Its model is of another kind, its delay too long, or its stops are at states that do not exist.
        """
        if not isinstance(observer.model, SindyModel):
            raise ValueError(
                f"the observer works on a {type(observer.model).__name__}, which is not written in C; fit a SindyModel"
            )
        whole, part = observer.late()
        late, dt = observer.sensors.delay + whole, observer.dt
        sensed = tuple(i for i, r in enumerate(observer.variance.tolist()) if r < torch.inf)
        rest, parts_of, ahead = (observer.steps(s) if s else NO_STEPS for s in (dt - part, part, dt))
        rest_steps, part_steps = rest.number, max(1, parts_of.number)
        stops, n_stops = stop_words(observer.stops, observer.n_x)
        n = len(observer.scale)
        scale, followers = observer.scale, observer.model.followers
        words: dict[str, object] = {
            "n": n,
            "memory": late + 2,
            "step": _joined(NUDGE * scale),
            "strays": _joined((observer.q * scale).square() * dt),
            "unknown": _joined((UNKNOWN * scale).square()),
            "sensed": ", ".join(map(str, sensed)),
            "variance": _joined(observer.variance[list(sensed)]),
            "followers": "\n".join(f"    s->x[{i}] = s->x[{state}];" for i, state in followers.items()),
            "pushed": ", ".join(map(str, observer.pushed)),
            "pushes_word": " and, behind them, of the pushes, which stay" if observer.pushed else "",
            "whole_scale": _joined(torch.cat([scale[: observer.n_x], torch.ones(observer.model.signature.n_u)])),
            "late_words": f"{late} periods" + (f" and {part!r} s" if part else ""),
            "late_index": ", k" if late else "",
            "part": number(part), "part_steps": part_steps,
            "rest": number(dt - part), "rest_steps": rest_steps,
            "substeps": ahead.number,
            **stops,
        }  # fmt: skip
        parts: dict[str, object] = {"observer": True, "pushed": observer.pushed, "stops": n_stops, "part": part}
        parts |= {"late": late, "difference": observer.model.step is not None}
        steps = (rest_steps + bool(part) * part_steps, bool(part) * part_steps + late * ahead.number)
        flags = {flag for flag, there in parts.items() if there} | ({"followers"} if followers else set())
        return cls(observer.model, sensed, words, flags, (n, len(sensed), late + 2, *steps), n_stops)


def stop_words(stops: Stops | None, n_x: int) -> tuple[dict[str, object], int]:
    """Return the words for stops and how many they are.

    Raises:
        ValueError: They are at states that do not exist.
    """
    if stops is None or not stops.positions:
        return {}, 0
    require_states(stops, n_x)
    return {
        "n_stops": len(stops.positions),
        "stop_position": ", ".join(map(str, stops.positions)),
        "stop_rate": ", ".join(map(str, stops.rates)),
        "stop_low": ", ".join(map(reach, stops.low)),
        "stop_high": ", ".join(map(reach, stops.high)),
    }, len(stops.positions)


def _joined(values: torch.Tensor) -> str:
    return ", ".join(number(value) for value in values.tolist())
