"""Functions out of a line of text: their values and slopes by hand, what they refuse, and their way through a file."""

import math

import pytest
import torch

from dynasindy.systems import Signature
from dynasindy.world_models import SindyModel
from dynasindy.world_models.features import parse
from dynasindy.world_models.formulas import register_formula
from dynasindy.world_models.functions import _REGISTRY, function
from dynasindy.world_models.library import Library


@pytest.fixture(autouse=True)
def clean(monkeypatch):
    monkeypatch.setattr("dynasindy.world_models.functions._REGISTRY", dict(_REGISTRY))


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
    own = register_formula("own", formula)
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
        "{0.__class__}",
        "{0} ** 9",
        "(lambda: {0})()",
        "[{0}][0]",
        "{1} + {0}",
        "sin({0}, {0})",
        "larger({0})",
        "exp(x={0})",
        "'a' * 3 + {0}",
        "1e999 * {0}",
        "z + {0}",
        "{0} if {0} else 1",
        "True * {0}",
        "{0} +",
        "3",
        "",
        "(" * 290,
        "{0}" * 200,
        None,
        4,
    ],
)
def test_anything_else_than_a_formula_costs_one_line(formula):
    with pytest.raises(ValueError, match=r"mend it|write it in") as error:
        register_formula("own", formula)
    assert "\n" not in str(error.value) and "own" not in _REGISTRY


def test_functions_of_the_package_stay_as_they_are():
    with pytest.raises(ValueError, match="'sin' comes with dynasindy"):
        register_formula("sin", "2 * {0}")
    assert function("sin").compute(torch.tensor(0.5)).item() == pytest.approx(math.sin(0.5))


def test_a_model_takes_its_functions_with_it(monkeypatch, tmp_path):
    register_formula("softened", "{0} / (1 + fabs({0}))")
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    model = SindyModel(signature, Library(signature, [parse(text) for text in ("x", "u", "softened(x)")]))
    model.coefficients = torch.tensor([[0.0], [2.0], [-3.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    monkeypatch.setattr("dynasindy.world_models.functions._REGISTRY", dict(_REGISTRY))  # another process
    with pytest.raises(ValueError, match="softened"):
        function("softened")
    read = SindyModel.load(tmp_path / "model.json")
    x, u = torch.tensor([[0.5]], dtype=torch.float64), torch.tensor([[0.25]], dtype=torch.float64)
    assert read(x, u).item() == pytest.approx(2 * 0.25 - 3 * 0.5 / 1.5)
    register_formula("softened", "{0}")
    with pytest.raises(ValueError, match=r"softened.*is another function here"):
        SindyModel.load(tmp_path / "model.json")
