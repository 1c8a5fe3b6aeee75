"""A check holds what its parts find, and each finding keeps its threshold or not."""

import json
import math
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from carts import Law, make_cart, make_loop
from configs import composed
from omegaconf import OmegaConf

from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.evaluation.check import (
    Settings,
    Thresholds,
    _spread,
    _variants,
    check,
    check_record,
    check_verdict,
    thin_margin,
    unstable_targets,
)
from dynasindy.evaluation.closed_loop import ClosedLoop, LoopSimulation
from dynasindy.evaluation.linear_loop import Margins, find_rest
from dynasindy.sentences import REMEDIES, SENTENCES, check_lines
from dynasindy.sindy import Refinement, SindyModel
from dynasindy.sindy.covariance import Covariance
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

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
    of_the_run = ("low", "high")
    ours = {name: value for name, value in asdict(Settings((0.0,), (1.0,))).items() if name not in of_the_run}
    assert ours == {name: told[name] for name in ours}


def test_a_record_is_json_of_what_was_found():
    found = check(make_loop(model=make_cart(spring=1.0), observer={}), SMALL)
    assert "control.dry_friction" not in {each.code for each in check_verdict(found)}
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
def test_errors_lie_around_the_middle_of_the_range_however_many_targets_there_are(points):
    """Under 2 (r - p) = p the cart rests at two thirds of its target: 0.1 m short of 0.3 m, halfway from 0 to 0.6."""
    settings = Settings((0.0,), (0.6,), points=points, seconds=10.0, grid=3, draws=0)
    found = check(make_loop(model=make_cart(spring=1.0)), settings)
    assert found.settings.ends.mean(0).tolist() == pytest.approx([0.3])
    assert found.planes[0].steady_error.tolist() == pytest.approx([0.1], abs=1e-3)


def test_flights_are_as_many_control_periods_for_a_slow_plant():
    loop = make_loop()
    found = check(loop, replace(SMALL, seconds=None, points=1, draws=0))
    assert found.steps.u.shape[1] == 400 and found.seconds == pytest.approx(400 * loop.dt)
    assert check_record(found)["settings"]["seconds"] == pytest.approx(400 * loop.dt)


def test_a_loop_that_is_not_stable_has_no_margins():
    found = check(make_loop(Law(-1.0, 0.0)), SMALL)
    assert not found.stable.any() and not any(found.margins) and found.noise == [None] * 3
    held = check_record(found)
    assert held["targets"][0]["noise_to_input"] is None and held["targets"][0]["spectral_radius"] > 1
    assert held["targets"][0]["steady_error"]["p"] > 1


@pytest.mark.parametrize(("start", "begin"), [(None, [0.0, 0.0]), ({"p": [0.1, 0.3], "v": -1.0}, [0.2, -1.0])])
def test_steps_begin_where_episodes_of_the_plan_do(start, begin):
    found = check(make_loop(start=start), Settings((0.2,), (0.4,), points=3, seconds=4.0, grid=3, draws=1))
    for flights in (found.steps, found.drawn):
        torch.testing.assert_close(flights.x[:, 0], torch.tensor([begin] * len(flights.x), dtype=torch.float64))
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
        return check(side_by_side(*names), Settings(*ends, points=2, seconds=2.5, grid=2, draws=0))

    both, alone = checked("a", "b"), {name: checked(name) for name in "ab"}
    assert both.targets.tolist() == [[-0.4, 0.2], [-0.4, 0.5], [0.6, 0.2], [0.6, 0.5]]
    assert both.stable.all() and all(found.stable.all() for found in alone.values())
    (told,) = (each for each in check_verdict(both) if each.code == "control.dry_friction")
    assert told.values["states"] == ["v_a", "v_b"]
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


TWO_TARGETS = Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2)


@pytest.fixture(scope="module")
def good():
    return check(make_loop(observer={}), TWO_TARGETS)


def by_name(found, thresholds=None):
    return {each.code.removeprefix("check."): each for each in check_verdict(found, thresholds)}


def good_ones(found):
    return {name for name, each in found.items() if each.severity == "note"}


