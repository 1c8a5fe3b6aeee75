"""Slopes and formulas of the elementary functions are those of their values."""

import math

import pytest
import torch

from dynasindy.sindy import functions
from dynasindy.sindy.functions import FORMULA_FUNCTIONS, function, register_function

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
@pytest.mark.parametrize("name", sorted(name for name, f in functions._REGISTRY.items() if f.formula))
def test_a_formula_in_plain_floats_is_the_value(name, point):
    assert set(PLAIN) == set(FORMULA_FUNCTIONS)
    values = arguments(name, point[0], abs(point[1]))
    value = function(name).compute(*(torch.tensor(v, dtype=torch.float64) for v in values[:-1]), values[-1]) if (
        function(name).parametric
    ) else function(name).compute(*(torch.tensor(v, dtype=torch.float64) for v in values))  # fmt: skip
    places = {f"z{i}": v for i, v in enumerate(values)}
    written = eval(function(name).formula.format(*places), {**PLAIN, **places})
    assert written == pytest.approx(float(value), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", sorted(name for name, f in functions._REGISTRY.items() if f.slope))
def test_a_slope_is_a_difference_of_values(name, point):
    known = function(name)
    z, step = torch.tensor(point[0], dtype=torch.float64), 1e-6
    number = (abs(point[1]),) if known.parametric else ()
    slope = (known.compute(z + step, *number) - known.compute(z - step, *number)) / (2 * step)
    assert float(known.slope(z, *number)) == pytest.approx(float(slope), rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", sorted(name for name, f in functions._REGISTRY.items() if f.by_number))
def test_a_slope_by_the_number_is_a_difference_of_values(name, point):
    *values, number = arguments(name, point[0], abs(point[1]))
    z, step = [torch.tensor(v, dtype=torch.float64) for v in values], 1e-6
    slope = (function(name).compute(*z, number + step) - function(name).compute(*z, number - step)) / (2 * step)
    assert float(function(name).by_number(*z, number)) == pytest.approx(float(slope), rel=1e-5, abs=1e-8)


def test_a_formula_calls_what_every_language_has(monkeypatch):
    monkeypatch.setattr(functions, "_REGISTRY", dict(functions._REGISTRY))
    register_function("soft", lambda z: z / (1 + z.abs()), formula="{0} / (1 + fabs({0}))")
    assert function("soft").latex == r"\operatorname{{soft}}({0})"
    with pytest.raises(ValueError, match="a formula with 'system'"):
        register_function("evil", torch.sin, formula="system({0})")
    with pytest.raises(ValueError, match="identifier"):
        register_function("no name", torch.sin)
    with pytest.raises(ValueError, match="evil"):
        function("evil")


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", sorted(name for name, f in functions._REGISTRY.items() if f.slopes))
def test_slopes_by_each_of_two_angles_are_differences_of_values(name, point):
    known, step = function(name), 1e-6
    a, b = (torch.tensor(v, dtype=torch.float64) for v in (point[0], 0.25))
    number = (abs(point[1]),) if known.parametric else ()
    by_a = (known.compute(a + step, b, *number) - known.compute(a - step, b, *number)) / (2 * step)
    by_b = (known.compute(a, b + step, *number) - known.compute(a, b - step, *number)) / (2 * step)
    found = [float(slope(a, b, *number)) for slope in known.slopes]
    assert found == pytest.approx([float(by_a), float(by_b)], rel=1e-5, abs=1e-8)


def test_functions_of_two_angles_are_those_of_their_sum_and_difference():
    a, b = torch.tensor([0.3, -1.2]), torch.tensor([0.9, 2.0])
    torch.testing.assert_close(function("sin_sum").compute(a, b), a.sin() * b.cos() + a.cos() * b.sin())
    torch.testing.assert_close(function("cos_gap").compute(a, b), a.cos() * b.cos() + a.sin() * b.sin())
