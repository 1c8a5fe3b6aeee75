"""Targets to begin with, where nobody has said yet what is to be held."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import combinations, islice, product

import torch
from torch.quasirandom import SobolEngine

from dynasindy.identification.source import Source
from dynasindy.identification.verdict import logged_input_ranges
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import turn_of
from dynasindy.systems.equilibria import PERIOD, find_equilibria

ACCELERATION = re.compile(r"accel(?!erator)|/s(\^?2|²)", re.IGNORECASE)
"""Name or unit of what cannot be held but at rest."""
INNER = 0.1
"""Part of the samples beyond either end of the targets: the plant was at all of them, for some time."""
DIGITS = 2
"""Digits of the extent of the targets that are kept."""
CHOICES = 8
"""Sets of outputs that are tried, to find one that can be held."""
POINTS = 32
"""Targets within a range for which an input is sought that holds them, and corners of it, at most."""
DRAWN_IN = 12
"""Times that a range of targets is drawn in, until all of it is held."""
ENOUGH = 0.9
"""Part of a range that is left where it is drawn in though targets at its ends are held."""
LEAST = 0.1
"""Part of where the log was below which targets that are held are the one place where the plant rests by itself."""


def targets_like(
    source: Source,
    rates: Collection[str],
    given: Mapping[str, Sequence[str] | Sequence[float] | None],
    model: SindyModel | None = None,
    period: float = PERIOD,
) -> dict[str, list[str]]:
    """Return the words for what is to be held and within which ends, as far as nobody gave them.

    Outputs are measured states that are no rates and no accelerations, at most as many as there are inputs. Their
    targets are where most samples of the log lie, of an angle one turn at most, and only where an input of the model
    holds them; where the first such outputs have no targets that can be held, others are tried, and fewer.

    Args:
        source: The data.
        rates: States that are rates of others.
        given: Outputs, low and high, each None where nobody gave it.
        model: The equations; if omitted, nothing is known of what can be held.
        period: Control period [s], which tells how slow a plant is that does not rest.
    """
    signature, seen = source.signature, ~source.training.x.isnan().all(0)
    wanted = [name for name, seen_ in zip(signature.state_names, seen.tolist(), strict=True) if seen_]
    plain = [name for name in wanted if name not in rates]
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    first = [name for name in plain if not ACCELERATION.search(f"{name} {units[name]}")] or plain or wanted[:1]
    named = [str(name) for name in given.get("outputs") or ()]
    if not set(named) <= set(wanted):
        return {}
    counts = range(min(signature.n_u, len(first)), 0, -1)
    choices = [named] if named else [list(some) for n in counts for some in combinations(first, n)][:CHOICES]
    ends = {name: _usual(source, name) for names in choices for name in names}
    outputs = choices[0]
    low, high = ([ends[name][side] for name in outputs] for side in (0, 1))
    if model is not None and (given.get("low") is None or given.get("high") is None):
        for some in choices:
            box = _held_within(model, source, {name: ends[name] for name in some}, period)
            if box is not None:
                outputs, (low, high) = some, box
                break
    found = {"outputs": outputs}
    for key, values in (("low", low), ("high", high)):
        found[key] = [_short(value, b - a) for value, a, b in zip(values, low, high, strict=True)]
    return {key: words for key, words in found.items() if given.get(key) is None}


def _usual(source: Source, name: str) -> tuple[float, float]:
    """Return the ends between which most samples of a state lie, of an angle a turn apart at most.

    Of more turns it is the one around zero, where an encoder begins, or where the log began if it never was at zero.
    """
    place = source.signature.state_index(name)
    column = source.training.x[:, place].double()
    low, high = float(column.nanquantile(INNER)), float(column.nanquantile(1 - INNER))
    turn = turn_of(source.signature.state_units[place])
    if high - low <= turn:
        return low, high
    column = column[~column.isnan()]
    least, most = column.quantile(torch.tensor([0.01, 0.99], dtype=column.dtype)).tolist()  # but for lost samples
    zero = 0.0 if least <= 0 <= most else turn * round(float(column[0]) / turn)
    middle = min(max(zero, float(column.min()) + turn / 2), float(column.max()) - turn / 2)
    return middle - turn / 2, middle + turn / 2


def _held_within(
    model: SindyModel, source: Source, ends: Mapping[str, tuple[float, float]], period: float
) -> tuple[list[float], list[float]] | None:
    """Return ends within which inputs that the log knows hold all targets, drawn in until they do; None of none."""
    signature, data = model.signature, source.training
    places = [signature.state_index(name) for name in ends]
    own = torch.tensor(signature.input_limits or ((-1.0, 1.0),) * signature.n_u, dtype=torch.float64)
    known = logged_input_ranges(model, data.u)  # of inputs that the equations are linear in all is known
    tried = [known.get(name, (-1.0, 1.0)) for name in signature.input_names]
    limits = torch.tensor(tried, dtype=torch.float64).maximum(own[:, :1]).minimum(own[:, 1:]).mT
    start = data.x.double().nanmedian(0).values.nan_to_num(0.0)
    low, high = (torch.tensor(side, dtype=torch.float64) for side in zip(*ends.values(), strict=True))
    usual = high - low
    corners = torch.tensor(list(islice(product((0.0, 1.0), repeat=len(places)), POINTS)))
    points = torch.cat([SobolEngine(len(places), scramble=True, seed=0).draw(POINTS), corners]).double()
    for _ in range(DRAWN_IN):
        rests = find_equilibria(model, places, low + (high - low) * points, start, period, limits)
        if not len(rests) or bool((high - low < LEAST * usual).any()):
            return None
        if not len(rests.unheld):
            return low.tolist(), high.tolist()
        least, most = rests.targets.amin(0), rests.targets.amax(0)
        drawn_in = bool(((most - least) < ENOUGH * (high - low)).any())
        room = torch.zeros_like(low) if drawn_in else (1 - ENOUGH) * (most - least) / 2
        low, high = least + room, most - room
    return None


def _short(value: float, extent: float) -> str:
    if not extent > 0:
        return f"{value:.{DIGITS}g}"
    places = DIGITS - 1 - math.floor(math.log10(extent))
    return f"{round(value, places):.{max(places, 0)}f}"
