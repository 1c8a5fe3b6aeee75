"""The name that was probably meant, where one is given that does not exist."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: object, names: Iterable[str]) -> str:
    """Return `; did you mean 'angle'?` of the nearest name, whatever its capitals; nothing where none is near.

    Args:
        name: What was given, which need not be text: a key of a mapping may be a number.
        names: Those that exist.
    """
    plain = {each.lower(): each for each in names}
    found = get_close_matches(str(name).lower(), plain, 1)
    return f"; did you mean '{plain[found[0]]}'?" if found else ""
