"""A benchmark of logs writes what a rig would, says what the user of a plant says, and scores flights by hand."""

import csv
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from benchmarks import unseen_plants
from benchmarks.logged import CASES, Case
from benchmarks.logs import COLUMNS, TARGETS, flown, rows_of, sizes_of, terms_of, words, write_log

import dynasindy
from dynasindy import Controller
from dynasindy.agents.networks import actor
from dynasindy.control.controller import ControlSetup
from dynasindy.sensing import Channel
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.tasks import RandomStep, Tracking, TrackingReward


def test_a_log_has_the_measured_states_alone(tmp_path):
    write_log(CASES["oven"], tmp_path / "log.csv", 0)
    with (tmp_path / "log.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["time [s]", "T [degC]", "u [-]"]
    values = np.array(rows, dtype=float)
    np.testing.assert_allclose(values[:, 0], 5.0 * np.arange(1800))
    np.testing.assert_allclose(10 * values[:, 1], (10 * values[:, 1]).round(), atol=1e-6)


def test_the_words_are_those_of_a_user(tmp_path):
    given = words(CASES["pole"], tmp_path / "log.csv")
    assert given[2:] == [
        "plant.outputs=[p,lean]",
        "plant.low=[-0.4,0]",
        "plant.high=[0.4,0]",
        "plant.known={p:v,lean:w}",
    ]
    assert words(CASES["tanks"], tmp_path)[-1].startswith("plant.library=")
    assert not any("known" in word for word in words(CASES["oven"], tmp_path))


class Given:
    """A controller whose input is what a function of measurement and target says."""

    def __init__(self, rule, names, units="rad/s"):
        signature = Signature(names, (units,) * len(names), ("u",), (100.0,) * len(names))
        task = Tracking(signature, RandomStep([0.0], [1.0]), [names[0]], [], TrackingReward((1.0,)))
        self.inner = Controller(actor(task.n_o, 1, (4,)), ControlSetup(task, 0.05))
        self.signature, self.dt, self.rule = self.inner.signature, 0.05, rule

    def reset(self):
        pass

    def act(self, y, r):
        return np.array([self.rule(y, r)])


def test_errors_are_those_at_the_end_in_ranges_of_the_targets():
    """What holds the fan at w is 250 (1 + u) = 2 w + 0.008 w^2 + 10; 10 rad/s beside it is a tenth of the range."""

    def feed(beside):
        def rule(y, r):
            w = r[0] + beside
            return (2 * w + 0.008 * w * w + 10) / 250 - 1

        return rule

    exact, beside = (flown(CASES["fan"], Given(feed(shift), ("w",)), 0) for shift in (0.0, 10.0))
    assert exact.shape == (TARGETS, 1)
    np.testing.assert_allclose(exact, 0.0, atol=1e-4)
    np.testing.assert_allclose(beside, 0.1, atol=1e-3)


def test_a_controller_reads_degrees_of_a_plant_in_its_own_radians():
    signature = Signature(("speed", "pitch"), ("rpm", "rad"), ("command",), (13.0, 0.5))
    read = SimpleNamespace(signature=signature)
    assert sizes_of(unseen_plants.CASES["turbine"], read) == {"speed": 1.0, "pitch": pytest.approx(math.pi / 180)}
    read.signature = Signature(("speed", "pitch"), ("rpm", "deg"), ("command",), (13.0, 30.0))
    assert sizes_of(unseen_plants.CASES["turbine"], read) == {"speed": 1.0, "pitch": 1.0}


def test_what_a_controller_reads_in_flight_is_in_its_own_radians():
    """A table turns by 30 deg/s for each 1 of the input; from 60 deg on an input of 0.5 takes it 0.75 deg a period."""
    table = Case(
        {"tilt": "deg"}, lambda x, u: (30 * u,), {"tilt": Channel()}, {"tilt": (60, 90)}, {}, 0.05, 1, 0.1, (1, 1)
    )
    table, read = replace(table, flight=0.2, start={"tilt": 60.0}), []

    def rule(y, r):
        read.append(y["tilt"])
        return 0.5

    flown(table, Given(rule, ("tilt",), "rad"), 0)
    turned = np.array([60.0, 60.75, 61.5, 62.25]) * math.pi / 180
    np.testing.assert_allclose(np.array(read).reshape(4, TARGETS), np.tile(turned[:, None], TARGETS), rtol=1e-12)
    read.clear()
    flown(table, Given(rule, ("tilt",), "deg"), 0)
    np.testing.assert_allclose(read[::TARGETS], [60.0, 60.75, 61.5, 62.25], rtol=1e-12)


def test_a_flight_that_runs_away_is_infinitely_wrong(monkeypatch):
    monkeypatch.setattr("benchmarks.logs.FAR", 100.0)
    assert np.isinf(flown(CASES["fan"], Given(lambda y, r: 1.0, ("w",)), 0)).all()


def test_a_controller_whose_numbers_leave_all_limits_loses_its_flight_and_no_other():
    """The policy gives what holds the fan at its target, and no number for targets above 90 rad/s."""

    def policy(shown):
        w = shown["task_params"][0, 0]
        u = (2 * w + 0.008 * w * w + 10) / 250 - 1
        return shown.set("action", torch.where(w > 90.0, math.nan, u).reshape(1).float())

    signature = Signature(("w",), ("rad/s",), ("u",), (100.0,))
    setup = ControlSetup(Tracking(signature, RandomStep([40.0], [140.0]), ["w"], [], TrackingReward((1.0,))), 0.05)
    rng = torch.Generator().manual_seed(1000)
    targets = 40 + 100 * torch.rand(TARGETS, 1, generator=rng, dtype=torch.float64).numpy()
    assert 0 < (targets > 90).sum() < TARGETS
    errors = flown(CASES["fan"], Controller(policy, setup), 0)
    np.testing.assert_array_equal(np.isinf(errors), targets > 90)
    np.testing.assert_allclose(errors[targets < 90], 0.0, atol=1e-4)


def test_a_controller_of_other_names_is_no_lost_flight():
    signature = Signature(("v",), ("rad/s",), ("u",), (100.0,))
    setup = ControlSetup(Tracking(signature, RandomStep([40.0], [140.0]), ["v"], [], TrackingReward((1.0,))), 0.05)
    given = Given(None, ("w",))
    given.act = Controller(actor(setup.task.n_o, 1, (4,)), setup).act
    with pytest.raises(ValueError, match="measurement has 'w', which does not exist"):
        flown(CASES["fan"], given, 0)


def test_a_row_holds_what_was_foretold_and_what_came_of_it():
    metrics = {"prediction": {"controlled": True, "score": 0.0123}}
    errors = np.array([[0.001, 0.02], [0.003, 0.04]])
    rows = rows_of("pole", 3, metrics, errors, 6, 12.34)
    assert [row["output"] for row in rows] == ["p", "lean"] and set(rows[0]) == set(COLUMNS)
    assert (rows[0]["error_percent"], rows[1]["worst_percent"], rows[0]["terms"]) == ("0.2", "4", 6)
    assert (rows[0]["foretold"], rows[0]["foretold_percent"]) == ("CONTROLLED", "1.23")
    (row,) = rows_of("fan", 0, None, np.full((1, 1), math.inf), 0, 1.0)
    assert (row["foretold"], row["error_percent"], row["terms"]) == ("no controller", "inf", 0)
    doubted = metrics | {"prediction": {"controlled": False, "score": None}}
    assert rows_of("fan", 0, doubted, torch.zeros(1, 1).numpy(), 0, 1.0)[0]["foretold"] == "NOT promised"


def test_the_equations_of_a_ball_on_a_beam_have_the_terms_of_the_plant_and_no_other(tmp_path):
    """The beam is set to a = 0.35 u with 0.06 s, and the ball rolls as v' = -7 sin(a) - 0.1 v.

    Angles stay below 0.13 rad in this log, where an angle and its sine differ by 0.3 % at most. Without the sine among
    the candidates, others come in for what it leaves over; and where it is in the wrong equation, the angle is, too.
    """
    write_log(CASES["beam"], tmp_path / "log.csv", 2)
    model = dynasindy.identify(dynasindy.read(tmp_path / "log.csv"), known={"r": "v"}, longest_delay=0.0)
    columns = zip(model.signature.state_names, model.coefficients.T.tolist(), strict=True)
    found = {state: {n: c for n, c in zip(model.library.names, column, strict=True) if c} for state, column in columns}
    assert found["r"] == {"v": 1.0}
    assert found["a"] == pytest.approx({"a": -1 / 0.06, "u": 0.35 / 0.06}, rel=0.005)
    assert found["v"] == pytest.approx({"sin(a)": -7.0, "v": -0.1}, rel=0.005)


def test_terms_are_counted_and_not_the_signs_inside_functions(tmp_path):
    """Both discs of a soft shaft, by the sine of the twist and by the same over a quotient: 1 + 1 + 3 + 2 terms."""
    units = ("rad", "rad", "rad/s", "rad/s")
    signature = Signature(("a", "b", "va", "vb"), units, ("u",), (1.0,) * 4)
    model = SindyModel(signature, "auto", known={"a": "va", "b": "vb"})
    given, xi = {"va": ("u", "sin(a - b)"), "vb": ("va", "sin(a - b)")}, model.coefficients.clone()
    for state, functions in given.items():
        for function in functions:
            xi[model.library.names.index(function), signature.state_index(state)] = 30.0
    xi[model.library.names.index("sin(a - b) /(1 + -0.3 cos(a - b)^2)"), signature.state_index("va")] = -9.5
    model.set_coefficients(xi)
    model.save(tmp_path / "model.json")
    assert terms_of(tmp_path / "model.json") == 7


def test_every_plant_has_a_log_a_task_and_sensors_that_fit():
    for case in CASES.values():
        assert set(case.sensors) | set(case.targets) | set(case.known) <= set(case.states)
        assert set(case.columns).union(*case.loop) <= set(case.sensors) and len(case.loop) <= len(case.inputs)
        assert all(low <= high for low, high in case.targets.values())
        assert case.begins.tolist() == [pytest.approx(case.start.get(name, 0.0)) for name in case.states]
