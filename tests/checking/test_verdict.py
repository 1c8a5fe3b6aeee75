"""A finding keeps its threshold or not, and says which figure it is."""

import json
import math
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
from dynasindy.checking.verdict import (
    CheckFinding,
    Thresholds,
    _plain_number,
    check_record,
    check_verdict,
    error,
    in_figures,
    in_lines,
    in_short,
    least,
    most,
    unstable_targets,
)

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
    assert "100 % in p and v" in found["recovery"].words


def test_a_stable_loop_is_as_slow_as_its_largest_eigenvalue(loops):
    # u = -2 p - 2.5 v on a double integrator: what is left after t is exp(-t / 0.73 s).
    a = np.array([[1.0, 0.1], [0.0, 1.0]]) - np.array([[0.005], [0.1]]) @ np.array([[2.0, 2.5]])
    slowest = -0.1 / np.log(np.abs(np.linalg.eigvals(a)).max())
    words = by_name(check(loops(), SMALL))["stability"].words
    assert f" {slowest:.2g} s" in words


def test_noise_is_weak_beyond_its_threshold_only_and_none_where_the_file_states_none(good, loops):
    # A deviation of 0.01 m at a gain of 4 per metre, whatever the other target: 0.04.
    noisy = replace(good, noise=[np.array([[3.0, 0.0]]), np.array([[4.0, 0.0]])], sensors=np.array([0.01, 0.0]))
    for limit, sound in ((0.05, True), (0.03, False)):
        found = by_name(noisy, Thresholds(noise=limit))["noise"]
        assert found.good is sound and "deviation" in found.words
    silent = by_name(check(loops(), SMALL))["noise"]
    assert silent.good is None and not silent.weak
    assert str(silent).startswith("?     noise: ")


def test_what_is_not_known_is_no_weakness_and_is_summed_up(loops):
    found = check(loops(), SMALL)
    findings = [CheckFinding("slew", True, ""), *(each for each in check_verdict(found) if each.name == "noise")]
    assert in_short(found, findings).endswith("not known: noise.")
    figures = in_figures(found, findings)
    assert figures["unknown"] == ["noise"] and figures["weak"] == []


def test_the_largest_slew_and_saturation_over_the_targets_decide(good):
    u = torch.zeros(2, 4, 1, dtype=torch.float64)
    u[1, :2, 0] = torch.tensor([-0.5, 1.0])  # of the second target
    steps = LoopSimulation(torch.zeros(2, 5, 2).double(), u, torch.zeros(2, 1), [0], 0.1, torch.tensor([[-1.0], [1.0]]))
    found = by_name(replace(good, steps=steps, settings=replace(good.settings, seconds=0.4)))
    assert found["slew"].words.count("force changes by up to 1.50") == 1
    assert "25 % of 0.4 s" in found["saturation"].words
    assert not found["slew"].good and not found["saturation"].good


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


def test_thresholds_are_those_that_are_given(good):
    strict = Thresholds(error=1e-9, recovered=1.1, noise=0.0, slew=0.0, saturated=-1.0)
    found = by_name(good, strict)
    names = ("steady error", "recovery", "noise", "slew", "saturation")
    assert not any(found[name].good for name in names)
    assert found["noise"].words.endswith("threshold: 0")


def test_the_threshold_of_the_steady_error_has_the_unit_of_its_value(good):
    # p counts by 2 m: a tenth of that is 0.2 m.
    words = by_name(good, Thresholds(error=0.1))["steady error"].words
    assert " m of p; " in words and "0.2 m, 10 % of 2 m" in words
    assert "0.2 m, 10 % of 2 m" in by_name(good, Thresholds(error=0.1))["all coefficients"].words


def test_an_unstable_loop_says_so_first_and_where(loops, law):
    lines = check_verdict(check(loops(law(-1.0, 0.0)), SMALL))
    assert lines[0].name == "stability" and not lines[0].good
    assert "2 of 2 targets of p, such as (-0.4)" in lines[0].words
    assert not any("margin" in each.name for each in lines)


def test_a_coefficient_that_makes_it_unstable_is_named(loops, carts, law):
    # u = -18 v holds v while 18 b dt < 2; with b = 1.2 it is too much.
    found = by_name(check(loops(law(1.0, 18.0), carts()), SMALL))
    assert found["stability"].good and not found["one coefficient"].good
    assert found["one coefficient"].words.startswith("2 plants from 1 coefficient, 20 %")


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
    assert "no finding is weak" in in_short(good, sound)
    unstable_targets = check(loops(law(-1.0, 0.0)), SMALL)
    assert in_short(unstable_targets, check_verdict(unstable_targets)).startswith(
        "In short: NOT stable at 2 of 2 targets"
    )


def test_small_swings_are_told_with_their_size_and_forbid_no_flight(loops, carts, law):
    # The weakest swing of tests/checking/test_simulation.py: the input is held, which takes more damping than there is.
    circling = check(loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), SMALL)
    swing = float(circling.swings.outputs.max())
    assert 0.005 < swing < 0.2
    for limit, words in ((1.01 * swing / 2, "stable at 0 of 2 targets; at 2 "), (0.0, "NOT ")):
        limits = Thresholds(swing=limit)
        findings = check_verdict(circling, limits)
        assert in_short(circling, findings, limits).startswith(f"In short: {words}")
        assert bool(unstable_targets(circling, limits).any()) == (limit == 0)
        assert not findings[0].good and f"{swing:.3g} m of p to either side" in findings[0].words


