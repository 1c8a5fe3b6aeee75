"""The model for other tools: Python source for CasADi, and LaTeX.

SymPy expressions are in `dynasindy.sindy.pysindy_interchange.to_sympy`.
"""

from __future__ import annotations

import re

from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import comment, right_sides
from dynasindy.sindy.pysindy_interchange import to_sympy
from dynasindy.systems.machine import Program


def casadi_source(model: SindyModel) -> str:
    """Write a model as a Python file that needs CasADi alone: `field(x, u)`, and `function()` of CasADi."""
    signature = model.signature
    kind, word = ("dx/dt = f(x, u)", "dx") if model.step is None else ("x[k+1] = F(x[k], u[k])", "next")
    step = "" if model.step is None else f"STEP = {model.step!r}  # seconds from x[k] to x[k+1]\n"
    equations = "\n".join(comment(line) for line in model.equations())
    return (
        f'"""The identified model, {kind}, for CasADi.\n\n{equations}\n"""\n\n'
        "import casadi\nfrom casadi import cos, exp, fabs, sign, sin, sqrt, tanh\nfrom casadi import fmax as larger\n\n"
        f"STATES = {signature.state_names!a}\nSTATE_UNITS = {signature.state_units!a}\n"
        f"INPUTS = {signature.input_names!a}\n"
        f"DELAY = {model.delay!r}  # seconds from an input to its effect\n{step}\n\n"
        "def square(a):\n    return a * a\n\n\n"
        f"{_python(right_sides(model), word)}\n\n"
        f'def function():\n    """Return {word} as a casadi.Function of x and u."""\n'
        f'    x, u = casadi.SX.sym("x", {signature.n_x}), casadi.SX.sym("u", {signature.n_u})\n'
        f'    return casadi.Function("model", [x, u], [casadi.vertcat(*field(x, u))], ["x", "u"], ["{word}"])\n'
    )


WORD = re.compile(r"(?<![\\A-Za-z])[A-Za-z][A-Za-z0-9 ]*[A-Za-z0-9]")
"""A word in LaTeX that is no command."""


def latex_source(model: SindyModel) -> str:
    """Write the equations of a model as LaTeX, for a document with amsmath, numbers of five digits."""
    from sympy import Float, Integer, Symbol, latex, multiline_latex

    def upright(word: re.Match[str]) -> str:  # in italics the letters of a word would stand for a product
        return rf"\operatorname{{{word[0]}}}".replace(" ", r"\ ")

    lines = [f"% Inputs act {model.delay!r} s after they are given."] if model.delay else []
    for state, right in to_sympy(model).items():
        names = {each: WORD.sub(upright, latex(each)) for each in (Symbol(state), *right.free_symbols)}
        shown = {each: Symbol(name) for each, name in names.items()}
        right = right.evalf(5)
        shown |= {each: Integer(each) for each in right.atoms(Float) if float(each).is_integer() and abs(each) < 1e5}
        name = names[Symbol(state)]
        left = Symbol(rf"\dot{{{name}}}" if model.step is None else f"{{{name}}}[k+1]")
        lines.append(multiline_latex(left, right.xreplace(shown), 3, "align*"))
    return "\n".join(lines) + "\n"


def _python(found: Program, word: str = "dx") -> str:
    what = "dx/dt of the states" if word == "dx" else "the states one step later"
    body = "".join(f"    {name} = {formula}\n" for name, formula in found.lines)
    head = f'def field(x, u):\n    """Return {what} as a list."""\n'
    return f"{head}{body}    return [{', '.join(found.results)}]\n"
