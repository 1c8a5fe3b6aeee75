"""Verdicts: every number that decides one, moved from one side of its threshold to the other, and cases by hand."""

import numpy as np
import pytest

from dynasindy.viz.report import paper, verdicts
from dynasindy.viz.report.document import Finding, Verdict
from dynasindy.viz.report.results import MANY, NONE, SOME

AS, BETTER, SHORT, UNKNOWN = Verdict.AS, Verdict.BETTER, Verdict.SHORT, Verdict.UNKNOWN
KEYS = {"none": NONE, "some": SOME, "many": MANY}
STATES = ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")


def levels(some: float = 5, many: float = 4) -> dict[str, list[float]]:
    return {NONE: [np.inf], SOME: [some], MANY: [many]}


def errors(rate: float) -> dict[str, float]:
    return dict.fromkeys(STATES, 0.1) | {"Omega_p": rate}


def rewards(curve=(0.0, 1.0), to_level=None, ends=None, **changed) -> list[Finding]:
    """Judge settings that all have one curve, but for those that are given another one."""
    curves = {name: np.array([changed.get(key, curve)], dtype=float) for key, name in KEYS.items()}
    return verdicts.judge_rewards(curves, to_level or levels(), ends)


def early(share: float) -> Finding:
    """Of a hundred evaluations planning is ahead by 1 up to `share`, from there on behind by far."""
    none = np.linspace(0.0, 1.0, 100)
    return rewards(none + np.where(np.arange(100) < round(100 * share), 1.0, -1000.0), none=none)[1]


def ends(seeds: float) -> Finding:
    """Returns end alike, and errors do not."""
    return rewards(ends={name: [0.1 * (k + 1)] * int(seeds) for k, name in enumerate(KEYS.values())})[4]


def steps(final: tuple[float, float, float], above: tuple[float | None, float | None] = (1.0, 2.0)) -> list[Finding]:
    scores = {
        name: {f"steady_state_error/{axis}": error for axis in STATES[:2]}
        | {f"overshoot/{axis}": over for axis in STATES[:2]}
        for name, error, over in zip(KEYS.values(), final, (*above, 0.0), strict=True)
    }
    return verdicts.judge_steps(scores)


def sine(part: float, until: float = np.inf) -> Finding:
    """Followed with an offset that is a part of the amplitude, from the start until some time."""
    time = np.arange(0.0, 60.0, 0.1)
    target = 0.4 * np.sin(np.pi * time / 30)[:, None].repeat(2, 1)
    return verdicts.judge_sine(time, target, target + 0.4 * part * (time < until)[:, None], target)[0]


def square(model, direct=lambda target, since: target) -> list[Finding]:
    """Judge levels of 10 s as functions of the target and of the time since its last jump [s], `(T, 1)` each."""
    time = np.arange(0.0, 40.0, 0.1)
    since = (np.arange(400) % 100 / 10)[:, None]
    target = np.where(np.arange(400) % 200 < 100, 0.4, -0.4)[:, None].repeat(2, 1)
    return verdicts.judge_square(time, target, model(target, since), direct(target, since))


def spiked(part: float):
    """Held with an offset, after a spike to three times the level."""
    return lambda target, since: target * np.select([since == 0, since < 1], [0.0, 3.0], 1 + part)


def learning(*error: float, below: float = 0.05) -> Verdict:
    return verdicts.judge_learning(np.arange(len(error)) + 1.0, np.array(error), np.array([]), below)[0].verdict


CASES = [
    (
        "FALL",
        lambda last: verdicts.judge_learning(np.array([1.0, 2.0]), np.array([1.0, last]), [], 0.5)[0],
        0.1,
        AS,
        SHORT,
    ),
    ("CLOSE", lambda rate: verdicts.judge_last_model(errors(rate)), 5.0, AS, SHORT),
    ("CLOSE", lambda rate: verdicts.judge_first_model(errors(rate))[1], 5.0, BETTER, AS),
    (
        "COEFFICIENT",
        lambda off: verdicts.judge_coefficients({"y": {"u": 2.0 * (1 + off / 100)}}, {"y": {"u": 2.0}})[0],
        1.0,
        AS,
        SHORT,
    ),
    ("EARLY", lambda share: early(1.0 - share), 0.75, AS, SHORT),
    ("NEAR", lambda part: rewards((0.0, 100.0), none=(0.0, 100.0 * (1 - part)))[4], 0.05, AS, SHORT),
    ("SEEDS", ends, 3, AS, SHORT),
    ("SOON", lambda episodes: rewards(to_level=levels(episodes, episodes))[3], 180, BETTER, SHORT),
    ("LEVEL", lambda error: steps((0.9, error, error / 2))[0], 0.05, AS, SHORT),
    ("LEVEL", lambda error: steps((0.9, error, 0.0), (2.0, 1.0))[1], 0.05, BETTER, SHORT),  # less overshoot
    ("LEVEL", lambda error: steps((0.9, error, 0.0))[1], 0.05, AS, SHORT),
    ("LEVEL", lambda error: steps((0.9, 0.8, error))[2], 0.05, AS, SHORT),
    ("FINE", lambda error: steps((0.9, error / 2, error))[2], 0.01, BETTER, SHORT),
    ("FOLLOWS", sine, 0.1, AS, SHORT),
    ("FOLLOWS", lambda part: square(lambda target, _: target * (1 + part))[0], 0.1, AS, SHORT),
    # Without the model the error is larger, first without a spike and then with a larger one.
    ("FOLLOWS", lambda part: square(spiked(part), lambda target, _: target * 0.2)[1], 0.1, AS, SHORT),
    ("FOLLOWS", lambda part: square(lambda r, _: r * (1 - part), lambda r, _: r * 2)[1], 0.1, BETTER, SHORT),
    ("TRANSIENT", lambda until: sine(3.0, until), 10.0, AS, SHORT),
]


