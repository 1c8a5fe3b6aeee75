"""The model as C: dx/dt = f(x, u), alone in files of its own, and as a part of the controller."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from dynasindy.export.c_text import comment, identifiers, module_name, number
from dynasindy.export.expressions import Formulas, right_sides
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.base import WHOLE

_HELPERS = {
    "sign": "/* -1, 0 or 1. */\nstatic double sign(double a)\n{\n    return (double)((a > 0.0) - (a < 0.0));\n}\n",
    "square": "static double square(double a)\n{\n    return a * a;\n}\n",
    "larger": "/* The larger one; what is no number stays none. */\nstatic double larger(double a, double b)\n{\n"
    "    return a < b ? b : a;\n}\n",
}


@dataclass(frozen=True)
class Sources:
    """A header and a source file of C99.

    Attributes:
        name: What all their names begin with, and the files too.
        header: Text of `NAME.h`.
        source: Text of `NAME.c`.
    """

    name: str
    header: str
    source: str

    def files(self) -> dict[str, str]:
        """Return the texts by the names of their files."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.source}


def model_sources(model: SindyModel, name: str = "model") -> Sources:
    """Write a model as a C function `NAME_dx(x, u, dx)`; a difference equation as `NAME_next(x, u, next)`.

    Args:
        model: The model.
        name: What the names in C, and those of the files, begin with.

    Raises:
        ValueError: The name is none, or the model has a function without a formula.
    """
    name, signature, found = module_name(name), model.signature, right_sides(model)
    kind, result = ("dx/dt = f(x, u)", "dx") if model.step is None else ("x[k+1] = F(x[k], u[k])", "next")
    each = "" if model.step is None else f"A step takes {model.step!r} s, in which the inputs are held."
    late = f"Inputs act {model.delay!r} s after they are given: u is what acts." if model.delay else ""
    told = block([*signature_words(signature), *filter(None, [each, late])])
    n_x, n_u = signature.n_x, max(1, signature.n_u)
    arguments = f"const double x[{n_x}], const double u[{n_u}], double {result}[{n_x}]"
    header = (
        f"/* The identified model, {kind}.\n *\n{told}\n */\n#ifndef {name.upper()}_H\n"
        f'#define {name.upper()}_H\n\n#ifdef __cplusplus\nextern "C" {{\n#endif\n\n'
        f"/* Places in the arrays, by name. */\nenum {{\n{places(signature, name)}\n}};\n\n"
        f"void {name}_{result}({arguments});\n\n#ifdef __cplusplus\n}}\n#endif\n\n#endif\n"
    )
    source = f'#include "{name}.h"\n\n#include <math.h>\n\n{_helpers(found)}{_equations(model)}'
    return Sources(name, header, source + _function(found, f"void {name}_{result}({arguments})", result))


def field(model: SindyModel, found: Formulas) -> str:
    """Return the text of the static function `field(x, u, dx)`, what it calls, and its equations as a comment."""
    head = "static void field(const double *x, const double *u, double *dx)"
    return f"{_helpers(found)}{_equations(model)}{_function(found, head)}"


def _helpers(found: Formulas) -> str:
    """Return the functions that formulas call and <math.h> does not have."""
    return "".join(f"{text}\n" for name, text in _HELPERS.items() if name in found.calls)


def places(signature: Signature, name: str) -> str:
    """Return enumerators of the places of states and inputs in their arrays."""
    lines = [
        f"    {name}_{kind}_{word} = {place},"
        for kind, names in (("x", signature.state_names), ("u", signature.input_names))
        for place, word in enumerate(identifiers(names))
    ]
    return "\n".join(lines).rstrip(",")


def signature_words(signature: Signature, limits: Sequence[Sequence[float]] = ()) -> list[str]:
    """Return lines that tell states and inputs with their units.

    Args:
        signature: Of the plant.
        limits: Least and largest value of each input that is commanded; by default what the plant takes.
    """
    ends = limits or signature.input_limits or (WHOLE,) * signature.n_u
    states = zip(signature.state_names, signature.state_units, signature.x_scale, strict=True)
    return [
        "x: states",
        *(f"    {i}  {n} [{unit}], of a range of {number(scale)}" for i, (n, unit, scale) in enumerate(states)),
        "u: inputs of the plant",
        *(
            f"    {i}  {n} [-], from {low:.6g} to {high:.6g}"
            for i, (n, (low, high)) in enumerate(zip(signature.input_names, ends, strict=True))
        ),
        *signature.own_inputs(ranged=False),
    ]


def block(lines: Sequence[str]) -> str:
    """Return lines of any words as lines within a comment of C."""
    wrapped = [
        part
        for line in lines
        for part in textwrap.wrap(comment(line), 110, subsequent_indent="      ", break_on_hyphens=False) or [""]
    ]
    return "\n".join(f" * {line}".rstrip() for line in wrapped)


def _equations(model: SindyModel) -> str:
    return "/* The identified equations, rounded:\n *\n" + block(model.equations()) + "\n */\n"


def _function(found: Formulas, head: str, result: str = "dx") -> str:
    spare = [f"    (void){variable};\n" for variable in ("x", "u") if not found.reads(variable)]
    body = [f"    const double {name} = {formula};\n" for name, formula in found.lines]
    results = [f"    {result}[{i}] = {formula};\n" for i, formula in enumerate(found.results)]
    return f"{head}\n{{\n{''.join([*body, *spare, *results])}}}\n"
