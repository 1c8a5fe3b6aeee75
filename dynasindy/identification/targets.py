"""Targets to begin with, where nobody has said yet what is to be held."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from dynasindy.findings import LogError
from dynasindy.identification.source import Source
from dynasindy.identification.verdict import controlled_states
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import turn_of

INNER = 0.1
"""Part of the samples beyond either end of the targets: the plant was at all of them, for some time."""
DIGITS = 2
"""Digits of the extent of the targets that are kept."""
DEGREE = math.pi / 180
"""A degree [rad]."""
FAR, NEAR = 5.0, 3.0
"""Targets this many times as far as the log went are in another unit, if in degrees they are not beyond the latter."""


def targets_like(
    source: Source,
    rates: Collection[str],
    given: Mapping[str, Sequence[str] | Sequence[float] | None],
    model: SindyModel | None = None,
) -> dict[str, list[str]]:
    """Return the words for what is to be held and within which ends, as far as nobody gave them.

    Outputs are measured states that are no rates and that inputs move, at most as many as there are inputs. Their
    targets are where most samples of the log lie, of an angle one turn at most.

    Args:
        source: The data.
        rates: States that are rates of others.
        given: Outputs, low and high, each None where nobody gave it.
        model: The equations; if omitted, nothing is known of what inputs move.
    """
    signature, seen = source.signature, ~source.training.x.isnan().all(0)
    wanted = [name for name, seen_ in zip(signature.state_names, seen.tolist(), strict=True) if seen_]
    moved = {*wanted} if model is None else controlled_states(model)
    first = [name for name in wanted if name not in rates and name in moved] or wanted[:1]
    outputs = [str(name) for name in given.get("outputs") or first[: signature.n_u]]
    if not set(outputs) <= set(wanted):
        return {}
    ends = [_usual(source, name) for name in outputs]
    found = {"outputs": outputs}
    for side, key in enumerate(("low", "high")):
        found[key] = [_short(both[side], both[1] - both[0]) for both in ends]
    return {key: words for key, words in found.items() if given.get(key) is None}


def _usual(source: Source, name: str) -> tuple[float, float]:
    """Return the ends between which most samples of a state lie, around zero and a turn apart at most of an angle."""
    place = source.signature.state_index(name)
    column = source.training.x[:, place].double()
    low, high = float(column.nanquantile(INNER)), float(column.nanquantile(1 - INNER))
    half = 0.5 * turn_of(source.signature.state_units[place])
    if high - low <= 2 * half:
        return low, high
    middle = min(max(0.0, low + half), high - half)
    return middle - half, middle + half


def require_radians(source: Source, targets: Mapping[str, Sequence[float]]) -> None:
    """Refuse targets in degrees of an angle that is in radians.

    They are such where they lie beyond half a turn and many times as far as the log went, and as degrees within what
    it saw, or nearly so. Within half a turn radians may well be meant, of a log that hardly moved the angle.

    Args:
        source: The log.
        targets: Lower and upper end of the targets of each output.

    Raises:
        LogError: Targets of an output are in degrees.
    """
    signature = source.signature
    for name, ends in targets.items():
        if name not in signature.state_names or signature.state_units[signature.state_index(name)] != "rad":
            continue
        seen = source.training.x[:, signature.state_index(name)]
        reach, asked = float(seen.abs().nan_to_num(nan=0.0).max()), max(map(abs, ends))
        if 0 < FAR * reach < asked and asked > math.pi and asked * DEGREE < NEAR * reach:
            facts = {"state": name, "low": ends[0], "high": ends[1], "reach": reach}
            raise LogError("log.target_degrees", **facts, radians=[f"{end * DEGREE:.4g}" for end in ends])


def _short(value: float, extent: float) -> str:
    """Return a number with as many digits as the extent of its targets asks for."""
    if not extent > 0:
        return f"{value:.{DIGITS}g}"
    places = DIGITS - 1 - math.floor(math.log10(extent))
    return f"{round(value, places):.{max(places, 0)}f}"
