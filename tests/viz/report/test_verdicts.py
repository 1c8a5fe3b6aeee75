"""Verdicts: every number that decides one, moved from one side of its threshold to the other, and cases by hand."""

import numpy as np
import pytest

from dynasindy.viz import report
from dynasindy.viz.report import MANY, NONE, SOME, Judgement, Verdict

HOLDS, SAME, SHORT = Verdict.HOLDS, Verdict.SAME, Verdict.SHORT
KEYS = {"none": NONE, "some": SOME, "many": MANY}
STATES = ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")


def levels(some: float = 5, many: float = 4) -> dict[str, list[float]]:
    return {NONE: [np.inf], SOME: [some], MANY: [many]}


def errors(rate: float) -> dict[str, float]:
    return dict.fromkeys(STATES, 0.1) | {"Omega_p": rate}


def rewards(curve=(0.0, 1.0), to_level=None, **changed) -> list[Judgement]:
    """Judge settings that all have one curve, but for those that are given another one."""
    curves = {name: np.array([changed.get(key, curve)], dtype=float) for key, name in KEYS.items()}
    return [*report.judge_rewards(curves, to_level or levels())]


def early(share: float) -> Judgement:
    """Of a hundred evaluations planning is ahead by 1 up to `share`, from there on behind by far."""
    none = np.linspace(0.0, 1.0, 100)
    return rewards(none + np.where(np.arange(100) < round(100 * share), 1.0, -1000.0), none=none)[0]


def steps(final: tuple[float, float, float]) -> list[Judgement]:
    pairs = zip(KEYS.values(), final, strict=True)
    return [*report.judge_steps({name: {f"steady_state_error/{axis}": e for axis in STATES[:2]} for name, e in pairs})]


def sine(part: float, until: float = np.inf) -> Judgement:
    """Followed with an offset that is a part of the amplitude, from the start until some time."""
    time = np.arange(0.0, 60.0, 0.1)
    target = 0.4 * np.sin(np.pi * time / 30)[:, None].repeat(2, 1)
    return next(report.judge_wave("sine", time, target, target + 0.4 * part * (time < until)[:, None]))


def square(model) -> list[Judgement]:
    """Judge levels of 10 s as a function of the target and of the time since its last jump [s], `(T, 1)` each."""
    time = np.arange(0.0, 40.0, 0.1)
    since = (np.arange(400) % 100 / 10)[:, None]
    target = np.where(np.arange(400) % 200 < 100, 0.4, -0.4)[:, None].repeat(2, 1)
    return [*report.judge_wave("square", time, target, model(target, since))]


def learning(*error: float, below: float = 0.05) -> Verdict:
    return report.judge_learning(np.arange(len(error)) + 1.0, np.array(error), np.array([]), below).verdict


CASES = [
    (
        "FALL",
        lambda last: report.judge_learning(np.array([1.0, 2.0]), np.array([1.0, last]), [], 0.5),
        0.1,
        HOLDS,
        SHORT,
    ),
    ("CLOSE", lambda rate: report.judge_model("it predicts", errors(rate)), 5.0, HOLDS, SHORT),
    (
        "COEFFICIENT",
        lambda off: report.judge_coefficients({"y": {"u": 2.0 * (1 + off / 100)}}, {"y": {"u": 2.0}}),
        1.0,
        HOLDS,
        SHORT,
    ),
    ("EARLY", lambda share: early(1.0 - share), 0.75, HOLDS, SHORT),
    ("SOON", lambda episodes: rewards(to_level=levels(episodes, episodes))[2], 180, SAME, SHORT),
    ("LEVEL", lambda error: steps((0.9, error, error / 2))[0], 0.05, HOLDS, SHORT),
    ("LEVEL", lambda error: steps((0.9, 0.8, error))[1], 0.05, HOLDS, SHORT),
    ("FINE", lambda error: steps((0.9, error / 2, error))[1], 0.01, SAME, SHORT),
    ("FOLLOWS", sine, 0.1, HOLDS, SHORT),
    ("FOLLOWS", lambda part: square(lambda target, _: target * (1 + part))[0], 0.1, HOLDS, SHORT),
    ("TRANSIENT", lambda until: sine(3.0, until), 10.0, HOLDS, SHORT),
]


@pytest.mark.parametrize(("name", "judge", "threshold", "below", "above"), CASES)
def test_a_number_moved_over_its_threshold_changes_the_verdict(name, judge, threshold, below, above):
    assert getattr(report, name) == pytest.approx(threshold if name != "EARLY" else 0.25)
    assert judge(0.99 * threshold).verdict is below
    assert judge(1.02 * threshold).verdict is above


@pytest.mark.parametrize(("second", "found"), [(5.2, HOLDS), (4.8, SHORT)])
def test_a_level_is_judged_at_its_last_seconds_alone(second, found):
    """There is an offset in a moment of this second before the end of each level."""
    judged = square(lambda target, since: target + 40.0 * (np.abs(10 - since - second) < 0.06))
    assert judged[0].verdict is found


def test_the_course_of_an_error_falls_or_is_small_in_every_episode():
    assert learning(0.049, 0.048, 0.049) is learning(0.04, 0.049, 0.04) is HOLDS
    assert learning(0.049, 0.051, 0.049) is learning(0.04, 0.04, 0.34, 0.04, 0.04) is SHORT
    assert [learning(0.049, away, 0.049) for away in (np.nan, np.inf)] == [SHORT, SHORT]
    assert learning(0.051, 0.9, 0.049) is learning(0.049, 0.9, 0.051) is SHORT
    assert learning(1.0, 0.049) is HOLDS and learning(1.0, 0.051) is SHORT


def test_a_missing_or_a_false_function_falls_short():
    truth = {"y": {"u": 2.0, "x": -1.0}}
    assert report.judge_coefficients(truth, truth).verdict is HOLDS
    missing = report.judge_coefficients({"y": {"u": 2.01}}, truth)
    assert missing.verdict is SHORT and "0.5 %" in missing.ours
    assert report.judge_coefficients({"y": truth["y"] | {"1": 0.002}}, truth).verdict is SHORT


def test_rewards_as_in_the_paper_and_the_other_way_around():
    curves = {
        NONE: np.array([[-100.0, -80, -60, -40, -20, -2, -1, 0]] * 2),
        SOME: np.array([[-90.0, -50, -20, -5, -1, 0, 0, 0]] * 2),
        MANY: np.array([[-80.0, -20, -5, -1, 0, 0, 0, 0]] * 2),
    }
    as_paper = [*report.judge_rewards(curves, {NONE: [8, 8], SOME: [6, 5], MANY: [3, 4]})]
    assert [one.verdict for one in as_paper] == [HOLDS] * 3
    assert "no planning 8, 400 rollouts 5.5, 800 rollouts 3.5" in as_paper[1].ours  # interquartile means of two
    assert "no planning -90, 400 rollouts -70, 800 rollouts -50" in as_paper[0].ours  # of the first two evaluations
    curves = {NONE: np.array([[0.0, -50]]), SOME: np.array([[-100.0, -120]]), MANY: np.array([[-200.0, -300]])}
    falling = report.judge_rewards(curves, {NONE: [1], SOME: [2], MANY: [np.inf]})
    assert [one.verdict for one in falling] == [SHORT] * 3
    alone = report.judge_rewards({MANY: np.array([[-2.0, -1.0]])}, {MANY: [2]})
    assert [one.verdict for one in alone] == []
