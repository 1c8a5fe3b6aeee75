"""A check holds what its parts find, and its record is plain numbers."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.evaluation.check import Settings, check, check_record
from dynasindy.evaluation.closed_loop import ClosedLoop
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature

SMALL = Settings((-0.4,), (0.4,), points=3, seconds=5.0, grid=3, draws=2)


def test_targets_are_the_grid_of_the_box():
    assert Settings((0.0, -1.0), (1.0, 1.0), points=2).targets.tolist() == [[0, -1], [0, 1], [1, -1], [1, 1]]
    assert Settings((0.0,), (1.0,), points=1).targets.tolist() == [[0.5]]


@pytest.mark.parametrize("wrong", [{"points": 51}, {"grid": 1}, {"draws": -1}, {"seconds": 0.0}, {"reach": math.inf}])
def test_what_cannot_be_tried_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Settings((0.0,), (1.0,), **wrong)


def test_what_is_tried_by_default_is_what_the_command_tries():
    told = OmegaConf.load(Path(__file__).parents[2] / "conf" / "check.yaml")
    of_the_run = ("low", "high", "start", "bounds")
    ours = {name: value for name, value in asdict(Settings((0.0,), (1.0,))).items() if name not in of_the_run}
    assert ours == {name: told[name] for name in ours}


def test_a_record_is_json_of_what_was_found(loops, carts):
    found = check(loops(model=carts(spring=1.0), observer={}), SMALL)
    held = json.loads(json.dumps(check_record(found), allow_nan=False))
    assert [row["target"]["p"] for row in held["targets"]] == pytest.approx([-0.4, 0.0, 0.4])
    assert all(row["stable"] and row["rests"] for row in held["targets"])
    # 2 (r - p) = p: two thirds of the way.
    assert held["targets"][2]["steady_error"]["p"] == pytest.approx(0.4 / 3, abs=3e-3)
    assert held["targets"][1]["margins"]["force"]["gain"] == pytest.approx(found.margins[1][0].gain)
    assert len(held["changes"]) == 2
    assert held["recovery"] == [{"states": ["p", "v"], "share": 1.0, "steady_error": {"p": pytest.approx(0.0)}}]
    assert found.sensors.tolist() == pytest.approx([0.01, 0.0])
    assert held["settings"]["low"] == [-0.4]


@pytest.mark.parametrize("points", [1, 2, 3, 4])
def test_errors_lie_around_the_middle_of_the_range_however_many_targets_there_are(loops, carts, points):
    """Under 2 (r - p) = p the cart rests at two thirds of its target: 0.1 m short of 0.3 m, halfway from 0 to 0.6."""
    settings = Settings((0.0,), (0.6,), points=points, seconds=10.0, grid=3, draws=0)
    found = check(loops(model=carts(spring=1.0)), settings)
    assert found.settings.ends.mean(0).tolist() == pytest.approx([0.3])
    assert found.planes[0].steady_error.tolist() == pytest.approx([0.1], abs=1e-3)


def test_flights_are_as_many_control_periods_for_a_slow_plant(loops):
    loop = loops()
    found = check(loop, replace(SMALL, seconds=None, points=1, draws=0))
    assert found.steps.u.shape[1] == 400 and found.seconds == pytest.approx(400 * loop.dt)
    assert check_record(found)["settings"]["seconds"] == pytest.approx(400 * loop.dt)


def test_a_loop_that_is_not_stable_has_no_margins(loops, law):
    found = check(loops(law(-1.0, 0.0)), SMALL)
    assert not found.stable.any() and not any(found.margins) and found.noise == [None] * 3
    held = check_record(found)
    assert held["targets"][0]["noise_to_input"] is None and held["targets"][0]["spectral_radius"] > 1
    assert held["targets"][0]["steady_error"]["p"] > 1


@pytest.mark.parametrize(
    ("start", "bounds", "begin", "told"),
    [
        ({}, {}, [0.0, 0.0], "the origin"),
        ({}, {"p": 0.5}, [0.0, 0.0], "the origin"),
        ({"p": [0.1, 0.3]}, {"p": [0.05, 0.5]}, [0.2, 0.0], "p = 0.2 m"),
        ({}, {"p": [0.05, 0.5]}, [0.3, 0.0], "p = 0.3 m"),  # a cart rests wherever it stands
    ],
)
def test_steps_begin_where_the_run_begins_or_within_its_bounds(loops, start, bounds, begin, told):
    settings = Settings((0.2,), (0.4,), points=3, seconds=4.0, grid=3, draws=1, start=start, bounds=bounds)
    found = check(loops(), settings)
    expected = torch.tensor(begin, dtype=torch.float64)
    for flights in (found.steps, found.drawn):
        torch.testing.assert_close(flights.x[:, 0], expected.expand(len(flights.x), -1))
    assert found.beginning() == told
    assert abs(float(found.targets[found.farthest, 0]) - begin[0]) == pytest.approx(max(0.4 - begin[0], begin[0] - 0.2))


CARTS = {"a": (0.3, 0.9, 2.0, 2.5), "b": (0.1, 0.4, 3.5, 3.0)}
"""Dry friction and spring of each cart, and the gains of its law."""


def side_by_side(*names):
    """Return carts on rails of their own, each with its law and its sensor: p' = v, v' = f - c tanh(20 v) - s p."""
    states = {f"{kind}_{name}": unit for name in names for kind, unit in (("p", "m"), ("v", "m/s"))}
    forces, n = [f"f_{name}" for name in names], len(names)
    signature = Signature(tuple(states), tuple(states.values()), tuple(forces), (2.0, 3.0) * n)
    terms = [[f"f_{name}", f"tanh(20 v_{name})", f"p_{name}"] for name in names]
    offered = [f"v_{name}" for name in names] + [term for own in terms for term in own]
    model = SindyModel(signature, offered, known={f"p_{name}": f"v_{name}" for name in names})
    xi = torch.zeros(len(model.library), 2 * n, dtype=torch.float64)
    for i, name in enumerate(names):
        friction, spring, *_ = CARTS[name]
        xi[model.library.index(f"v_{name}"), 2 * i] = 1.0
        numbers = (1.0, -friction, -spring)
        for term, number in zip(terms[i], numbers):
            xi[model.library.index(term), 2 * i + 1] = number
    model.set_coefficients(xi)
    outputs = [f"p_{name}" for name in names]
    reward = TrackingReward((1.0,) * n)
    task = Tracking(signature, Step([[0.0] * n]), outputs, [f"v_{name}" for name in names], reward, error_scale=0.7)

    def law(tensordict):
        seen = tensordict["observation"]
        k_p, k_v = torch.tensor([CARTS[name][2:] for name in names], dtype=seen.dtype).mT
        return tensordict.set("action", k_p * 0.7 * seen[..., 2 * n :] - k_v * 3.0 * seen[..., 1 : 2 * n : 2])

    setup = ControlSetup(task, 0.1, 2, None)
    sensors = Sensors({output: {"noise": 0.01} for output in outputs}, rates={f"p_{k}": f"v_{k}" for k in names})
    observer = Observer(model, sensors, setup)
    observer.load_state_dict({"process_noise": [0.01, 0.05] * n, "nis": 1.0})
    return ClosedLoop(Controller(law, setup, observer, None), model, 0.05)


def test_carts_on_rails_of_their_own_are_judged_together_as_each_alone():
    given = {"a": (-0.4, 0.6), "b": (0.2, 0.5)}

    def checked(*names):
        ends = tuple(zip(*(given[name] for name in names)))
        bounds = {f"p_{name}": [0.1, 0.9] for name in names}
        return check(side_by_side(*names), Settings(*ends, points=2, seconds=2.5, grid=2, draws=0, bounds=bounds))

    both, alone = checked("a", "b"), {name: checked(name) for name in "ab"}
    assert both.targets.tolist() == [[-0.4, 0.2], [-0.4, 0.5], [0.6, 0.2], [0.6, 0.5]]
    assert both.stable.all() and all(found.stable.all() for found in alone.values())
    close = {"rtol": 1e-5, "atol": 1e-6}
    for i, found in enumerate(alone.values()):
        mine = [2 * i, 2 * i + 1]
        torch.testing.assert_close(both.begin[mine], found.begin, **close)
        assert both.sensors[mine].tolist() == found.sensors.tolist()
        for k, target in enumerate(both.targets[:, i].tolist()):
            own = found.targets.flatten().tolist().index(target)
            torch.testing.assert_close(both.rest.error[k, i], found.rest.error[own, 0], **close)
            torch.testing.assert_close(both.rest.u[k, i], found.rest.u[own, 0], **close)
            margins, single = both.margins[k], found.margins[own]
            assert len(margins) == 2 and len(single) == 1
            assert asdict(margins[i]) == pytest.approx(asdict(single[0]), rel=1e-3, abs=1e-6)
            assert both.noise[k][i, mine].tolist() == pytest.approx(found.noise[own][0].tolist(), rel=1e-5)
            assert both.noise[k][i, [2 - 2 * i, 3 - 2 * i]].max() < 1e-12  # of the other cart
            torch.testing.assert_close(both.steps.x[k][:, mine], found.steps.x[own], **close)
            torch.testing.assert_close(both.steps.u[k][:, i], found.steps.u[own][:, 0], **close)
        (plane,) = found.planes
        torch.testing.assert_close(both.planes[i].steady_error[i], plane.steady_error[0], **close)
    assert len(both.planes) == 3  # the last one of both positions
