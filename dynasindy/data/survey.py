"""A first look at the columns of a file: which hold numbers, which never change, and which hold words or dates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from dynasindy.data.dates import seconds_of_date
from dynasindy.data.table import number, rows_of, split_unit

COUNTED = 5
"""Rows from which on a column that grows by one in each is a counter; fewer may do so by chance."""


@dataclass(frozen=True)
class Survey:
    """Hold the headings of a file by what stands below them.

    Attributes:
        headings: All headings.
        numeric: Those of columns that hold a number somewhere.
        still: Those of numeric columns that hold one number from beginning to end, with this number.
        worded: Those of columns that hold text and no number, with the first text.
        dated: Those of `worded` whose first text is a date.
        counting: Those of numeric columns that grow by exactly one in each row.
    """

    headings: tuple[str, ...]
    numeric: tuple[str, ...]
    still: dict[str, float]
    worded: dict[str, str]
    dated: tuple[str, ...]
    counting: tuple[str, ...]


def survey(path: Path) -> Survey:
    """Look at the columns of a file, no further down than is needed to know them.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no table of text, a heading is missing, or two agree but for their unit.
    """
    (_, headings), rows = rows_of(path)
    names = [split_unit(heading)[0] for heading in headings]
    if double := sorted({name for name in names if name and names.count(name) > 1}):
        raise ValueError(
            f"{path} has {', '.join(map(repr, double))} more than once in its headings; rename all but one"
        )
    first: dict[int, float] = {}
    began: dict[int, int] = {}
    texts: dict[int, str] = {}
    still, counting = set(range(len(headings))), set(range(len(headings)))
    passed = dict.fromkeys(counting, 0)
    for place, (_, row) in enumerate(rows):
        for k in [k for k in still | counting if k < len(row)]:
            value = number(row[k])
            if not math.isnan(value):
                passed[k] = place - began.setdefault(k, place)
                if value != first.setdefault(k, value):
                    still.discard(k)
                if value != first[k] + passed[k]:
                    counting.discard(k)
            elif row[k].strip().lower() not in ("", "nan"):
                texts.setdefault(k, row[k].strip()[:40])
        if not still | counting:
            break
    if nameless := [k + 1 for k in sorted(first) if k and not headings[k]]:  # the first may be an index
        raise ValueError(f"{path} has numbers in column {nameless[0]} and no heading above them; give it one")
    worded = {headings[k]: text for k, text in sorted(texts.items()) if k not in first and headings[k]}
    return Survey(
        tuple(headings),
        tuple(headings[k] for k in sorted(first) if headings[k]),
        {headings[k]: first[k] for k in sorted(still & first.keys()) if headings[k]},
        worded,
        tuple(heading for heading, text in worded.items() if not math.isnan(seconds_of_date(text))),
        tuple(headings[k] for k in sorted(counting & first.keys()) if headings[k] and passed[k] + 1 >= COUNTED),
    )
