"""A finding keeps its threshold or not, and says which figure it is."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from dynasindy.checking.check import Settings, check
from dynasindy.checking.linear_loop import Margins
from dynasindy.checking.simulation import LargeSignalMargins, LoopSimulation
from dynasindy.checking.uncertainty import Drawing
from dynasindy.checking.verdict import CheckFinding, Thresholds, check_verdict, in_figures, in_short, unstable_targets

SMALL = Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2)


@pytest.fixture(scope="module")
def good(loops):
    return check(loops(observer={}), SMALL)


def composed():
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base="1.3"):
        return compose("train", ["system=xi"])


def by_name(found, thresholds=None):
    return {each.name: each for each in check_verdict(found, thresholds)}


def test_a_cart_with_a_sound_law_is_sound(good):
    found = by_name(good)
    assert len(found) == 14
    assert [name for name, each in found.items() if not each.good] == ["noise"] or all(f.good for f in found.values())
    assert "spectral" in found["stability"].words
    assert found["recovery"].words.startswith(
        "comes back from errors of up to 1 times the typical size of each state: 100 % in p and v, of 9 errors in each"
    )


def test_a_stable_loop_is_as_slow_as_its_largest_eigenvalue(loops):
    # u = -2 p - 2.5 v on a double integrator: what is left after t is exp(-t / 0.73 s).
    a = np.array([[1.0, 0.1], [0.0, 1.0]]) - np.array([[0.005], [0.1]]) @ np.array([[2.0, 2.5]])
    slowest = -0.1 / np.log(np.abs(np.linalg.eigvals(a)).max())
    words = by_name(check(loops(), SMALL))["stability"].words
    assert f"plant and controller together dies out with a time constant of {slowest:.2g} s, which is -dt / ln" in words
    assert "period" in words


def test_findings_come_in_the_order_of_what_they_build_on(good):
    assert list(by_name(good)) == [
        *("stability", "gain margin", "gain reduction", "phase margin", "delay margin", "disk margin", "noise"),
        *("steady error", "slew", "saturation", "one coefficient", "all coefficients", "settling", "recovery"),
    ]


def test_noise_is_weak_beyond_its_threshold_only_and_none_where_the_file_states_none(good, loops):
    # A deviation of 0.01 m at a gain of 4 per metre, whatever the other target: 0.04.
    noisy = replace(good, noise=[np.array([[3.0, 0.0]]), np.array([[4.0, 0.0]])], sensors=np.array([0.01, 0.0]))
    for limit, sound in ((0.05, True), (0.03, False)):
        found = by_name(noisy, Thresholds(noise=limit))["noise"]
        assert found.good is sound and "deviation" in found.words
    silent = by_name(check(loops(), SMALL))["noise"]
    assert silent.good is None and not silent.weak
    assert str(silent).startswith("?     noise: not known, as the controller's file states no noise")


def test_what_is_not_known_is_no_weakness_and_is_summed_up(loops):
    found = check(loops(), SMALL)
    findings = [CheckFinding("slew", True, ""), *(each for each in check_verdict(found) if each.name == "noise")]
    assert in_short(found, findings) == "In short: stable at all 2 targets, and no finding is weak; not known: noise."
    figures = in_figures(found, findings)
    assert figures["unknown"] == ["noise"] and figures["weak"] == []


def test_the_largest_slew_and_saturation_over_the_targets_decide(good):
    u = torch.zeros(2, 4, 1, dtype=torch.float64)
    u[1, :2, 0] = torch.tensor([-0.5, 1.0])  # of the second target
    steps = LoopSimulation(torch.zeros(2, 5, 2).double(), u, torch.zeros(2, 1), [0], 0.1, torch.tensor([[-1.0], [1.0]]))
    found = by_name(replace(good, steps=steps, settings=replace(good.settings, seconds=0.4)))
    assert found["slew"].words.startswith("in steps from the origin force changes by up to 1.50 in a control period")
    assert found["saturation"].words.startswith(
        "in steps from the origin force is at its limit for up to 25 % of 0.4 s"
    )
    assert not found["slew"].good and not found["saturation"].good


def test_a_threshold_of_one_control_period_is_singular(good):
    for limit, words in ((1.0, "threshold: 1 control period"), (2.0, "threshold: 2 control periods")):
        assert by_name(good, Thresholds(delay=limit))["delay margin"].words.endswith(words)


@pytest.mark.parametrize(
    ("changed", "name", "words"),
    [
        ({"gain": 1.9}, "gain margin", "the least is 1.90 (5.6 dB) of force at (0.4); threshold: 2 (6 dB)"),
        ({"lower": 0.6}, "gain reduction", "may fall to 0.60 of force at (0.4); threshold: 0.5"),
        ({"phase": 29.0}, "phase margin", "the least is 29 deg of force at (0.4); threshold: 30 deg"),
        ({"delay": 0.09}, "delay margin", "the least is 0.90 control periods, 90 ms, of force at (0.4); threshold: 1 "),
        ({"disk": 0.4}, "disk margin", "the least is 0.40 of force at (0.4); threshold: 0.5"),
    ],
)
def test_the_least_margin_over_targets_decides(good, changed, name, words):
    sound = Margins(3.0, 0.2, 60.0, 0.5, 1.0)
    found = by_name(replace(good, margins=[[sound], [replace(sound, **changed)]]))
    assert not found[name].good and words in found[name].words
    assert all(each.good for other, each in found.items() if "margin" in other and other != name)


@pytest.mark.parametrize(("gain", "words"), [(2.0, "2 (6 dB)"), (3.0, "3 (9.5 dB)"), (4.0, "4 (12 dB)")])
def test_the_threshold_of_the_gain_is_told_in_decibels(good, gain, words):
    assert by_name(good, Thresholds(gain=gain))["gain margin"].words.endswith(f"threshold: {words}")


def test_thresholds_are_those_that_are_given(good):
    strict = Thresholds(error=1e-9, recovered=1.1, noise=0.0, slew=0.0, saturated=-1.0)
    found = by_name(good, strict)
    names = ("steady error", "recovery", "noise", "slew", "saturation")
    assert not any(found[name].good for name in names)
    assert found["noise"].words.endswith("threshold: 0")


def test_the_threshold_of_the_steady_error_has_the_unit_of_its_value(good):
    # p counts by 2 m: a tenth of that is 0.2 m.
    words = by_name(good, Thresholds(error=0.1))["steady error"].words
    assert words.startswith("in steps from the origin at most ") and " m of p; " in words
    assert words.endswith("threshold: 0.2 m, 10 % of 2 m, the typical size of p")
    assert by_name(good, Thresholds(error=0.1))["all coefficients"].words.endswith(
        "stable, 0.2 m, 10 % of 2 m, the typical size of p"
    )


def test_an_unstable_loop_says_so_first_and_where(loops, law):
    lines = check_verdict(check(loops(law(-1.0, 0.0)), SMALL))
    assert lines[0].name == "stability" and not lines[0].good
    assert lines[0].words.startswith("NOT stable at 2 of 2 targets of p, such as (-0.4); flown there for 40 s, p ends")
    assert "thresholds" in lines[0].words
    assert not any("margin" in each.name for each in lines)


def test_the_only_target_without_a_stable_loop_is_the_one_that_is_named(good):
    unstable_targets = replace(good, rest=replace(good.rest, still=torch.tensor([True, False])))
    assert by_name(unstable_targets)["stability"].words.startswith(
        "NOT stable at 1 of 2 targets of p, (0.4); at 1 of these targets there is no rest"
    )


def test_a_coefficient_that_makes_it_unstable_is_named(loops, carts, law):
    # u = -18 v holds v while 18 b dt < 2; with b = 1.2 it is too much.
    found = by_name(check(loops(law(1.0, 18.0), carts()), SMALL))
    assert found["stability"].good and not found["one coefficient"].good
    words = found["one coefficient"].words
    assert words.startswith("2 plants from 1 coefficient, 20 % up and down, one at a time, at the 2 targets where")
    assert "these" in words
    # What swings around its target has an error there that is no steady one.
    assert "come" in words


def test_drawn_plants_without_a_rest_or_that_run_away_in_flight_are_counted(good):
    others = good.spread  # two draws, then one coefficient up and down
    restless = replace(others, radius=others.radius.clone(), error=others.error.clone())
    restless.radius[0, 1], restless.error[:, 1] = 1.3, 7.0
    words = by_name(replace(good, spread=restless))["all coefficients"].words
    assert "these" in words and " 7 m" not in words
    assert "come" in words
    restless.radius[1] = 2.0
    restless.radius[0, 0] = torch.inf
    both = by_name(replace(good, spread=restless))["all coefficients"]
    assert "comes" in both.words and not both.good
    assert "run" not in by_name(good)["all coefficients"].words.partition("worst")[2]
    flown = replace(good.drawn, x=good.drawn.x.clone())
    flown.x[0, -1, 0] = 50.0
    unstable_targets = by_name(replace(good, drawn=flown))["all coefficients"]
    assert "steps.png" in unstable_targets.words and not unstable_targets.good


@pytest.mark.parametrize(("step", "hidden"), [(0.5, True), (1e-9, False)])
def test_an_error_that_the_sensor_does_not_resolve_is_said_to_be_one(good, step, hidden):
    # At rest the cart is 0.01 m from its target, which an encoder of 0.5 m does not see.
    beside = replace(good.steps, x=good.steps.x.clone())
    beside.x[:, :, 0] = beside.r + 0.01
    found = replace(good, steps=beside, resolution=np.array([step, 0.0]))
    words = by_name(found)["steady error"].words
    assert ("resolves" in words) == hidden
    assert ("sensor" in words) == hidden


def test_draws_are_told_with_their_size_and_weak_coefficients_are_not_blamed_on_the_data(good):
    words = by_name(good)["all coefficients"].words
    assert words.startswith("2 plants with all coefficients drawn, each within 5 % of itself, as the model tells no")
    spread = replace(good.spread, how=Drawing("by their standard errors", "all at a time"))
    assert "drawn" in by_name(replace(good, spread=spread))["all coefficients"].words
    for name in ("one coefficient", "all coefficients"):
        line = str(CheckFinding(name, False, "b"))
        assert "planning.variation.parameters=" in line and "integral action" in line and "excite" not in line
        # Draws from the covariance of a fit become narrower with more data, changes of a fixed size do not.
        assert ("help" in line) == (name == "one coefficient")


def test_every_finding_that_may_be_weak_has_a_remedy_whose_settings_exist(good):
    cfg = OmegaConf.to_container(composed())
    for name in (*by_name(good), "large movements"):
        line = str(CheckFinding(name, False, "b"))
        assert line.startswith(f"WEAK  {name}: b. ") and str(CheckFinding(name, True, "b")) == f"ok    {name}: b"
        for key in re.findall(r"((?:\w+\.)+\w+)=", line):
            node = cfg
            for step in key.split("."):
                node = node[step]


def test_one_line_sums_up(good, loops, law):
    findings = check_verdict(good, Thresholds(slew=0.0, error=1.0))
    weak = [each.name for each in findings if not each.good]
    assert in_short(good, findings) == (
        f"In short: stable at all 2 targets, and weak in {len(weak)} of 14 findings: {', '.join(weak)}."
    )
    sound = [replace(each, good=True) for each in findings]
    assert in_short(good, sound) == "In short: stable at all 2 targets, and no finding is weak."
    unstable_targets = check(loops(law(-1.0, 0.0)), SMALL)
    assert in_short(unstable_targets, check_verdict(unstable_targets)).startswith(
        "In short: NOT stable at 2 of 2 targets. Do not fly"
    )


def test_small_swings_are_told_with_their_size_and_forbid_no_flight(loops, carts, law):
    # The weakest swing of tests/checking/test_swings.py: the input is held, which takes more damping than there is.
    circling = check(loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), SMALL)
    swing = float(circling.swings.outputs.max())
    assert 0.005 < swing < 0.2
    for limit, words in ((1.01 * swing / 2, "stable at 0 of 2 targets; at 2 it goes on swinging, by "), (0.0, "NOT ")):
        limits = Thresholds(swing=limit)
        findings = check_verdict(circling, limits)
        assert in_short(circling, findings, limits).startswith(f"In short: {words}")
        assert bool(unstable_targets(circling, limits).any()) == (limit == 0)
        assert not findings[0].good and f"{swing:.3g} m of p to either side" in findings[0].words


@pytest.mark.parametrize(
    ("gain", "delay", "said"),
    [
        (2.0, 1.0, "This is less than the gain margin and the delay margin above, so this line counts for both;"),
        (2.0, 7.0, "This is less than the gain margin above, so this line counts for that;"),
        (4.0, 8.0, "The margins above are less than these, and count;"),
    ],
)
def test_of_margins_that_disagree_the_lesser_count(good, gain, delay, said):
    """At rest they are 5 and 0.5 s, which are five periods; four times and eight periods are as far as is tried."""
    margin = Margins(5.0, 0.2, 60.0, 0.5, 1.0)
    found = by_name(replace(good, margins=[[margin], [margin]], flown=LargeSignalMargins(gain, delay)))
    assert said in found["large movements"].words
    assert "damps" in found["gain margin"].words
    assert "movements" not in by_name(good)["gain margin"].words
