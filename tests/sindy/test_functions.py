"""Functions and formulas: their values by hand, what they refuse, and their way through a file."""

import math
import re

import numpy as np
import pytest
import torch

from dynasindy.sindy import Library, SindyModel, functions, register_function
from dynasindy.sindy.codegen import formulas
from dynasindy.sindy.functions import _REGISTRY, FORMULA_FUNCTIONS, function
from dynasindy.sindy.library import parse
from dynasindy.systems import Signature

PLAIN = {
    **{name: getattr(math, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "fabs")},
    "sign": lambda z: (z > 0) - (z < 0),
    "square": lambda z: z * z,
    "larger": max,
}
POINTS = [(-1.3, 0.4), (0.7, 0.4), (2.1, -0.6)]


def arguments(name, z, p):
    first = (z, 0.25) if name in ("ahead", "slack") or name.endswith(("_sum", "_gap")) else (z,)
    return (*first, p) if function(name).parametric else first


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", sorted({*functions._REGISTRY, "sin_sum", "cos_gap", "per_cos2_sum", "bell_gap"}))
def test_a_formula_in_plain_floats_is_the_value(name, point):
    assert set(PLAIN) == set(FORMULA_FUNCTIONS)
    values = arguments(name, point[0], abs(point[1]))
    value = function(name).compute(*(torch.tensor(v, dtype=torch.float64) for v in values[:-1]), values[-1]) if (
        function(name).parametric
    ) else function(name).compute(*(torch.tensor(v, dtype=torch.float64) for v in values))  # fmt: skip
    places = {f"z{i}": v for i, v in enumerate(values)}
    written = eval(function(name).formula.format(*places), {**PLAIN, **places})
    assert written == pytest.approx(float(value), rel=1e-12, abs=1e-15)


def another_process(monkeypatch):
    """Know the functions of the package alone."""
    monkeypatch.setattr("dynasindy.sindy.functions._REGISTRY", dict(_REGISTRY))


@pytest.fixture(autouse=True)
def clean(monkeypatch):
    another_process(monkeypatch)


@pytest.mark.parametrize(
    ("formula", "z", "value", "slope"),
    [
        ("1 / (1 + exp(-{0}))", 0.7, 1 / (1 + math.exp(-0.7)), math.exp(-0.7) / (1 + math.exp(-0.7)) ** 2),
        ("{0} * fabs({0}) - 3", -2.0, -7.0, 4.0),
        ("-square({0}) / 2", 3.0, -4.5, -3.0),
        ("larger({0}, 0.5) * sin({0})", 0.2, 0.5 * math.sin(0.2), 0.5 * math.cos(0.2)),
        ("sqrt({0}) + tanh({0}) + cos({0}) + sign({0})", 4.0, 3 + math.tanh(4) + math.cos(4), None),
    ],
)
def test_a_formula_is_its_value_and_its_slope(formula, z, value, slope):
    own = register_function("own", formula)
    argument = torch.tensor([z, z], dtype=torch.float64, requires_grad=True)
    result = own.compute(argument)
    assert result.tolist() == pytest.approx([value, value], rel=1e-12)
    (found,) = torch.autograd.grad(result.sum(), argument)
    if slope is not None:
        assert found.tolist() == pytest.approx([slope, slope], rel=1e-12)


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').system('true')",
        "{0}.real",
        "{0} ** 9",
        "{1} + 2",
        "sin({0}, {0})",
        "1e999 * {0}",
        "z + {0}",
        "",
        "(" * 290,
        None,
    ],
)
def test_anything_else_than_a_formula_costs_one_line(formula):
    with pytest.raises(ValueError, match="own") as error:
        register_function("own", formula)
    assert "\n" not in str(error.value) and "own" not in _REGISTRY


