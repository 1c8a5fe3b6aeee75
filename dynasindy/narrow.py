"""A Markdown table on a terminal that is narrower than it: turned, so that no row breaks in its middle."""

import re
import textwrap
from collections.abc import Iterator, Sequence

RULE = re.compile(r"\|(?:\s*:?-+:?\s*\|)+\s*")


def is_table(lines: Sequence[str]) -> bool:
    """Return whether lines are a table in Markdown: names, a rule, and rows with as many cells as there are names."""
    if len(lines) < 3 or not RULE.fullmatch(lines[1]):
        return False
    return len({len(_cells(line)) for line in lines}) == 1


def narrowed(lines: Sequence[str], columns: int) -> list[str]:
    """Return a table in lines that fit.

    A table that fits stays as it is. Of another one, each column becomes a line, with the cells of as many rows side by
    side as fit; those of the other rows follow below.

    Args:
        lines: Those of the table in Markdown: names, a rule, rows; see `is_table`.
        columns: Columns of the terminal.
    """
    if max(map(len, lines)) <= columns:
        return [*lines]
    head, _, *rows = map(_cells, lines)
    label = max(map(len, head))
    widths = [max(map(len, row), default=0) for row in rows]
    found: list[str] = []
    for first, last in _groups(widths, columns - label):
        found += [""] if found else []
        for place, name in enumerate(head):
            cells = "".join(f"  {rows[k][place]:<{widths[k]}}" for k in range(first, last))
            found += _within(f"{name:<{label}}{cells}".rstrip(), columns)
    return found


def _cells(line: str) -> list[str]:
    """Return the cells of a row; Markdown has a backslash before a bar in a cell."""
    return [cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", line.strip())[1:-1]]


def _groups(widths: Sequence[int], room: int) -> Iterator[tuple[int, int]]:
    """Yield the first row of each group of rows that stand side by side, and the one after its last."""
    first, taken = 0, 0
    for place, width in enumerate(widths):
        if place > first and taken + 2 + width > room:
            yield first, place
            first, taken = place, 0
        taken += 2 + width
    yield first, len(widths)


def _within(line: str, columns: int) -> list[str]:
    if len(line) <= columns:
        return [line]
    return textwrap.wrap(line, columns, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