def test_a_cart_with_a_sound_law_is_sound(good):
    found = by_name(good)
    assert len(found) == 12 and good_ones(found) >= {*found} - {"noise"}
    assert found["recovery"].values["shares"] == {"p and v": 1.0}
    assert all(str(each) for each in found.values())


def test_a_stable_loop_is_as_slow_as_its_largest_eigenvalue():
    # u = -2 p - 2.5 v on a double integrator: what is left after t is exp(-t / 0.73 s).
    a = np.array([[1.0, 0.1], [0.0, 1.0]]) - np.array([[0.005], [0.1]]) @ np.array([[2.0, 2.5]])
    slowest = -0.1 / np.log(np.abs(np.linalg.eigvals(a)).max())
    assert by_name(check(make_loop(), TWO_TARGETS))["stability"].values["slowest"] == pytest.approx(slowest, rel=1e-6)


def test_noise_is_weak_beyond_its_threshold_only_and_none_where_the_file_states_none(good):
    # A deviation of 0.01 m at a gain of 4 per metre, whatever the other target: 0.04.
    noisy = replace(good, noise=[np.array([[3.0, 0.0]]), np.array([[4.0, 0.0]])], sensors=np.array([0.01, 0.0]))
    for limit, sound in ((0.05, True), (0.03, False)):
        found = by_name(noisy, Thresholds(noise=limit))["noise"]
        assert (found.severity == "note") is sound and found.values["value"] == pytest.approx(0.04)
    silent = by_name(check(make_loop(), TWO_TARGETS))["noise"]
    assert silent.severity == "note" and silent.values["known"] is False


def test_the_largest_slew_and_saturation_over_the_targets_decide(good):
    u = torch.zeros(2, 4, 1, dtype=torch.float64)
    u[1, :2, 0] = torch.tensor([-0.5, 1.0])  # of the second target
    steps = LoopSimulation(torch.zeros(2, 5, 2).double(), u, torch.zeros(2, 1), [0], 0.1, torch.tensor([[-1.0], [1.0]]))
    found = by_name(replace(good, steps=steps, settings=replace(good.settings, seconds=0.4)))
    assert found["slew"].values["value"] == pytest.approx(1.5) and found["slew"].values["input"] == "force"
    assert (found["saturation"].values["value"], found["saturation"].values["seconds"]) == pytest.approx((0.25, 0.4))
    assert not {"slew", "saturation"} & good_ones(found)


@pytest.mark.parametrize(
    ("changed", "name", "value"),
    [
        ({"gain": 1.9}, "gain_margin", 1.9),
        ({"lower": 0.6}, "gain_reduction", 1 / 0.6),
        ({"phase": 29.0}, "phase_margin", 29.0),
        ({"delay": 0.09}, "delay_margin", 0.9),
        ({"disk": 0.4}, "disk_margin", 0.4),
    ],
)
def test_the_least_margin_over_targets_decides(good, changed, name, value):
    sound = Margins(3.0, 0.2, 60.0, 0.5, 1.0)
    found = by_name(replace(good, margins=[[sound], [replace(sound, **changed)]]))
    assert {other for other in found if "margin" in other or "reduction" in other} - good_ones(found) == {name}
    values = found[name].values
    assert (values["input"], values["target"]) == ("force", [0.4]) and values["value"] == pytest.approx(value)


def test_weak_targets_are_to_be_left_out_where_a_narrower_range_does_that():
    found = check(make_loop(observer={}), replace(SMALL, points=7, draws=0))
    sound = found.margins[0][0]
    for weak, left_out in (([0], True), ([6], True), ([3], False), ([0, 3], False)):
        margins = [[replace(sound, phase=5.0) if k in weak else sound] for k in range(7)]
        told = check_lines(check_verdict(replace(found, margins=margins)))
        assert [("low=" in line) for line in told if "WEAK" in line and "phase" in line] == [left_out]


def test_the_threshold_of_the_steady_error_has_the_unit_of_its_value(good):
    # Nothing is said of the range of targets, so p counts by 2 m: a tenth of that is 0.2 m.
    found = by_name(good, Thresholds(error=0.1))
    for name in ("steady_error", "coefficients"):
        values = found[name].values
        assert (values["output"], values["unit"], values["size"]) == ("p", "m", 2.0)
        assert values["limit"] == pytest.approx(0.2) and values["share"] == pytest.approx(values["error"] / 2)


