"""Derivatives of straight-line formulas equal those that SymPy finds, and those that are zero are not written."""

import math

import pytest
import sympy

from dynasindy.systems.tangents import Tangents

KNOWN = {
    "square": lambda v: v * v,
    "fabs": abs,
    "sign": lambda v: (v > 0) - (v < 0),
    "larger": max,
    "exceeds": lambda a, b: float(a > b),
    **{name: getattr(math, name) for name in ("sin", "cos", "exp", "tanh", "sqrt")},
}
SYMBOLIC = {
    "square": lambda v: v**2,
    "fabs": sympy.Abs,
    "sign": sympy.sign,
    "larger": sympy.Max,
    **{name: getattr(sympy, name) for name in ("sin", "cos", "exp", "tanh", "sqrt")},
}
POINT = {"a": 0.7, "b": -1.3, "c": 2.1}


def evaluated(text, values):
    return eval(text, {}, {**KNOWN, **values})


@pytest.mark.parametrize(
    "formula",
    [
        "a + b",
        "a - b",
        "3.0 - a",
        "-a * b",
        "a * b * c",
        "a / b",
        "1 / (1 + c * square(cos(a)))",
        "sin(2.5 * a) * cos(b) - exp(-square(a - b))",
        "tanh(10.0 * a / c) + sqrt(c - b)",
        "fabs(b) * b - sign(a) * c",
        "larger(a, b) * larger(b - a, c * b)",
        "sqrt(larger(c - a, 0.001))",
    ],
)
def test_slopes_equal_those_of_sympy(formula):
    tangents = Tangents({name: k for k, name in enumerate(POINT)})
    tangents.line("v0", formula)
    tangents.line("v1", "v0 * v0 - a / v0")
    values = dict(POINT)
    for name, text in tangents.lines:
        values[name] = evaluated(text, values)
    symbols = {name: sympy.Symbol(name, real=True) for name in POINT}
    first = eval(formula, {}, {**SYMBOLIC, **symbols})
    for text, whole in (("v0", first), ("v1", first**2 - symbols["a"] / first), ("v0 * c", first * symbols["c"])):
        slopes = tangents.last(text)[1]
        for k, name in enumerate(POINT):
            wanted = float(
                sympy.diff(whole, symbols[name]).subs({symbols[key]: value for key, value in POINT.items()}).evalf()
            )
            found = float(evaluated(slopes[k], values)) if k in slopes else 0.0
            assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12), (text, name)


def test_only_what_a_value_depends_on_has_a_slope():
    tangents = Tangents({"a": 0, "b": 1})
    tangents.line("v0", "sin(a) * k[0]")
    assert set(tangents.last("v0 + 2.0")[1]) == {0}
    assert set(tangents.last("b - v0")[1]) == {0, 1}
    assert tangents.last("k[12] * 3")[1] == {}
    assert tangents.last("sign(a)")[1] == {}
    assert tangents.last("b")[1] == {1: "1"}


@pytest.mark.parametrize(
    "formula",
    [
        "system(a)",
        "a.real",
        "k[system(1)]",
        "b[0]",
        "__import__",
        "'text'",
        "a if b else a",
        "a ** 2",
        "sin(a, b)",
        "a > b",
        "+a",
        "True * a",
        "[a][0]",
        "sin(a)(b)",
    ],
)
def test_a_formula_holds_nothing_else(formula):
    tangents = Tangents({"a": 0, "b": 1})
    with pytest.raises(ValueError, match="formula"):
        tangents.line("v0", formula)


def test_whole_numbers_divide_as_numbers():
    tangents = Tangents({"a": 0})
    value, slopes = tangents.last("1 / 3 * a + a / 2")
    assert value == "(((1.0 / 3.0) * a) + (a / 2.0))"  # in C, 1 / 3 is zero
    assert evaluated(slopes[0], {}) == pytest.approx(1 / 3 + 1 / 2)
    assert "2.0" in slopes[0]
    for formula in ("1e999 * a", f"{10**400} * a"):
        with pytest.raises(ValueError, match="formula"):
            tangents.last(formula)
