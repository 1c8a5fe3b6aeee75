"""Words, numbers and equations of a model as parts of other languages.

Equations are written by the code that writes them for torch, `dynasindy.sindy.codegen`: what terms share is computed
once, operators are infix, and what is called are `FORMULA_FUNCTIONS` alone.

Names of states and units come from files that anybody wrote: none of them can become code, or end a comment. A
comment holds neither end nor beginning of one, and a number is a number before it is written.
"""

from __future__ import annotations

import math
import re

from dynasindy.sindy.codegen import Writer
from dynasindy.sindy.model import SindyModel
from dynasindy.systems.machine import Program

PLAIN = str.maketrans({"°": "deg", "²": "^2", "³": "^3", "·": "*", "µ": "u"})


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


def formulas(model: SindyModel) -> Program:
    """Return the rates of change of a model as formulas.

    Raises:
        ValueError: The model has too many terms.
    """
    return _FormulaWriter(model.library, model.coefficients).program()


def right_sides(model: SindyModel) -> Program:
    """Return the right sides of the equations as formulas: rates of change, or of a difference equation next states.

    Raises:
        ValueError: The model has too many terms.
    """
    return _FormulaWriter(*model.library.mapping(model.coefficients)).program()


class _FormulaWriter(Writer):
    """Write numbers where they are used."""

    def _constant(self, value: float) -> str:
        return number(value)

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        sign = "-" if c < 0 else "+"
        return f"{total} {sign} {number(abs(c))} * {value}" if abs(c) != 1 else f"{total} {sign} {value}"
