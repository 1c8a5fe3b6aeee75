"""What is said of a model: its forecasts, and the delay, friction and states of its equations."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from dynasindy.findings import FindingError, note, weak, wrong
from dynasindy.identification.forecast_errors import ForecastErrors
from dynasindy.identification.identify import table
from dynasindy.identification.verdict import (
    equation_findings,
    idle_states,
    inputs_beyond_log,
    logged_input_ranges,
    model_findings,
    recording_findings,
    require_controlled,
    targets_beyond_log,
    what_to_leave_out,
)
from dynasindy.sindy import FitReport, Library, SindyModel
from dynasindy.sindy.library import of, variable
from dynasindy.sindy.regression import TriangularFactor
from dynasindy.systems import Pendulum, Signature, Tras
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("q", "v", "w"), ("rad", "rad/s", "rpm"), ("u",), (1.0, 1.0, 1.0))


def forecasts(q: float, w: float = 20.0, linear: float = 1.0) -> ForecastErrors:
    """Errors over 0.2, 2 and 5 s, of which 2 s matters; v is not measured."""
    ours, simple, held = (
        torch.tensor([[9.0, math.nan, 9.0], [a, math.nan, b], [9.0, math.nan, 9.0]])
        for a, b in ((q, w), (linear, 500.0), (0.1, 800.0))
    )
    return ForecastErrors((0.2, 2.0, 5.0), 1.7, 200, ours, simple, held, torch.tensor([0.0015, math.nan, 21.0]), 8)


@pytest.mark.parametrize(
    ("q", "told"),
    [
        (0.002, note("model.predicts", seconds=2.0, exact=["q", "w"], behind=False)),
        (0.04, note("model.predicts", seconds=2.0, exact=["w"], behind=False)),
        (
            0.06,
            wrong(
                "model.misses",
                seconds=2.0,
                errors={"q": pytest.approx(0.06)},
                held={"q": pytest.approx(0.1)},
                units={"q": "rad"},
            ),
        ),
        (math.inf, wrong("model.runs_away", seconds=2.0, states=["q"])),
    ],
)
def test_a_model_predicts_if_it_halves_the_error_of_the_last_value_held_or_meets_the_sensors(q, told):
    assert model_findings(forecasts(q), SIGNATURE) == [told]


def better(error, linear):
    """Return what is known of q over 2 s."""
    errors_ = {"error": pytest.approx(error), "linear": pytest.approx(linear)}
    return {"state": "q", "unit": "rad", "seconds": 2.0, **errors_}


def test_a_linear_model_that_is_better_is_said_to_be():
    promise, alone = (note("model.predicts", seconds=2.0, exact=["w"], behind=b) for b in (True, False))
    assert model_findings(forecasts(0.04, linear=0.03), SIGNATURE) == [
        weak("model.linear_better", **better(0.04, 0.03), far=False),
        promise,
    ]
    assert model_findings(forecasts(0.04, linear=0.0395), SIGNATURE) == [alone]
    for early, codes in ((0.004, "predicts linear_better"), (0.008, "linear_better predicts")):  # at 0.2 s alone
        simple = forecasts(0.002, linear=1.0)
        simple.model[0, 0], simple.linear[0, 0], simple.held[0, 0] = early, 0.6 * early, 0.1
        assert [each.code for each in model_findings(simple, SIGNATURE)] == [f"model.{each}" for each in codes.split()]
    assert model_findings(forecasts(0.04, linear=0.01), SIGNATURE) == [
        wrong("model.linear_better", **better(0.04, 0.01), far=True),
        weak("model.incomplete", seconds=2.0),
    ]


@pytest.mark.parametrize(("first", "seconds"), [(0.01, 0.2), (0.09, 0.0)])
def test_a_plant_that_runs_away_by_itself_is_said_to_where_a_linear_model_does_so_too(first, seconds):
    """Of a range of 1 rad errors of more than 10 rad are lost; the last value held misses 0.1 rad."""
    ours = torch.tensor([[first], [math.inf], [math.inf]])
    found = replace(forecasts(0.002), model=ours, held=torch.full((3, 1), 0.1), resolution=torch.tensor([0.001]))
    one = Signature(("q",), ("rad",), ("u",), (1.0,))
    lost = wrong("model.runs_away", seconds=2.0, states=["q"])
    falling = model_findings(replace(found, linear=torch.tensor([[0.1], [1.0], [11.0]])), one)
    assert falling == [lost, weak("model.unstable_plant", states=["q"], seconds=seconds)]
    staying = model_findings(replace(found, linear=torch.tensor([[0.1], [1.0], [9.0]])), one)
    assert staying == [lost]


def test_measured_states_that_are_predicted_are_those_to_keep_beside_others_that_do_not_move_them():
    data = Transitions.from_trajectory(torch.tensor([[0.0, math.nan, 1.0]]).repeat(9, 1).double(), torch.zeros(8, 1), 1)
    log, model = SimpleNamespace(training=data, signature=SIGNATURE), SindyModel(SIGNATURE, ["q", "w", "v"])
    for q in (0.06, math.inf):  # w moves q, and v moves w
        model.set_coefficients(torch.tensor([[-1.0, 0.0, 0.0], [0.5, -1.0, 1.0], [0.5, 0.0, -1.0]]).double())
        found = what_to_leave_out(model_findings(forecasts(q), SIGNATURE), log, model)
        assert [each.values for each in found] == [{"states": ["q"], "kept": ["w"]}]
    model.set_coefficients(torch.tensor([[-1.0, 0.5, 0.0], [0.0, -1.0, 1.0], [0.5, 0.0, -1.0]]).double())
    for errors in ((0.06, 1e3), (0.002,), (0.06,)):  # none is predicted, all are, and q moves w through v
        assert not what_to_leave_out(model_findings(forecasts(*errors), SIGNATURE), log, model)


def test_the_table_holds_measured_states_alone():
    head, state, kinds, *rows = table(forecasts(0.002), SIGNATURE)[:6]
    assert "past" in head and kinds.split() == ["model", "linear", "model", "last", "value", "held"]
    assert state == "  q [rad], its sensor resolves 0.0015"
    assert rows[1].split() == ["2", "s", "0.002", "1", "0.1"]
    assert not any("v [" in line for line in table(forecasts(0.002), SIGNATURE))
    slow = replace(forecasts(0.002), horizons=(60.0, 300.0, 1200.0))
    assert [row.split()[:2] for row in table(slow, SIGNATURE)[3:6]] == [["1", "min"], ["5", "min"], ["20", "min"]]


def test_an_input_is_known_between_the_ends_of_a_log_where_the_equations_bend_in_it():
    model = SindyModel(Pendulum().signature, ["Omega", "u", "u^2", "u sin(theta)"], known={"theta": "Omega"})

    def known(word):
        coefficients = model.coefficients.clone()
        coefficients[1:, 1] = 0.0
        coefficients[model.library.index(word), 1] = 2.0
        model.set_coefficients(coefficients)
        return logged_input_ranges(model, torch.tensor([[0.1], [0.4], [0.9]]))

    assert known("u") == known("u sin(theta)") == {}
    # A twentieth of the 0.8 between its ends is let to it on both sides.
    assert known("u^2") == {"u": (pytest.approx(0.06), pytest.approx(0.94))}


def test_an_input_is_known_as_far_as_its_lag_if_the_equations_bend_in_that():
    signature = Signature(("q", "u_lagging"), ("rad", "1"), ("u",), (1.0, 1.0))
    library = Library(signature, [variable("u_lagging") * variable("u_lagging"), of("ahead", "u", "u_lagging")])
    model = SindyModel(signature, library, allowed={"u_lagging": ["(u - u_lagging)"]})
    model.set_coefficients(torch.tensor([[8.0, 0.0], [0.0, 6.0]], dtype=torch.float64))
    assert logged_input_ranges(model, torch.tensor([[0.1], [0.9]])) == {"u": (pytest.approx(0.06), pytest.approx(0.94))}
    model.set_coefficients(torch.tensor([[0.0, 0.0], [0.0, 6.0]], dtype=torch.float64))
    assert logged_input_ranges(model, torch.tensor([[0.1], [0.9]])) == {}


@pytest.mark.parametrize(
    ("word", "unit", "free"),
    [("sin(q)", "rad", True), ("sin(q)", "m", False), ("sin(~3 q)", "rad", False), ("sin(u)", "rad", False)],
)
def test_only_the_sine_of_an_angle_is_known_beyond_the_log(word, unit, free):
    """q' = -5 q + 10 u: q is as an actuator, whose sine is geometry only where q is an angle; an input is none."""
    signature = Signature(("v", "q"), ("-", unit), ("u",), (1.0, 1.0))
    model = SindyModel(signature, ["q", "u", word])
    coefficients = torch.zeros_like(model.coefficients)
    coefficients[0, 1], coefficients[1, 1], coefficients[2, 0] = -5.0, 10.0, 3.0
    model.set_coefficients(coefficients)
    assert (logged_input_ranges(model, torch.tensor([[0.1], [0.9]])) == {}) == free