def test_a_model_takes_its_functions_with_it(monkeypatch, tmp_path):
    register_function("softened", "{0} / (1 + fabs({0}))")
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    model = SindyModel(signature, Library(signature, [parse(text) for text in ("x", "u", "softened(x)")]))
    model.coefficients = torch.tensor([[0.0], [2.0], [-3.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    another_process(monkeypatch)
    with pytest.raises(ValueError, match="softened"):
        function("softened")
    read = SindyModel.load(tmp_path / "model.json")
    x, u = torch.tensor([[0.5]], dtype=torch.float64), torch.tensor([[0.25]], dtype=torch.float64)
    assert read(x, u).item() == pytest.approx(2 * 0.25 - 3 * 0.5 / 1.5)


def test_a_file_replaces_no_function_and_leaves_none_behind_if_it_is_damaged(tmp_path):
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    register_function("softened", "{0} / (1 + fabs({0}))")
    model = SindyModel(signature, Library(signature, [parse("softened(x)")]))
    model.coefficients = torch.tensor([[1.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    functions._REGISTRY.pop("softened")
    register_function("softened", "larger({0}, 0)")
    with pytest.raises(ValueError, match="softened"):
        SindyModel.load(tmp_path / "model.json")
    assert function("softened").compute(torch.tensor(-2.0)).item() == 0.0
    functions._REGISTRY.pop("softened")
    (tmp_path / "model.json").write_text((tmp_path / "model.json").read_text().replace('"x_scale"', '"scale"'))
    with pytest.raises(ValueError, match="damaged"):
        SindyModel.load(tmp_path / "model.json")
    with pytest.raises(ValueError, match="not known"):
        function("softened")


TANKS = Signature(("h1", "h2"), ("m", "m"), ("u",), (1.0, 1.0))
FLOW = "{0} / sqrt(larger(fabs({0}), 0.001))"


def of_tanks(*functions: str) -> SindyModel:
    """Return a model whose second level rises by the sum of some functions."""
    model = SindyModel(TANKS, Library(TANKS, [parse(text) for text in ("u", *functions)]))
    model.coefficients = torch.tensor([[1.0, 0.0], *([0.0, 1.0] for _ in functions)], dtype=torch.float64)
    return model


def torricelli(d: float) -> float:
    return math.copysign(math.sqrt(abs(d)), d)


@pytest.mark.parametrize("written", ["flow(h1 - h2)", "between(h1, h2)"])
@pytest.mark.parametrize("levels", [(0.9, 0.3), (0.2, 0.7)])
def test_a_function_of_a_difference_goes_through_a_file_into_another_process(monkeypatch, tmp_path, written, levels):
    """The oracle is Torricelli's flow between two tanks, sign(d) sqrt|d|, and its slope 1 / (2 sqrt|d|)."""
    gap = FLOW.replace("{0}", "({0} - {1})")
    register_function("flow", FLOW)
    register_function("between", gap)
    of_tanks(written).save(tmp_path / "model.json")
    another_process(monkeypatch)
    read = SindyModel.load(tmp_path / "model.json")
    assert read.library.names[1] == written
    x = torch.tensor([levels], dtype=torch.float64, requires_grad=True)
    rise = read(x, torch.zeros(1, 1, dtype=torch.float64))[0, 1]
    d = levels[0] - levels[1]
    assert rise.item() == pytest.approx(torricelli(d), rel=1e-12)
    slopes = torch.autograd.grad(rise, x)[0][0].tolist()
    assert slopes == pytest.approx([0.5 / math.sqrt(abs(d)), -0.5 / math.sqrt(abs(d))], rel=1e-12)
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == (tmp_path / "model.json").read_text()


SIGNATURE = Signature(("a", "b"), ("-", "-"), ("c",), (1.0, 1.0))
WORDS = [
    "1", "a", "b^2", "a b c", "sin(2 a)", "cos(b)^3", "a |a|", "sign(b)", "exp(-(2 a)^2)", "exp(0.5 b)", "tanh(~3 b)",
    "sqrt(a)", "sqrt(b - 0.3)", "max(0, a - -0.2)", "b /(1 + 3 cos(a)^2)", "a b /(1 + 3 cos(a)^2)^2", "a b^5 c^2",
]  # fmt: skip


def evaluated(found, x, u):
    """Evaluate formulas with the functions of NumPy."""
    scope = {name: getattr(np, name) for name in FORMULA_FUNCTIONS if hasattr(np, name)}
    scope |= {"larger": np.maximum, "x": x, "u": u}
    for name, formula in found.lines:
        scope[name] = eval(formula, scope)
    return [eval(formula, scope) for formula in found.results]


@pytest.mark.parametrize("seed", range(8))
def test_they_are_the_model(seed):
    rng = np.random.default_rng(seed)
    model = SindyModel(SIGNATURE, WORDS)
    table = rng.standard_normal((len(WORDS), 2)) * (rng.random((len(WORDS), 2)) < (0.2 + 0.1 * seed))
    model.set_coefficients(torch.from_numpy(table))
    x, u = rng.standard_normal(2), rng.standard_normal(1)
    # What the library says, function by function, shares no code with the text.
    expected = model.library(torch.from_numpy(x), torch.from_numpy(u)).numpy() @ table
    found = formulas(model)
    np.testing.assert_allclose(evaluated(found, x, u), expected, rtol=1e-12, atol=1e-12)
    for place, (name, _) in enumerate(found.lines):
        rest = [text for _, text in found.lines[place + 1 :]] + list(found.results)
        assert any(re.search(rf"\b{name}\b", text) for text in rest), "a value that nothing reads"


def test_what_formulas_call_and_read_is_told():
    model = SindyModel(SIGNATURE, ["a", "sin(2 a)", "b c"])
    model.set_coefficients(torch.tensor([[3.0, 0.0], [1.0, 0.0], [0.5, 0.0]]))
    found = formulas(model)
    assert found.has("sin") and not found.has("cos") and found.has("u") and found.results[1] == "0.0"
    model.set_coefficients(torch.tensor([[3.0, 0.0], [0.0, 0.0], [0.0, 0.0]]))
    assert not formulas(model).has("sin") and not formulas(model).has("u")


def test_a_function_of_ones_own_is_its_formula():
    register_function("with_formula", "1 / (1 + square({0}))")
    model = SindyModel(SIGNATURE, ["with_formula(2 a)"])
    model.set_coefficients(torch.tensor([[3.0, 0.0]]))
    assert evaluated(formulas(model), np.array([0.5, 0.0]), None)[0] == pytest.approx(1.5)
    with pytest.raises(ValueError, match="system"):
        register_function("bad_formula", "system({0})")
