"""Names, words and numbers of files as parts of other languages: none of them can become code, or end a comment.

Names of states and units come from files that anybody wrote. An identifier is made of letters and digits alone, a
comment holds neither end nor beginning of a comment, and a number is a number before it is written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import numpy as np

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
PLAIN = str.maketrans({"°": "deg", "²": "^2", "³": "^3", "·": "*", "µ": "u"})


def module_name(name: str) -> str:
    """Return a name that all names of a C file begin with.

    Raises:
        ValueError: It cannot begin one.
    """
    if not IDENTIFIER.fullmatch(name):
        raise ValueError(
            f"name is {name[:40]!r}; allowed are a letter, then letters, digits and '_', 31 at most: choose another"
        )
    return name


def identifiers(names: Iterable[str]) -> list[str]:
    """Return one identifier per name, none twice; they are to follow a prefix, and may be a word of the language."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name.translate(PLAIN), flags=re.ASCII)
        unique, count = plain, 1
        while unique in found:
            count += 1
            unique = f"{plain}_{count}"
        found.append(unique)
    return found


def comment(words: str) -> str:
    """Return words as they may stand within a comment of C or Python: ASCII, on one line, no end of a comment."""
    plain = words.translate(PLAIN).encode("ascii", "replace").decode()
    plain = re.sub(r"[\x00-\x1f\x7f\\?]", "_", plain)
    return re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)", " ", plain)


def number(value: float) -> str:
    """Return a number of double precision as C and Python write it, in brackets if it is negative.

    Raises:
        ValueError: It is not finite, or no number.
    """
    written = repr(float(value))
    if not math.isfinite(float(value)):
        raise ValueError(f"{written} stands where a finite number belongs; restore the file, or make it again")
    return f"({written})" if written.startswith("-") else written


def reach(value: float) -> str:
    """Return the end of a range for C, which may be infinite."""
    if not math.isinf(float(value)):
        return number(value)
    return "INFINITY" if value > 0 else "-INFINITY"


def single(value: float) -> str:
    """Return a number of single precision for C, exact to its last bit."""
    written = np.format_float_scientific(np.float32(value), unique=True, trim="0")
    return f"{written}f"


def rows(written: Iterable[str], indent: str = "    ", width: int = 100) -> str:
    """Return the elements of an array in lines of a readable length."""
    lines, line = [], ""
    for word in written:
        if line and len(line) + len(word) > width:
            lines.append(line.rstrip())
            line = ""
        line += f"{word}, "
    return "\n".join(indent + text for text in [*lines, line.rstrip().rstrip(",")])
