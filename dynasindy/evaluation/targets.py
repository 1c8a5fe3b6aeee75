"""Targets to begin with, where nobody has said yet what is to be held."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from dynasindy.evaluation.source import Source

INNER = 0.1
"""Part of the samples beyond either end of the targets: the plant was at all of them, for some time."""
DIGITS = 2
"""Digits of the extent of the targets that are kept."""


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


def _short(value: float, extent: float) -> str:
    """Return a number with as many digits as the extent of its targets asks for."""
    if not extent > 0:
        return f"{value:.{DIGITS}g}"
    places = DIGITS - 1 - math.floor(math.log10(extent))
    return f"{round(value, places):.{max(places, 0)}f}"
