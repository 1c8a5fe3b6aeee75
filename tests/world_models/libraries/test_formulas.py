"""Functions out of a line of text: their values and slopes by hand, what they refuse, and their way through a file."""

import json
import math

import pytest
import torch

from dynasindy.systems import Signature
from dynasindy.world_models import SindyModel
from dynasindy.world_models.libraries.features import parse
from dynasindy.world_models.libraries.formulas import forget, register_formula
from dynasindy.world_models.libraries.functions import _REGISTRY, function, register_function
from dynasindy.world_models.libraries.library import Library


@pytest.fixture(autouse=True)
def clean(monkeypatch):
    monkeypatch.setattr("dynasindy.world_models.libraries.functions._REGISTRY", dict(_REGISTRY))
    monkeypatch.setattr("dynasindy.world_models.libraries.formulas._TEXTS", {})


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
        "sin * {0}",
        "exp - {0}",
        "0x" + "f" * 280 + " * {0}",
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
    with pytest.raises(ValueError, match="'sin' is another function here"):
        register_formula("sin", "2 * {0}")
    assert function("sin").compute(torch.tensor(0.5)).item() == pytest.approx(math.sin(0.5))


def test_a_model_takes_its_functions_with_it(monkeypatch, tmp_path):
    register_formula("softened", "{0} / (1 + fabs({0}))")
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    model = SindyModel(signature, Library(signature, [parse(text) for text in ("x", "u", "softened(x)")]))
    model.coefficients = torch.tensor([[0.0], [2.0], [-3.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    monkeypatch.setattr("dynasindy.world_models.libraries.functions._REGISTRY", dict(_REGISTRY))  # another process
    monkeypatch.setattr("dynasindy.world_models.libraries.formulas._TEXTS", {})
    with pytest.raises(ValueError, match="softened"):
        function("softened")
    read = SindyModel.load(tmp_path / "model.json")
    x, u = torch.tensor([[0.5]], dtype=torch.float64), torch.tensor([[0.25]], dtype=torch.float64)
    assert read(x, u).item() == pytest.approx(2 * 0.25 - 3 * 0.5 / 1.5)


def test_a_file_replaces_no_function_and_leaves_none_behind_if_it_is_damaged(tmp_path):
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    register_formula("softened", "{0} / (1 + fabs({0}))")
    model = SindyModel(signature, Library(signature, [parse("softened(x)")]))
    model.coefficients = torch.tensor([[1.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    forget(["softened"])
    register_function("softened", torch.relu)
    with pytest.raises(ValueError, match=r"softened.*is another function here"):
        SindyModel.load(tmp_path / "model.json")
    assert function("softened").compute(torch.tensor(-2.0)).item() == 0.0
    forget(["softened"])
    (tmp_path / "model.json").write_text((tmp_path / "model.json").read_text().replace('"x_scale"', '"scale"'))
    with pytest.raises(ValueError, match="damaged"):
        SindyModel.load(tmp_path / "model.json")
    with pytest.raises(ValueError, match="not known"):
        function("softened")


def test_other_languages_read_what_torch_computes():
    """Floats, where C would divide whole numbers, and nothing of a comment, which other languages might run."""
    own = register_formula("own", "1/2*{0} - -0x10 # {0.__doc__}")
    assert own.formula == "(((1.0 / 2.0) * {0}) - (0.0 - 16.0))"
    assert own.compute(torch.tensor(2.0)).item() == 17.0 == eval(own.formula.format("2"))


def test_a_function_of_python_is_saved_and_read_as_before(tmp_path):
    register_function("lorentz", lambda z: 1 / (1 + z * z), formula="1 / (1 + square({0}))")
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    model = SindyModel(signature, Library(signature, [parse("lorentz(x)")]))
    model.coefficients = torch.tensor([[2.0]], dtype=torch.float64)
    model.save(tmp_path / "model.json")
    assert "functions" not in json.loads((tmp_path / "model.json").read_text())
    read = SindyModel.load(tmp_path / "model.json")
    assert read(torch.ones(1, 1).double(), torch.zeros(1, 1).double()).item() == pytest.approx(1.0)