@pytest.mark.parametrize(
    ("gain", "delay", "said"),
    [
        (2.0, 1.0, "the gain margin and the delay margin above"),
        (2.0, 7.0, "less than the gain margin above"),
        (4.0, 8.0, "margins above are less"),
    ],
)
def test_of_margins_that_disagree_the_lesser_count(good, gain, delay, said):
    """At rest they are 5 and 0.5 s, which are five periods; four times and eight periods are as far as is tried."""
    margin = Margins(5.0, 0.2, 60.0, 0.5, 1.0)
    found = by_name(replace(good, margins=[[margin], [margin]], flown=LargeSignalMargins(gain, delay)))
    assert said in found["large movements"].words
    assert "damps" in found["gain margin"].words
    assert "movements" not in by_name(good)["gain margin"].words


@pytest.fixture(scope="module")
def unobserved(loops):
    return check(loops(), Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2))


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"gain": 1.9996}, "gain margin"),
        ({"lower": 0.50004}, "gain reduction"),
        ({"phase": 29.998}, "phase margin"),
        ({"delay": 0.099996}, "delay margin"),
        ({"disk": 0.49997}, "disk margin"),
    ],
)
def test_a_margin_that_is_just_too_small_is_shown_to_be(unobserved, changed, name):
    """The first number of the line is on the side of the last that its mark says, and the other way round."""
    sound = Margins(5.0, 0.2, 60.0, 0.5, 1.0)
    found = check_verdict(replace(unobserved, margins=[[sound], [replace(sound, **changed)]]))
    (line,) = (each for each in found if each.name == name)
    value = float(re.search(r"(?:the least is|may fall to) ([\d.]+)", line.words)[1])
    limit = float(re.search(r"threshold: ([\d.]+)", line.words)[1])
    assert line.weak and (value > limit if name == "gain reduction" else value < limit), line.words


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        (least(29.98, 30.0, 0), ("29.98", "30")),
        (least(30.02, 30.0, 0), ("30", "30")),
        (least(29.4, 30.0, 0), ("29", "30")),
        (most(30.02, 30.0, 0), ("30.02", "30")),
        (most(29.98, 30.0, 0), ("30", "30")),
        (most(2.5712, 2.5699, 3, "g", 3), ("2.571", "2.57")),
        (most(2.5699, 2.5712, 3, "g", 3), ("2.57", "2.57")),
        (most(2.5706, 2.5702, 3, "g", 3), ("2.571", "2.57")),
        (least(6.003, 6.0206, 1, of_limit=2), ("6.00", "6.02")),
        (least(7.5, 6.0206, 1, of_limit=2), ("7.5", "6")),
    ],
)
def test_a_figure_has_as_many_digits_as_its_verdict_takes(pair, said):
    assert pair == said


def test_an_error_that_is_just_too_large_is_shown_to_be(unobserved):
    """The typical size of p is 2 m, of which a twentieth is allowed."""
    told = error(unobserved, torch.tensor([[0.10003]], dtype=torch.float64), Thresholds())
    assert (told.word, told.allowed) == ("0.10003 m", "0.1 m, 5 % of 2 m, the typical size of p")
    assert told.share > 0.05 and error(unobserved, torch.tensor([[torch.inf]]), Thresholds()).word == "no bound"


def test_findings_come_first_and_what_is_infinite_is_null(loops, carts):
    """Of a cart on a spring with friction: what JSON holds is what the check found, in the same order."""
    found = check(loops(model=carts(spring=1.0, friction=0.5)), Settings((-0.4,), (0.4,), points=2, grid=3, draws=1))
    findings = check_verdict(found)
    held = json.loads(json.dumps(check_record(found, findings), allow_nan=False))
    assert next(iter(held)) == "verdict" and held["left"] == []
    assert [line["finding"] for line in held["verdict"]] == [each.name for each in findings]
    gains = [each.gain for target in found.margins for each in target]
    told = [target["margins"]["force"]["gain"] for target in held["targets"]]
    assert [value if value is not None else math.inf for value in told] == gains
    settling = found.spread.settling
    assert settling is not None
    assert [change["settling"] for change in held["changes"]] == settling[:, :-1].amax(0).tolist()
    assert _plain_number(math.inf) is None and _plain_number(math.nan) is None and _plain_number(2.0) == 2.0


def test_what_may_mend_several_findings_stands_behind_the_first_weak_one():
    weak = [
        CheckFinding(name, name == "gain margin", "b")
        for name in ("gain margin", "phase margin", "disk margin", "slew")
    ]
    lines = in_lines([*weak, CheckFinding("a", False, "b")])
    # Of the margins only the first weak one has the advice, which all of them share; that on the slew is another one.
    assert lines[0] == "ok    gain margin: b" and lines[2] == "WEAK  disk margin: b" and lines[4] == "WEAK  a: b"
    assert lines[1] == str(weak[1]) and "planning.gain_range=" in lines[1] and "planning.gain_range=" not in lines[3]
    assert lines[3] == str(weak[3]) and "rate_weight" in lines[3]