@pytest.mark.parametrize(
    ("terms", "ranges"),
    [
        ({"blade": -5.0, "u": 10.0}, {"u": (0.06, 0.94)}),
        ({"blade": -5.0, "v": 10.0}, {"v": (-0.44, 0.44)}),
        ({"blade": -5.0, "blade^2": -2.0, "u": 10.0}, {}),
        ({"blade": -5.0, "u": 10.0, "u blade": 3.0}, {}),
        ({"blade": -5.0, "u^2": 10.0}, {"u": (0.06, 0.94)}),
        ({"blade": -5.0, "u": 10.0, "v": 10.0}, {}),
    ],
)
def test_only_what_follows_one_input_linearly_goes_beyond_the_log_as_far_as_that_input(terms, ranges):
    """At rest a blade is at 2 u; one with a square or a product in its equation, or of two inputs, is at no multiple.

    Of u the log tells 0.1 to 0.9, of v -0.4 to 0.4, with a twentieth more to either side. A square of u itself bends.
    """
    signature = Signature(("q", "blade"), ("rad/s", "rad"), ("u", "v"), (1.0, 1.0))
    model = SindyModel(signature, ["blade", "u", "v", "blade^2", "u blade", "u^2"])
    coefficients = torch.zeros_like(model.coefficients)
    coefficients[model.library.index("blade^2"), 0] = 3.0
    for word, size in terms.items():
        coefficients[model.library.index(word), 1] = size
    model.set_coefficients(coefficients)
    found = logged_input_ranges(model, torch.tensor([[0.1, -0.4], [0.9, 0.4]]))
    assert found == {name: pytest.approx(ends) for name, ends in ranges.items()}


