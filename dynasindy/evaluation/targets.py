"""Targets to begin with, where nobody has said yet what is to be held."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from dynasindy.evaluation.source import Source
from dynasindy.systems.base import Signature

INNER = 0.1
"""Part of the samples beyond either end of the targets: the plant was at all of them, for some time."""
DIGITS = 2
"""Digits of the extent of the targets that are kept."""
DEGREE = math.pi / 180
"""A degree [rad]."""
FAR, NEAR = 5.0, 3.0
"""Targets this many times as far as the log went are in another unit, if in degrees they are not beyond the latter."""


def targets_like(
    source: Source, rates: Collection[str], given: Mapping[str, Sequence[str] | Sequence[float] | None]
) -> dict[str, list[str]]:
    """Return the words for what is to be held and within which ends, as far as nobody gave them.

    Outputs are measured states that are no rates, at most as many as there are inputs. Their targets are where most
    samples of the log lie.

    Args:
        source: The data.
        rates: States that are rates of others.
        given: Outputs, low and high, each None where nobody gave it.
    """
    signature, seen = source.signature, ~source.training.x.isnan().any(0)
    wanted = [name for name, seen_ in zip(signature.state_names, seen.tolist(), strict=True) if seen_]
    first = [name for name in wanted if name not in rates][: signature.n_u]
    outputs = [str(name) for name in given.get("outputs") or first or wanted[:1]]
    if not set(outputs) <= set(wanted):
        return {}
    columns = [source.training.x[:, signature.state_index(name)].double() for name in outputs]
    ends = [(float(column.quantile(INNER)), float(column.quantile(1 - INNER))) for column in columns]
    found = {
        "outputs": outputs,
        "low": [_short(low, high - low) for low, high in ends],
        "high": [_short(high, high - low) for low, high in ends],
    }
    return {key: found[key] for key in ("outputs", "low", "high") if given.get(key) is None}


def in_words(signature: Signature, targets: Mapping[str, Sequence[float]]) -> str:
    """Return in one line what is to be held, and in which units.

    Args:
        signature: Names and units of the states.
        targets: Lower and upper end of the targets of each output.
    """
    told = []
    for name, (low, high) in targets.items():
        unit = signature.state_units[signature.state_index(name)]
        degrees = f" ({low / DEGREE:.4g} to {high / DEGREE:.4g} deg)" if unit == "rad" else ""
        told.append(f"{name} from {low:g} to {high:g}{'' if unit == '-' else f' {unit}'}{degrees}")
    return f"targets: {'; '.join(told)}"


def require_radians(source: Source, targets: Mapping[str, Sequence[float]]) -> None:
    """Refuse targets in degrees of an angle that is in radians.

    They are such where they lie many times as far as the log went, and as degrees within what it saw, or nearly so.

    Args:
        source: The log.
        targets: Lower and upper end of the targets of each output.

    Raises:
        ValueError: Targets of an output are in degrees.
    """
    signature = source.signature
    for name, ends in targets.items():
        if name not in signature.state_names or signature.state_units[signature.state_index(name)] != "rad":
            continue
        seen = source.training.x[:, signature.state_index(name)]
        reach, asked = float(seen.abs().nan_to_num(nan=0.0).max()), max(map(abs, ends))
        if 0 < FAR * reach < asked and asked * DEGREE < NEAR * reach:
            radians = [f"{end * DEGREE:.4g}" for end in ends]
            raise ValueError(
                f"the targets of {name} go from {ends[0]:g} to {ends[1]:g} rad, the log to {reach:.3g} rad only; "
                f"{name} is in rad, and these look like degrees: give {radians[0]} and {radians[1]} in plant.low and "
                "plant.high, or keep degrees by unit: deg of its column in data.states"
            )


def _short(value: float, extent: float) -> str:
    """Return a number with as many digits as the extent of its targets asks for."""
    if not extent > 0:
        return f"{value:.{DIGITS}g}"
    places = DIGITS - 1 - math.floor(math.log10(extent))
    return f"{round(value, places):.{max(places, 0)}f}"
