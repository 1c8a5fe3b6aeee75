"""Formulas compute what the library of the model computes, whatever its functions."""

import re

import numpy as np
import pytest
import torch

from dynasindy.sindy import SindyModel
from dynasindy.sindy.formulas import formulas
from dynasindy.sindy.functions import FORMULA_FUNCTIONS, register_function
from dynasindy.systems import Signature

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
