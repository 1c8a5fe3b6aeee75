"""Derivatives of straight-line formulas equal those that SymPy finds, and those that are zero are not written."""

import math

import pytest
import sympy

from dynasindy.systems.tangents import ExpressionGraph

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


INFIX = {"+": float.__add__, "-": float.__sub__, "*": float.__mul__, "/": float.__truediv__, "neg": float.__neg__}


def evaluated(graph, values):
    """The number at each place of a graph."""
    found = []
    for operation, operands in graph.nodes:
        given = [found[place] for place in operands]
        known = INFIX.get(operation) or KNOWN.get(operation)
        found.append(float(known(*given) if operands else values.get(operation) or float(operation)))
    return found


def graph_of(*formulas, lines=()):
    return ExpressionGraph({name: k for k, name in enumerate(POINT)}, lines, formulas)


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
    graph = graph_of("v0", "v1", "v0 * c", lines=(("v0", formula), ("v1", "v0 * v0 - a / v0")))
    numbers = evaluated(graph, POINT)
    symbols = {name: sympy.Symbol(name, real=True) for name in POINT}
    first = eval(formula, {}, {**SYMBOLIC, **symbols})
    at = {symbols[name]: value for name, value in POINT.items()}
    slopes = {(row, k): numbers[place] for row, k, place in graph.entries}
    for row, whole in enumerate((first, first**2 - symbols["a"] / first, first * symbols["c"])):
        assert numbers[graph.results[row]] == pytest.approx(float(whole.subs(at).evalf()), rel=1e-12)
        for k, name in enumerate(POINT):
            wanted = float(sympy.diff(whole, symbols[name]).subs(at).evalf())
            assert slopes.get((row, k), 0.0) == pytest.approx(wanted, rel=1e-12, abs=1e-12), (row, name)


def test_only_what_a_value_depends_on_has_a_slope():
    graph = graph_of("v0 + 2.0", "b - v0", "k[12] * 3", "sign(a)", "b", lines=(("v0", "sin(a) * k[0]"),))
    assert {(row, k) for row, k, _ in graph.entries} == {(0, 0), (1, 0), (1, 1), (4, 1)}
    assert graph.nodes[graph.entries[-1][2]] == ("1.0", ())


def test_each_value_is_there_once_and_behind_what_it_is_made_of():
    graph = graph_of("sin(a) * b + sin(a)", "cos(a) * b")
    assert len(graph.nodes) == len(set(graph.nodes))
    assert [operation for operation, _ in graph.nodes].count("cos") == 1  # a slope of the first is part of the second
    for place, (_, operands) in enumerate(graph.nodes):
        assert all(operand < place for operand in operands)
    assert graph.needed(graph.results[:1]) == sorted(graph.needed(graph.results[:1]))
    assert "cos" not in {graph.nodes[place][0] for place in graph.needed(graph.results[:1])}


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
    with pytest.raises(ValueError, match="formula"):
        graph_of("v0", lines=(("v0", formula),))


def test_whole_numbers_divide_as_numbers():
    graph = graph_of("1 / 3 * a + a / 2")
    assert {operation for operation, operands in graph.nodes if not operands} >= {
        "1.0",
        "2.0",
        "3.0",
    }  # in C, 1 / 3 is 0
    assert evaluated(graph, POINT)[graph.entries[0][2]] == pytest.approx(1 / 3 + 1 / 2)
    for formula in ("1e999 * a", f"{10**400} * a"):
        with pytest.raises(ValueError, match="formula"):
            graph_of(formula)
