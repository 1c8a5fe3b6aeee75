import numpy as np
import pytest

from dynasindy.viz.report.document import Verdict
from dynasindy.viz.report.verdicts import rewards_agree, sine_agrees, square_agrees, steps_agree

NONE, SOME, MANY = "no planning", "400 rollouts", "800 rollouts"


def answers(findings):
    known = {Verdict.AS: True, Verdict.UNKNOWN: None}
    return [known.get(finding.verdict, finding.verdict is Verdict.BETTER and "better") for finding in findings]


def test_rewards_that_go_as_in_the_paper_agree_in_every_statement():
    curves = {
        NONE: np.array([[-100.0, -80, -60, -40, -20, -2, -1, 0]] * 2),
        SOME: np.array([[-90.0, -50, -20, -5, -1, 0, 0, 0]] * 2),
        MANY: np.array([[-80.0, -20, -5, -1, 0, 0, 0, 0]] * 2),
    }
    found = rewards_agree("xi", curves, {NONE: [8, 8], SOME: [6, 5], MANY: [3, 4]})
    assert answers(found) == [True] * 5
    assert "no planning 8, 400 rollouts 5.5, 800 rollouts 3.5" in found[2].ours
    assert "no planning -90, 400 rollouts -70, 800 rollouts -50" in found[1].ours


@pytest.mark.parametrize(
    ("errors", "verdict", "words"),
    [
        # Disjoint: no error lies within all three intervals.
        (([0.21, 0.24, 0.26], [0.06, 0.28, 0.35], [0.08, 0.09, 0.1]), Verdict.SHORT, "not all of which overlap"),
        (([0.21, 0.24, 0.26], [0.06, 0.28, 0.35], [0.08, 0.25, 0.1]), Verdict.AS, "which overlap"),
        (([0.21], [0.06], [0.08]), Verdict.AS, "too few seeds to tell apart"),
        (([0.21, np.nan, 0.2], [0.06, 0.28, 0.35], [0.3, 0.2, 0.25]), Verdict.AS, "which overlap"),
    ],
)
def test_settings_end_alike_only_if_their_errors_do_too(errors, verdict, words):
    """The 95 % interval of the mean of three values reaches from the least to the greatest of them."""
    curves = {name: np.array([[-100.0, 0.0]]) for name in (NONE, SOME, MANY)}
    to_level = {NONE: [8], SOME: [6], MANY: [3]}
    found = rewards_agree("xi", curves, to_level, dict(zip((NONE, SOME, MANY), errors, strict=True)))[-1]
    assert found.verdict is verdict and found.ours.endswith(words)
    assert rewards_agree("xi", curves, to_level)[-1].verdict is Verdict.AS


def test_rewards_that_go_the_other_way_agree_in_none():
    curves = {
        NONE: np.array([[0.0, -50.0]]),
        SOME: np.array([[-100.0, -120.0]]),
        MANY: np.array([[-200.0, -300.0]]),
    }
    found = rewards_agree("xi", curves, {NONE: [1], SOME: [2], MANY: [np.inf]})
    assert answers(found) == [False] * 5
    assert "800 rollouts never" in found[2].ours


def test_planning_is_sooner_only_if_it_is_ahead_of_every_agent_without_a_model():
    curves = {name: np.array([[-2.0, -1.0]]) for name in (NONE, SOME, MANY)}
    planned = {NONE: [np.inf], SOME: [5], MANY: [4]}
    found = rewards_agree("xi", curves, planned | {"SAC": [15, 16]})[2]
    assert found.verdict is Verdict.AS and found.ours.endswith(
        "no planning never, 400 rollouts 5, 800 rollouts 4, SAC 15.5"
    )
    assert rewards_agree("xi", curves, planned | {"SAC": [4.5]})[2].verdict is Verdict.SHORT


def test_without_a_setting_what_compares_it_is_not_measured():
    found = rewards_agree("xi", {MANY: np.array([[-2.0, -1.0]])}, {MANY: [2]})
    assert answers(found) == [True, None, None, None, None]


@pytest.mark.parametrize(("errors", "right"), [((0.08, 0.04, 0.01), True), ((0.01, 0.06, 0.08), False)])
def test_steps_are_judged_by_error_and_overshoot(errors, right):
    scores = {
        name: {f"{metric}/{axis}": value for axis in ("alpha_a", "alpha_p") for metric, value in both.items()}
        for name, both in (
            (setting, {"steady_state_error": error, "overshoot": 20 * error if right else error})
            for setting, error in zip((NONE, SOME, MANY), errors)
        )
    }
    for name, more in ((SOME, 10.0 if right else 0.0),):
        scores[name] |= {"overshoot/alpha_a": more, "overshoot/alpha_p": more}
    assert answers(steps_agree("xi", scores)) == [right] * 6


@pytest.mark.parametrize(
    ("none", "some", "verdict"),
    [(1.0, 2.0, Verdict.AS), (2.0, 1.0, Verdict.BETTER)]
    + [(none, some, Verdict.UNKNOWN) for none, some in ((None, 2.0), (1.0, None), (None, None))],
)
def test_an_overshoot_that_no_step_defines_is_not_compared(none, some, verdict):
    scores = {
        name: {f"{metric}/{axis}": value for axis in ("alpha_a", "alpha_p") for metric, value in both.items()}
        for name, both in (
            (setting, {"steady_state_error": error, "overshoot": above})
            for setting, error, above in ((NONE, 0.1, none), (SOME, 0.02, some), (MANY, 0.01, 0.0))
        )
    }
    found = steps_agree("xi", scores)
    assert [found[1].verdict, found[4].verdict] == [verdict] * 2
    assert ("not finite" in found[1].ours) is (None in (none, some))
    assert answers([found[0], found[2]]) == [True, True]


def test_a_sine_is_followed_within_a_tenth_and_oscillation_is_motion_beyond_the_reference():
    time = np.arange(0, 60, 0.1)
    target = 0.4 * np.sin(0.1 * time)[:, None].repeat(2, 1)
    shaken = target + 0.03 * np.sin(5 * time)[:, None]
    assert answers(sine_agrees("xi", time, target, target, shaken)) == [True] * 4
    assert answers(sine_agrees("xi", time, target, target + 0.1, target)) == [False] * 4


def test_a_square_is_judged_at_the_end_of_its_levels_and_after_its_jumps():
    time = np.arange(0, 40, 0.1)
    target = np.where(time % 20 < 10, 0.4, -0.4)[:, None].repeat(2, 1)
    spiked = target.copy()
    spiked[100] += -0.2  # beyond the lower level, after the jump down from 0.4
    spiked[100 - 1] = 0.4
    found = square_agrees("xi", time, target, spiked, target + 0.03)
    assert found[0].verdict is Verdict.AS and found[0].ours.startswith("0 rad over the last 5 s")
    offset = square_agrees("xi", time, target, target + 0.1, target)
    assert answers(offset) == [False] * 4
    assert offset[0].ours.startswith("0.1 rad")


def test_a_model_that_holds_nothing_is_not_as_in_the_paper_because_none_is_worse_still():
    time = np.arange(0, 40, 0.1)
    target = np.where(time % 20 < 10, 0.4, -0.4)[:, None].repeat(2, 1)
    spiked = target + 1.42 * np.sign(target)  # beyond each level, and never back
    spiked[::100] = 0.0
    found = square_agrees("xi", time, target, spiked, target - 6.0 * np.sign(target))
    assert found[1].ours == "error 6 against 1.42 rad; beyond the level after a jump 0 against 1.42 rad"
    assert answers(found) == [False] * 4