def test_an_unstable_loop_says_so_first_and_where():
    findings = check_verdict(check(make_loop(Law(-1.0, 0.0)), TWO_TARGETS))
    first = findings[0]
    assert (first.code, first.severity) == ("check.stability", "wrong")
    assert (first.values["unstable"], first.values["targets"], first.values["target"]) == (2, 2, [-0.4])
    assert not any("margin" in each.code for each in findings) and str(first)


def test_drawn_plants_without_a_rest_or_that_run_away_in_flight_are_counted(good):
    others = good.spread
    restless = others._replace(worst=others.worst.clone(), farthest=others.farthest.clone())
    restless.worst[1], restless.farthest[1] = 1.3, 7.0
    found = by_name(replace(good, spread=restless))["coefficients"].values
    assert found["unstable"] == 1 and found["error"] < 7
    restless.worst[:] = 2.0
    restless.worst[0] = torch.inf
    both = by_name(replace(good, spread=restless))["coefficients"]
    assert both.values["unstable"] == 2 and both.severity == "weak" and str(both)
    assert by_name(good)["coefficients"].values["ran_away"] == 0
    flown = replace(good.drawn, x=good.drawn.x.clone())
    flown.x[0, -1, 0] = 50.0
    away = by_name(replace(good, drawn=flown))["coefficients"]
    assert away.values["ran_away"] == 1 and away.severity == "weak"


def test_every_finding_that_may_be_weak_has_a_remedy_whose_settings_exist():
    cfg = OmegaConf.to_container(composed("train", "system=xi"))
    assert {code for code in SENTENCES if code.startswith("check.")} == {*REMEDIES}
    for remedy in REMEDIES.values():
        for key in re.findall(r"<((?:\w+\.)+\w+)=", remedy):
            node = cfg
            for step in key.split("."):
                node = node[step]


def test_small_swings_are_told_with_their_size_and_forbid_no_flight():
    # The weakest swing of test_loop_simulation.py: the input is held, which takes more damping than there is.
    circling = check(make_loop(Law(40.0, 1.0, limit=1.0), make_cart(friction=0.8)), TWO_TARGETS)
    swing = float(circling.swings.outputs.max())
    assert 0.005 < swing < 0.2
    for limit, severity in ((1.01 * swing, "weak"), (0.0, "wrong")):
        limits = Thresholds(swing=limit)
        first = check_verdict(circling, limits)[0]
        assert bool(unstable_targets(circling, limits).any()) == (limit == 0)
        assert first.severity == severity and first.values["swing"]["error"] == pytest.approx(swing)


@pytest.mark.parametrize("k_v", [2.5, 14.0, 25.0])
def test_a_thin_disk_margin_at_the_targets_is_said(k_v):
    loop = make_loop(Law(2.0, k_v))
    loop.controller.setup.task.ends = ((-0.4,), (0.8,))
    found = thin_margin(loop.controller, loop.model)
    # Of u = -K x on x+ = A x + B u, a double integrator under held inputs, by a grid of S = 1 / (1 + K (z - A)^-1 B).
    a, b, k = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), np.array([[2.0, k_v]])
    z = np.exp(1j * np.linspace(1e-3, math.pi, 20_000))[:, None, None]
    s = 1 / (1 + k @ np.linalg.solve(z * np.eye(2) - a, np.broadcast_to(b, (len(z), 2, 1))))[:, 0, 0]
    disk = 1 / np.abs(s - 0.5).max() if np.abs(np.linalg.eigvals(a - b @ k)).max() < 1 else 0.0
    assert bool(found) == (disk < 0.5)
    for each in found:
        values = each.values
        assert each.severity == "weak" and values["input"] == "force" and -0.4 <= values["target"][0] <= 0.8
        assert values["value"] == pytest.approx(disk, rel=1e-3)


def test_coefficients_of_the_data_are_drawn_and_no_other():
    model = make_cart(friction=0.5, spring=2.0)
    found = _variants(model, 4, 0)[0]
    share = (found[:, :, 1] / model.coefficients[:, 1] - 1).abs()
    assert 0 < float(share.max()) <= 0.05
    np.testing.assert_array_equal(found[:, :, 0], model.coefficients[:, 0].expand(4, -1))


