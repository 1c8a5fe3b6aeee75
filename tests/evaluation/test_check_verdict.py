"""A finding keeps its threshold or not, and says which figure it is."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from dynasindy.evaluation.check import (
    Settings,
    Thresholds,
    check,
    check_verdict,
    thin_margin,
    unstable_targets,
)
from dynasindy.evaluation.closed_loop import LoopSimulation
from dynasindy.evaluation.linear_loop import Margins
from dynasindy.sentences import REMEDIES, SENTENCES

SMALL = Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2)


@pytest.fixture(scope="module")
def good(loops):
    return check(loops(observer={}), SMALL)


def composed():
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base="1.3"):
        return compose("train", ["system=xi"])


def by_name(found, thresholds=None):
    return {each.code.removeprefix("check."): each for each in check_verdict(found, thresholds)}


def good_ones(found):
    return {name for name, each in found.items() if each.severity == "note"}


def test_a_cart_with_a_sound_law_is_sound(good):
    found = by_name(good)
    assert len(found) == 12 and good_ones(found) >= {*found} - {"noise"}
    assert found["recovery"].values["shares"] == {"p and v": 1.0}
    assert all(str(each) for each in found.values())


def test_a_stable_loop_is_as_slow_as_its_largest_eigenvalue(loops):
    # u = -2 p - 2.5 v on a double integrator: what is left after t is exp(-t / 0.73 s).
    a = np.array([[1.0, 0.1], [0.0, 1.0]]) - np.array([[0.005], [0.1]]) @ np.array([[2.0, 2.5]])
    slowest = -0.1 / np.log(np.abs(np.linalg.eigvals(a)).max())
    assert by_name(check(loops(), SMALL))["stability"].values["slowest"] == pytest.approx(slowest, rel=1e-6)


def test_noise_is_weak_beyond_its_threshold_only_and_none_where_the_file_states_none(good, loops):
    # A deviation of 0.01 m at a gain of 4 per metre, whatever the other target: 0.04.
    noisy = replace(good, noise=[np.array([[3.0, 0.0]]), np.array([[4.0, 0.0]])], sensors=np.array([0.01, 0.0]))
    for limit, sound in ((0.05, True), (0.03, False)):
        found = by_name(noisy, Thresholds(noise=limit))["noise"]
        assert (found.severity == "note") is sound and found.values["value"] == pytest.approx(0.04)
    silent = by_name(check(loops(), SMALL))["noise"]
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


def test_the_threshold_of_the_steady_error_has_the_unit_of_its_value(good):
    # Nothing is said of the range of targets, so p counts by 2 m: a tenth of that is 0.2 m.
    found = by_name(good, Thresholds(error=0.1))
    for name in ("steady_error", "coefficients"):
        values = found[name].values
        assert (values["output"], values["unit"], values["size"]) == ("p", "m", 2.0)
        assert values["limit"] == pytest.approx(0.2) and values["share"] == pytest.approx(values["error"] / 2)


def test_an_unstable_loop_says_so_first_and_where(loops, law):
    findings = check_verdict(check(loops(law(-1.0, 0.0)), SMALL))
    first = findings[0]
    assert (first.code, first.severity) == ("check.stability", "wrong")
    assert (first.values["unstable"], first.values["targets"], first.values["target"]) == (2, 2, [-0.4])
    assert not any("margin" in each.code for each in findings) and str(first)


def test_drawn_plants_without_a_rest_or_that_run_away_in_flight_are_counted(good):
    others = good.spread
    restless = replace(others, worst=others.worst.clone(), farthest=others.farthest.clone())
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
    cfg = OmegaConf.to_container(composed())
    assert {code for code in SENTENCES if code.startswith("check.")} == {*REMEDIES}
    for remedy in REMEDIES.values():
        for key in re.findall(r"<((?:\w+\.)+\w+)=", remedy):
            node = cfg
            for step in key.split("."):
                node = node[step]


def test_small_swings_are_told_with_their_size_and_forbid_no_flight(loops, carts, law):
    # The weakest swing of test_loop_simulation.py: the input is held, which takes more damping than there is.
    circling = check(loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), SMALL)
    swing = float(circling.swings.outputs.max())
    assert 0.005 < swing < 0.2
    for limit, severity in ((1.01 * swing, "weak"), (0.0, "wrong")):
        limits = Thresholds(swing=limit)
        first = check_verdict(circling, limits)[0]
        assert bool(unstable_targets(circling, limits).any()) == (limit == 0)
        assert first.severity == severity and first.values["swing"]["error"] == pytest.approx(swing)


@pytest.mark.parametrize("k_v", [2.5, 14.0, 25.0])
def test_a_thin_disk_margin_at_the_targets_is_said(loops, law, k_v):
    loop = loops(law(2.0, k_v))
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