@pytest.mark.parametrize(("name", "judge", "threshold", "below", "above"), CASES)
def test_a_number_moved_over_its_threshold_changes_the_verdict(name, judge, threshold, below, above):
    assert getattr(paper, name).value == pytest.approx(threshold if name != "EARLY" else 0.25)
    assert judge(0.99 * threshold).verdict is below
    assert judge(1.02 * threshold).verdict is above


@pytest.mark.parametrize(("second", "found"), [(5.2, AS), (4.8, SHORT)])
def test_a_level_is_judged_at_its_last_seconds_alone(second, found):
    """There is an offset in a moment of this second before the end of each level."""
    judged = square(lambda target, since: target + 40.0 * (np.abs(10 - since - second) < 0.06))
    assert judged[0].verdict is found


def test_the_course_of_an_error_is_better_only_if_it_is_small_in_every_episode():
    assert learning(0.049, 0.048, 0.049) is learning(0.04, 0.049, 0.04) is BETTER
    assert learning(0.049, 0.051, 0.049) is learning(0.04, 0.04, 0.34, 0.04, 0.04) is SHORT
    assert [learning(0.049, away, 0.049) for away in (np.nan, np.inf)] == [SHORT, SHORT]
    assert learning(0.051, 0.9, 0.049) is learning(0.049, 0.9, 0.051) is SHORT
    assert learning(1.0, 0.049) is AS and learning(1.0, 0.051) is SHORT


def test_a_missing_or_a_false_function_falls_short():
    truth = {"y": {"u": 2.0, "x": -1.0}}
    assert verdicts.judge_coefficients(truth, truth)[0].verdict is AS
    (missing,) = verdicts.judge_coefficients({"y": {"u": 2.01}}, truth)
    assert missing.verdict is SHORT and "0.5 %" in missing.ours
    assert verdicts.judge_coefficients({"y": truth["y"] | {"1": 0.002}}, truth)[0].verdict is SHORT


@pytest.mark.parametrize(
    ("final", "found"),
    [
        # Disjoint: no error lies within all three intervals. That of the mean of three values reaches from the least
        # to the greatest of them.
        (([0.21, 0.24, 0.26], [0.06, 0.28, 0.35], [0.08, 0.09, 0.1]), SHORT),
        (([0.21, 0.24, 0.26], [0.06, 0.28, 0.35], [0.08, 0.25, 0.1]), AS),
        (([0.21, np.nan, 0.2], [0.06, 0.28, 0.35], [0.3, 0.2, 0.25]), AS),
    ],
)
def test_settings_end_alike_only_if_their_errors_do_too(final, found):
    assert rewards(ends=dict(zip(KEYS.values(), final, strict=True)))[-1].verdict is found


def test_rewards_as_in_the_paper_and_the_other_way_around():
    curves = {
        NONE: np.array([[-100.0, -80, -60, -40, -20, -2, -1, 0]] * 2),
        SOME: np.array([[-90.0, -50, -20, -5, -1, 0, 0, 0]] * 2),
        MANY: np.array([[-80.0, -20, -5, -1, 0, 0, 0, 0]] * 2),
    }
    as_paper = verdicts.judge_rewards(curves, {NONE: [8, 8], SOME: [6, 5], MANY: [3, 4]})
    assert [one.verdict for one in as_paper] == [AS] * 5
    assert "no planning 8, 400 rollouts 5.5, 800 rollouts 3.5" in as_paper[2].ours  # interquartile means of two
    assert "no planning -90, 400 rollouts -70, 800 rollouts -50" in as_paper[1].ours  # of the first two evaluations
    curves = {NONE: np.array([[0.0, -50]]), SOME: np.array([[-100.0, -120]]), MANY: np.array([[-200.0, -300]])}
    falling = verdicts.judge_rewards(curves, {NONE: [1], SOME: [2], MANY: [np.inf]})
    assert [one.verdict for one in falling] == [SHORT] * 5
    alone = verdicts.judge_rewards({MANY: np.array([[-2.0, -1.0]])}, {MANY: [2]})
    assert [one.verdict for one in alone] == [AS] + [UNKNOWN] * 4


@pytest.mark.parametrize(("none", "some"), [(None, 2.0), (1.0, None), (None, None)])
def test_an_overshoot_that_no_step_defines_is_not_compared(none, some):
    found = steps((0.1, 0.02, 0.01), (none, some))
    assert [one.verdict for one in found] == [AS, UNKNOWN, AS] * 2


def test_a_model_that_holds_nothing_is_not_as_in_the_paper_because_none_is_worse_still():
    judged = square(  # beyond each level, and never back
        lambda target, since: np.where(since == 0, 0.0, target + 1.42 * np.sign(target)),
        lambda target, _: target - 6.0 * np.sign(target),
    )
    assert all(number in judged[1].ours for number in ("error 6 ", "1.42 rad", " 0 against 1.42"))
    assert [one.verdict for one in judged] == [SHORT] * 4
