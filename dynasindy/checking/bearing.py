"""Findings on margins: at rest, and of large movements."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dynasindy.checking.check import Check
from dynasindy.checking.findings import Finding, Thresholds
from dynasindy.checking.flown import GAINS, LATEST, Flown
from dynasindy.checking.margins import Margins
from dynasindy.checking.words import least, most, place


def margins_kept(found: Check, limits: Thresholds) -> list[Finding]:
    """Return the least margins at rest, over inputs and targets."""
    dt, names = found.loop.dt, found.loop.signature.input_names
    rows = [(k, i, m) for k, target in enumerate(found.margins) for i, m in enumerate(target)]

    slow = "" if found.flown is None else ", in movements so small that dry friction damps them"

    def _worst(values: Sequence[float]) -> tuple[float, str]:
        row = int(np.argmin(values))
        k, i, _ = rows[row]
        return values[row], f"of {names[i]} at {place(found, k)}{slow}"

    def _all(read: object) -> list[float]:
        assert callable(read)
        return [float(read(m)) for _, _, m in rows]

    def _wider(margin: Margins) -> float:
        return 1 / margin.lower if margin.lower else math.inf

    up, where_up = _worst(_all(lambda m: m.gain))
    down, where_down = _worst(_all(_wider))
    phase, where_phase = _worst(_all(lambda m: m.phase))
    delay, where_delay = _worst([d / dt for d in _all(lambda m: m.delay)])
    disk, where_disk = _worst(_all(lambda m: m.disk))
    factor, reduced = least(up, limits.gain, 2), most(1 / down, 1 / limits.gain, 2)
    angle, periods, size = least(phase, limits.phase, 0), least(delay, limits.delay, 2), least(disk, limits.disk, 2)
    decibel = least(_db(up), _db(limits.gain), 1, of_limit=2)
    upwards = "without limit" if up == math.inf else f"{factor[0]} ({decibel[0]} dB)"
    downwards = "may fall to nothing" if down == math.inf else f"may fall to {reduced[0]}"
    return [
        Finding(
            "gain margin",
            up >= limits.gain,
            f"the least is {upwards} {where_up}; threshold: {factor[1]} ({decibel[1]} dB)",
        ),
        Finding("gain reduction", down >= limits.gain, f"{downwards} {where_down}; threshold: {reduced[1]}"),
        Finding(
            "phase margin",
            phase >= limits.phase,
            f"the least is {angle[0]} deg {where_phase}; threshold: {angle[1]} deg",
        ),
        Finding(
            "delay margin",
            delay >= limits.delay,
            f"the least is {periods[0]} control periods, {1000 * delay * dt:.0f} ms, {where_delay}; "
            f"threshold: {periods[1]} control period{'s' if limits.delay != 1 else ''}",
        ),
        Finding("disk margin", disk >= limits.disk, f"the least is {size[0]} {where_disk}; threshold: {size[1]}"),
    ]


def in_flight(found: Check, limits: Thresholds) -> list[Finding]:
    """Return the margins of large movements; none of a plant without dry friction."""
    name, margins, dt = "large movements", found.flown, found.loop.dt
    if margins is None:
        return []
    if not margins.gain:
        return [Finding(name, False, "flown from target to target, the plant does not come to rest")]
    stronger, later = (
        f"{'at least ' if value >= end else ''}{least(value, limit, 3, 'g')[0]}"
        for value, limit, end in ((margins.gain, limits.gain, float(GAINS[-1])), (margins.delay, limits.delay, LATEST))
    )
    words = (
        f"flown from target to target, the inputs may act {stronger} times as strongly, or {later} control periods, "
        f"{1000 * margins.delay * dt:.0f} ms, later{_counting(found, margins)}; thresholds: {limits.gain:g} and "
        f"{limits.delay:g}"
    )
    return [Finding(name, margins.gain >= limits.gain and margins.delay >= limits.delay, words)]


def _counting(found: Check, flown: Flown) -> str:
    """Say which margins count where those of flights disagree with those of small movements."""
    small = [margin for target in found.margins for margin in target]
    gain, delay = (  # as far as was tried is no end
        value if value < end else math.inf for value, end in ((flown.gain, float(GAINS[-1])), (flown.delay, LATEST))
    )
    pairs = {
        "gain": (gain, min(margin.gain for margin in small)),
        "delay": (delay, min(margin.delay for margin in small) / found.loop.dt),
    }
    less = [name for name, (large, little) in pairs.items() if large < little]
    if not less:
        return ". The margins above are less than these, and count"
    both = " and the ".join(f"{name} margin" for name in less)
    return f". This is less than the {both} above, so this line counts for {'both' if less[1:] else 'that'}"


def _db(value: float) -> float:
    return 20 * math.log10(value)
