"""Words of the commands in messages, said as arguments of the functions in Python."""

from __future__ import annotations

import re

SETTINGS = re.compile(
    r"\b(?:data\.(?=(?:path|states|inputs|time|dt)\b)|plant\.(?=(?:library|libraries|known|outputs|low|high)\b)"
    r"|task\.(?=(?:outputs|rates|start|bounds|rests)\b)"
    r"|planning\.(?!csv|json)|world_model\.(?:refinement\.)?|refinement\.)(?=\w)"
)
"""How messages name settings of the scripts, whose last word is the name of an argument here."""
MAPS = re.compile(r"'(data\.states|data\.inputs|plant\.known)=(\{[^']*\})'")
"""Settings that are maps, in the quotation marks of a shell."""
TAKEN_BY = {"data.states": "read(states=", "data.inputs": "read(inputs=", "plant.known": "identify(known="}
NUMBER = re.compile(r"[-+]?[\d.]+(?:e[-+]?\d+)?")
OTHERWISE = re.compile(r"write it into plant\.functions, [^;]*; in Python, ")
"""A way that only commands have, before the one of Python."""
KIND = re.compile(r"^(?:hint|note|warning): ")
"""What a line of a command begins with, where Python has a word of its own."""


def as_arguments(told: str) -> str:
    """Return a message in which settings of the commands are arguments in Python, maps being dictionaries."""
    return SETTINGS.sub("", MAPS.sub(_call, OTHERWISE.sub("", told)))


def as_warning(told: str) -> str:
    """Return a line of a command as a warning in Python."""
    return KIND.sub("", as_arguments(told))


def _call(found: re.Match[str]) -> str:
    return f"{TAKEN_BY[found[1]]}{re.sub(r'[^{}:,]+', _literal, found[2])})"


def _literal(found: re.Match[str]) -> str:
    """Return a word between the signs of a map as Python writes it, with the blanks before it."""
    word = found[0].strip()
    blanks = found[0][: len(found[0]) - len(found[0].lstrip())]
    return found[0] if not word or NUMBER.fullmatch(word) else blanks + repr(word.strip('"'))
