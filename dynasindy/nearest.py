"""The name that was probably meant, where one is given that does not exist."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return `; did you mean 'angle'?` of the nearest name, whatever its capitals; nothing where none is near."""
    plain = {each.lower(): each for each in names}
    found = get_close_matches(name.lower(), plain, 1)
    return f"; did you mean '{plain[found[0]]}'?" if found else ""
