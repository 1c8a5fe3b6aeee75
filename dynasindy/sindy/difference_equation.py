"""A recording as a difference equation is fitted to it: one row for each of its steps, with every state measured."""

from __future__ import annotations

from dynasindy.sindy.library import Library
from dynasindy.systems.steps import ALIKE, UNTOLD
from dynasindy.systems.transitions import Transitions


def step_rows(library: Library, data: Transitions) -> tuple[Library, Transitions]:
    """Return the library with the step of a recording, and its control periods in which all states were measured.

    Args:
        library: candidate functions of a difference equation, whose step may not be known yet.
        data: the recording, NaN where a state was not measured.

    Raises:
        ValueError: samples within control periods are not whole periods, the sampling time is not that of the step, or
            a state was never measured.
    """
    data, step = _by_period(data), library.step
    if step is not None and step != UNTOLD and abs(step - data.dt) > ALIKE * step:
        raise ValueError(
            f"the model is a difference equation with a step of {step:g} s, and the data are sampled every {data.dt:g} "
            "s; give data of the same sampling time, or fit the model anew"
        )
    if never := data.x.isnan().all(0).nonzero().flatten().tolist():
        names = ", ".join(library.signature.state_names[i] for i in never)
        raise ValueError(
            f"a difference equation needs all of its states measured, and {names} never was; leave it out of the "
            "states and of plant.known, or give world_model.time=continuous"
        )
    seen = (data.x.isfinite() & data.x_next.isfinite()).all(-1)
    rows = data if bool(seen.all()) else data.select(seen)
    return library.with_step(data.dt) if step == UNTOLD else library, rows


def _by_period(data: Transitions) -> Transitions:
    """Return a recording without the samples within its control periods, of which the equation says nothing.

    Raises:
        ValueError: They are not whole control periods.
    """
    n = data.substeps
    if n == 1:
        return data
    if len(data) % n or bool((data.segment.reshape(-1, n) != data.segment[::n].unsqueeze(-1)).any()):
        raise ValueError(
            f"a difference equation was given {len(data)} samples that are not whole control periods of {n}; give "
            "whole ones, or one sample per control period"
        )
    return Transitions(data.x[::n], data.u[::n], data.x_next[n - 1 :: n], n * data.dt, data.segment[::n])


def with_time(library: Library, time: str | None) -> Library:
    """Return the library as one of the kind of equation that is wanted.

    Args:
        library: candidate functions.
        time: `continuous` for a differential equation, `discrete` for a difference equation; None for what it is.

    Raises:
        ValueError: `time` is another word.
    """
    if time not in (None, "continuous", "discrete"):
        raise ValueError(f"world_model.time is {time!r}; allowed are continuous and discrete: choose one")
    if time is None or (time == "discrete") == (library.step is not None):
        return library
    return library.with_step(UNTOLD if time == "discrete" else None)
