"""What equations hold: delay, friction, and states that take no part in them."""

import math
from dataclasses import replace

import pytest
import torch

from dynasindy.findings import note, weak
from dynasindy.identification.verdict import equation_findings, idle_states
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.regression import TriangularFactor
from dynasindy.systems import Tras
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def test_delay_and_friction_of_a_model_are_found():
    model = SindyModel(Tras().signature, "rotor_rig", known={"alpha_a": "Omega_a", "alpha_p": "Omega_p"})
    assert equation_findings(model) == []
    coefficients, model.delay = model.coefficients.clone(), 0.0123
    rates = {name: model.signature.state_index(name) for name in ("Omega_a", "Omega_p")}
    for name, state in (("alpha_a /(1 + 3 cos(alpha_p)^2)", "Omega_a"), ("tanh(10 Omega_p)", "Omega_p")):
        coefficients[model.library.index(name), rates[state]] = -1.0
    model.set_coefficients(coefficients)
    late = note("model.delay", seconds=0.0123)
    assert equation_findings(model) == [late, note("model.dry_friction", state="Omega_p")]
    # What drives a rate the more, the faster it is, is no friction.
    coefficients[model.library.index("tanh(10 Omega_p)"), rates["Omega_p"]] = 1.0
    model.set_coefficients(coefficients)
    assert equation_findings(model) == [late]


def test_what_bends_at_all_speeds_is_no_friction_nor_is_what_the_data_do_not_tell():
    """Of speeds up to 4 rad/s, tanh(v / 8) is a drag, and tanh(20 v) friction unless others make up for it."""
    signature = Signature(("v",), ("rad/s",), ("u",), (4.0,))
    dry = [note("model.dry_friction", state="v")]
    for width, expected in ((0.125, []), (1.2, []), (1.3, dry), (20.0, dry)):
        model = SindyModel(signature, [f"tanh({width} v)", "u"])
        model.set_coefficients(torch.tensor([[-3.0], [1.0]], dtype=torch.float64))
        assert equation_findings(model) == equation_findings(model, report_of(model, 0.5)) == expected
        assert equation_findings(model, report_of(model, 0.001)) == []


@pytest.mark.parametrize(("doubts", "said"), [((), True), ((weak("fit.longest_delay", seconds=0.002),), False)])
def test_a_delay_is_told_unless_its_search_ended_there(doubts, said):
    model = SindyModel(Signature(("v",), ("m/s",), ("u",), (4.0,)), ["v", "u"])
    model.set_coefficients(torch.tensor([[-3.0], [1.0]], dtype=torch.float64))
    model.delay = 0.002
    found = equation_findings(model, replace(report_of(model, 0.5), findings=doubts))
    assert found == [note("model.delay", seconds=0.002)] * said


def report_of(model: SindyModel, apart: float) -> FitReport:
    """Return the report of a fit to two columns, with so small an angle between them, in samples of 10 ms."""
    columns = torch.tensor([[1.0, math.cos(math.asin(apart))], [0.0, apart]], dtype=torch.float64)
    factor = TriangularFactor((columns, torch.zeros(2, 1, dtype=torch.float64)))
    return FitReport(model.library, model.coefficients, factor, 0.0, 2, dt=0.01)


def log_of(*columns: float) -> Transitions:
    """Return a log of such states, each of one value."""
    return Transitions.from_trajectory(torch.tensor([columns] * 9, dtype=torch.float64), torch.zeros(8, 1), 0.1)


def test_a_hidden_state_is_none_that_is_measured_through_its_rate_or_that_follows():
    signature = Signature(("q", "w", "h", "u_lagging"), ("rad", "rad/s", "m", "1"), ("u",), (1.0,) * 4)
    words = ["q", "w", "h", "u", "(u - u_lagging)"]
    model = SindyModel(signature, words, known={"q": "w"}, allowed={"u_lagging": ["(u - u_lagging)"]})
    model.coefficients[words.index("(u - u_lagging)"), 3] = 1.0
    (told,) = idle_states(model, log_of(1.0, math.nan, math.nan, math.nan))
    assert told.values["states"] == ["h"]
    assert idle_states(model, log_of(1.0, 1.0, 1.0, math.nan)) == []


def test_a_hidden_state_in_no_equation_is_said_to_need_a_first_guess_and_how_it_is_given():
    signature = Signature(("upper", "lower"), ("m", "m"), ("u",), (1.0, 1.0))
    model, log = SindyModel(signature, ["upper", "lower", "u"]), log_of(math.nan, 1.0)
    (told,) = idle_states(model, log)
    assert (told.code, told.severity) == ("model.idle_state", "weak") and told.values["states"] == ["upper"]
    example = {
        "upper": {"u": 0.1, "upper": -0.1},
        "lower": {"upper": 0.1},
    }  # it is moved, fades, and moves what is seen
    assert told.values["initial"] == example
    guessed = SindyModel(signature, ["upper", "lower", "u"], initial=told.values["initial"])
    assert bool(guessed.initial[:, 0].any())  # as it is given
    assert idle_states(model, log_of(1.0, 1.0)) == []  # it was measured
    for place in ((0, 1), (2, 0)):  # it moves the lower level, or is moved
        coefficients = torch.zeros_like(model.coefficients)
        coefficients[place] = 0.3
        model.set_coefficients(coefficients)
        assert idle_states(model, log) == []