def test_flights_beyond_the_inputs_of_a_log_are_told_if_the_equations_bend_in_them():
    """A log of u from 0.1 to 0.9, with a twentieth of that to either side, knows of 0.06 to 0.94; of v any is known."""
    signature = Signature(("q",), ("rad",), ("v", "u"), (1.0,))
    model = SindyModel(signature, ["v", "u^2"])
    model.set_coefficients(torch.tensor([[1.0], [2.0]], dtype=torch.float64))
    logged = torch.tensor([[-0.1, 0.1], [0.1, 0.9]])

    def told(*flown):
        return inputs_beyond_log(model, logged, torch.tensor([[-1.0, 0.5], *([1.0, u] for u in flown)]))

    assert told(0.0601, 0.9399) == [] and told(0.06 - 1e-6, 0.94 + 1e-6) == []  # rounding is no flight
    for flown, ends in (((0.05,), (0.05, 0.5)), ((0.95,), (0.5, 0.95)), ((0.04, 0.96), (0.04, 0.96))):
        (said,) = told(*flown)
        both = {"low": ends[0], "high": ends[1], "least": 0.06, "most": 0.94}
        assert (said.code, said.severity) == ("forecast.beyond_inputs", "wrong")
        assert said.values == {"input": "u", **{name: pytest.approx(end, abs=1e-6) for name, end in both.items()}}


def test_the_steps_of_a_sensor_are_said_and_whether_they_are_coarse():
    t, walk = 0.01 * np.arange(1001), np.random.default_rng(0).normal(size=1001).cumsum()
    signature = Signature(("q", "w"), ("rad", "rpm"), ("u",), (1.0, 1.0))
    for step, coarse in ((0.02, True), (0.002, False)):
        x = torch.tensor(np.stack([step * np.round(np.sin(1.3 * t) / step), walk], -1))
        data = Transitions.from_trajectory(x, torch.zeros(1000, 1), 0.01)
        steps = {"state": "q", "unit": "rad", "step": pytest.approx(step), "coarse": coarse}
        assert recording_findings(data, signature) == [note("log.resolution", **steps)]


def test_targets_far_beyond_the_log_are_a_guess_if_the_equations_read_them():
    """A log of 1 rad to 3 rad knows targets from 0 rad to 4 rad; of the place of a motor any is as good."""
    model = SindyModel(Pendulum().signature, ["Omega", "u", "sin(theta)"], known={"theta": "Omega"})
    logged = torch.tensor([[1.0, math.nan], [3.0, math.nan]])

    def told(coefficient, low, high):
        coefficients = model.coefficients.clone()
        coefficients[model.library.index("sin(theta)"), 1] = coefficient
        model.set_coefficients(coefficients)
        return targets_beyond_log(model, logged, {"theta": (low, high), "Omega": (-9.0, 9.0)})

    assert told(-9.81, 0.1, 3.9) == told(0.0, -8.0, 8.0) == []
    for ends in ((-0.1, 2.0), (2.0, 4.1)):
        both = {"low": ends[0], "high": ends[1], "least": 1, "most": 3}
        assert told(-9.81, *ends) == [wrong("forecast.beyond_log", state="theta", unit="rad", **both)]


def test_an_input_moves_an_output_through_other_states():
    model = SindyModel(Pendulum().signature, ["Omega", "u", "sin(theta)"], known={"theta": "Omega"})
    coefficients = model.coefficients.clone()
    coefficients[1:, 1] = 0.0
    model.set_coefficients(coefficients)
    with pytest.raises(FindingError) as error:
        require_controlled(model, ["theta"])
    assert error.value.finding == wrong("model.uncontrolled", outputs=["theta"])
    coefficients[model.library.index("u"), 1] = 2.0
    model.set_coefficients(coefficients)
    require_controlled(model, ["theta", "Omega"])


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