def test_draws_spread_and_go_together_as_the_covariance_of_the_fit_says():
    model = make_cart(friction=0.5, spring=2.0)
    assert _variants(model, 1, 1)[1] == "each within 5 % of itself, as the model tells no standard errors"
    wanted = torch.tensor([[0.01, -0.009], [-0.009, 0.04]], dtype=torch.float64)
    places = torch.tensor([1, 2]), torch.tensor([1, 1])  # friction and spring
    model.covariance = Covariance(*places, torch.linalg.cholesky(wanted))
    drawn, how = _variants(model, 4000, 1)
    np.testing.assert_allclose(torch.cov(drawn[:, 1:, 1].mT), wanted, rtol=0.1)
    assert drawn[:, 0].std(0).max() == drawn[:, :, 0].std(0).max() == 0  # what is known, and what was not fitted
    assert how == "from the covariance of the fit, with standard errors of 10 to 20 %"


def test_how_a_disturbance_fades_is_not_drawn():
    """d pushes y and no input moves it: were its -0.1 drawn, +-0.2, no controller could stop what grows."""
    plant = Signature(("y", "d"), ("-", "-"), ("u",), (1.0, 1.0))
    model = SindyModel(plant, ["y", "d", "u"])
    model.set_coefficients(torch.tensor([[-1.0, 0.0], [1.0, -0.1], [3.0, 0.0]], dtype=torch.float64))
    model.covariance = Covariance(torch.tensor([0, 1]), torch.tensor([0, 1]), 0.2 * torch.eye(2, dtype=torch.float64))
    spread = _variants(model, 100, 0)[0].std(0)
    assert spread[0, 0] > 0.1 and spread[:, 1].max() == 0


@pytest.mark.parametrize("method", [None, "integral", "trajectory", "one_step"])
def test_equations_that_are_all_given_have_no_uncertainty(method):
    u = torch.rand(200, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    x = torch.cat([u[:1] * 0, (0.1 * u).cumsum(0)])
    data = Transitions(x[:-1], u, x[1:], 0.1, torch.zeros(200, dtype=torch.long))
    refinement = None if method is None else Refinement(method)
    plant = Signature(("a",), ("-",), ("u",), (1.0,))
    model = SindyModel(plant, ["a", "u"], known={"a": "u"}, refinement=refinement)
    assert model.fit(data).accuracy == [] and model.covariance is None and model.equations() == ["a' = u"]
    assert torch.equal(_variants(model, 3, seed=0)[0], model.coefficients.expand(3, 2, 1))


def test_error_and_eigenvalues_with_other_plants_are_those_of_paper():
    # Rest at p = 2 r b / (s + 2 b) with the force's coefficient b and the spring s.
    model = make_cart(spring=1.0)
    loop, r = make_loop(model=model), torch.tensor([[0.3], [0.0]])
    plants = [(1.2, 1.0), (0.8, 1.0), (1.0, 1.2), (1.0, 0.8)]
    xi = model.coefficients.expand(4, -1, -1).clone()
    xi[:, [0, 2], 1] *= torch.tensor(plants).double()
    found = _spread(loop, r, find_rest(loop, r), xi)
    for k, (b, s) in enumerate(plants):
        assert found.farthest[k].item() == pytest.approx(0.3 - 0.6 * b / (s + 2 * b), abs=1e-7)
        flow = torch.linalg.matrix_exp(0.1 * torch.tensor([[0.0, 1.0, 0.0], [-s, 0.0, b], [0.0, 0.0, 0.0]])).double()
        closed = flow[:2, :2].numpy() + flow[:2, 2:].numpy() @ np.array([[-2.0, -2.5]])
        assert found.worst[k].item() == pytest.approx(np.abs(np.linalg.eigvals(closed)).max(), abs=1e-5)
    none = _spread(loop, r[:0], find_rest(loop, r).select(torch.zeros(2, dtype=torch.bool)), xi)
    assert none.worst.tolist() == [math.inf] * 4  # no target is held
