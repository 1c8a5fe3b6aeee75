"""Equations in words: delay, friction, springs, and states that take no part in them."""

import math

import torch

from dynasindy.evaluation.equations import bend_hint, found_in_model, hidden_states, idle
from dynasindy.systems import Tras
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models import SindyModel
from dynasindy.world_models.models.bends import Bend


def test_delay_friction_and_springs_of_a_model_are_said_in_words():
    model = SindyModel(Tras().signature, "rotor_rig", known={"alpha_a": "Omega_a", "alpha_p": "Omega_p"})
    assert found_in_model(model) == []
    coefficients, model.delay = model.coefficients.clone(), 0.0123
    rates = {name: model.signature.state_index(name) for name in ("Omega_a", "Omega_p")}
    for name, state in (("alpha_a /(1 + 3 cos(alpha_p)^2)", "Omega_a"), ("tanh(10 Omega_p)", "Omega_p")):
        coefficients[model.library.index(name), rates[state]] = -1.0
    model.set_coefficients(coefficients)
    expected = ["the inputs act 12.3 ms late", "Omega_a' has a spring in alpha_a", "Omega_p' has dry friction"]
    assert found_in_model(model) == expected
    # What drives a rate the more, the faster it is, is no friction.
    coefficients[model.library.index("tanh(10 Omega_p)"), rates["Omega_p"]] = 1.0
    model.set_coefficients(coefficients)
    assert found_in_model(model) == expected[:2]


def test_what_bends_at_all_speeds_is_no_friction_nor_is_what_the_data_do_not_tell():
    """Of speeds up to 4 rad/s, tanh(v / 8) is a drag, and tanh(20 v) friction unless others make up for it."""
    signature = Signature(("v",), ("rad/s",), ("u",), (4.0,))
    for width, expected in ((0.125, []), (1.2, []), (1.3, ["v' has dry friction"]), (20.0, ["v' has dry friction"])):
        model = SindyModel(signature, [f"tanh({width} v)", "u"])
        model.set_coefficients(torch.tensor([[-3.0], [1.0]], dtype=torch.float64))
        assert found_in_model(model) == found_in_model(model, torch.tensor([[0.5], [1.0]])) == expected
        assert found_in_model(model, torch.tensor([[0.001], [1.0]])) == []


def test_dead_zones_and_saturations_are_said_in_the_unit_of_the_actuator():
    """An input of 1 is 12 V: what is flat from -0.25 to 0.5 is so from -3 V to 6 V."""
    volts = {"input_ends": ((-12.0, 12.0),), "input_units": ("V",)}
    signature = Signature(("q", "v"), ("rad", "rad/s"), ("u",), (1.0, 4.0), **volts)
    words = ["q", "v", "u", "max(0, u - 0.5)", "max(0, u - -0.25)"]
    model = SindyModel(signature, words, known={"q": "v"})

    def said(*of_u):
        xi = model.coefficients.clone()
        xi[2:, 1] = torch.tensor(of_u, dtype=torch.float64)
        model.set_coefficients(xi)
        return found_in_model(model)

    assert said(20.0, 20.0, -20.0) == ["u does nothing from -3 V to 6 V"]
    assert said(0.0, -20.0, 20.0) == ["u has no more effect below -3 V and above 6 V"]
    assert said(20.0, -20.0, 0.0) == ["u has no more effect above 6 V"]
    assert said(20.0, 5.0, -5.0) == []
    hint = bend_hint(Bend("u", "dead zone", -0.25, 0.5), model)
    assert "as if u does nothing from -3 V to 6 V" in hint and "plant.library=dead_zone 'plant.known={q: v}'" in hint


def log_of(*columns: float) -> Transitions:
    """Return a log of such states, each of one value."""
    return Transitions.from_trajectory(torch.tensor([columns] * 9, dtype=torch.float64), torch.zeros(8, 1), 0.1)


def test_a_hidden_state_is_none_that_is_measured_through_its_rate_or_that_follows():
    signature = Signature(("q", "w", "h", "u_lagging"), ("rad", "rad/s", "m", "1"), ("u",), (1.0,) * 4)
    words = ["q", "w", "h", "u", "(u - u_lagging)"]
    model = SindyModel(signature, words, known={"q": "w"}, allowed={"u_lagging": ["(u - u_lagging)"]})
    assert hidden_states(model, log_of(1.0, math.nan, math.nan, math.nan)) == ["h"]
    assert hidden_states(model, log_of(1.0, 1.0, 1.0, math.nan)) == []
    assert hidden_states(model, log_of(math.nan, math.nan, 1.0, math.nan)) == ["q", "w"]


def test_a_hidden_state_in_no_equation_is_said_to_need_a_first_guess_and_how_it_is_given():
    signature = Signature(("upper", "lower"), ("m", "m"), ("u",), (1.0, 1.0))
    model, log = SindyModel(signature, ["upper", "lower", "u"]), log_of(math.nan, 1.0)
    (said,) = idle(model, log)
    assert said.startswith("hint: upper stands in no equation")
    assert "'plant.initial={upper: {u: 0.1, upper: -0.1}, lower: {upper: 0.1}}'" in said
    assert idle(model, log_of(1.0, 1.0)) == []  # it was measured
    for place in ((0, 1), (2, 0)):  # it moves the lower level, or is moved
        coefficients = torch.zeros_like(model.coefficients)
        coefficients[place] = 0.3
        model.set_coefficients(coefficients)
        assert idle(model, log) == []
