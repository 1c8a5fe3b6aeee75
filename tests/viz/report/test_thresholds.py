"""Every number that decides a verdict, moved from one side of its threshold to the other."""

import numpy as np
import pytest

from dynasindy.evaluation.ablation import Level
from dynasindy.viz.report import model_verdicts, thresholds, verdicts
from dynasindy.viz.report.document import Finding, Verdict
from dynasindy.viz.report.thresholds import THRESHOLDS, judged
from dynasindy.viz.report.verdicts import MANY, NONE, SOME

AS, BETTER, SHORT = Verdict.AS, Verdict.BETTER, Verdict.SHORT
STATES = ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")


def chirp(off: float) -> Finding:
    return model_verdicts.excitation_agrees("xi", 10.0 + off, "")


def samples(number: float) -> Finding:
    return model_verdicts.samples_agree("xi", int(number), 0.01, "")


def fall(last: float) -> Finding:
    """From 1 in the first episode; trusted below 0.5."""
    return model_verdicts.learning_agrees("xi", np.array([1.0, 2.0]), np.array([1.0, last]), np.array([]), 0.5)


def close(error: float) -> Finding:
    return model_verdicts.last_model_agrees(
        "xi", model_verdicts.CLOSELY, dict.fromkeys(STATES, 0.1) | {"Omega_p": error}
    )


def difficult(error: float) -> Finding:
    return model_verdicts.first_model_agrees("xi", dict.fromkeys(STATES, 0.1) | {"Omega_p": error})[1]


def coefficient(percent: float) -> Finding:
    return model_verdicts.coefficients_agree("xi", {"y": {"u": 2.0 * (1 + percent / 100)}}, {"y": {"u": 2.0}})


def early(share: float) -> Finding:
    """Of a hundred evaluations planning is ahead by 1 up to `share`, from there on behind by far."""
    none = np.linspace(0.0, 1.0, 100)[None]
    planned = none + np.where(np.arange(100) < round(100 * share), 1.0, -1000.0)
    return verdicts.rewards_agree("xi", {NONE: none, SOME: planned, MANY: planned}, levels())[1]


def levels(some: float = 5, many: float = 4) -> dict[str, list[float]]:
    return {NONE: [np.inf], SOME: [some], MANY: [many]}


def near(part: float) -> Finding:
    """No planning ends short of the others by a part of the whole rise, 100."""
    curves = {NONE: np.array([[0.0, 100.0 * (1 - part)]]), SOME: np.array([[0.0, 100.0]])}
    return verdicts.rewards_agree("xi", curves | {MANY: curves[SOME]}, levels())[4]


def ends(seeds: float) -> Finding:
    """Returns end alike, and errors do not."""
    curves = {name: np.array([[0.0, 1.0]]) for name in (NONE, SOME, MANY)}
    errors = {name: [0.1 * (k + 1)] * int(seeds) for k, name in enumerate(curves)}
    return verdicts.rewards_agree("xi", curves, levels(), errors)[4]


def soon(episodes: float) -> Finding:
    curves = {name: np.array([[0.0, 1.0]]) for name in (NONE, SOME, MANY)}
    return verdicts.rewards_agree("xi", curves, levels(episodes, episodes))[3]


def steps(errors: tuple[float, float, float], above: tuple[float, float] = (1.0, 2.0)) -> list[Finding]:
    scores = {
        name: {f"steady_state_error/{axis}": error for axis in STATES[:2]}
        | {f"overshoot/{axis}": over for axis in STATES[:2]}
        for name, error, over in zip((NONE, SOME, MANY), errors, (*above, 0.0), strict=True)
    }
    return verdicts.steps_agree("xi", scores)


def settles(error: float) -> Finding:
    return steps((0.9, error, error / 2))[0]


def smoother(error: float) -> Finding:
    """400 rollouts that overshoot less than no planning."""
    return steps((0.9, error, 0.0), (2.0, 1.0))[1]


def overshooting(error: float) -> Finding:
    return steps((0.9, error, 0.0))[1]


def smallest(error: float) -> Finding:
    return steps((0.9, 0.8, error))[2]


def fine(error: float) -> Finding:
    return steps((0.9, error / 2, error))[2]


def sine(part: float, until: float = np.inf) -> Finding:
    """Followed with an offset that is a part of the amplitude, from the start until some time."""
    time = np.arange(0.0, 60.0, 0.1)
    target = 0.4 * np.sin(np.pi * time / 30)[:, None].repeat(2, 1)
    shown = target + 0.4 * part * (time < until)[:, None]
    return verdicts.sine_agrees("xi", time, target, shown, target)[0]


def square(part: float, before_the_end: float = np.inf) -> Finding:
    """Held with an offset that is a part of the level, until some seconds before the end of each level."""
    time = np.arange(0.0, 40.0, 0.1)
    target = np.where(time % 20 < 10, 0.4, -0.4)[:, None].repeat(2, 1)
    off = np.where(10 - time % 10 > before_the_end, 0.0, 0.4 * part) if np.isfinite(before_the_end) else 0.4 * part
    return verdicts.square_agrees("xi", time, target, target + np.reshape(off, (-1, 1)), target)[0]


def worse(part: float) -> Finding:
    """Held with an offset and a spike; without the model the error is larger and there is no spike."""
    time, since = np.arange(0.0, 40.0, 0.1), np.arange(400) % 100
    target = np.where(np.arange(400) % 200 < 100, 0.4, -0.4)[:, None].repeat(2, 1)
    shown = target * np.select([since == 0, since < 10], [0.0, 3.0], 1 + part)[:, None]
    return verdicts.square_agrees("xi", time, target, shown, target * 0.2)[1]


def worse_and_wilder(part: float) -> Finding:
    """Held with an offset and no spike; without the model error and spikes are larger."""
    time = np.arange(0.0, 40.0, 0.1)
    target = np.where(time % 20 < 10, 0.4, -0.4)[:, None].repeat(2, 1)
    return verdicts.square_agrees("xi", time, target, target * (1 - part), target * 2)[1]


CASES = [
    ("LASTS", chirp, 0.1, AS, SHORT),
    ("LASTS", lambda off: chirp(-off), 0.1, AS, SHORT),
    ("FALL", fall, 0.1, AS, SHORT),
    ("CLOSE", close, 5.0, AS, SHORT),
    ("CLOSE", difficult, 5.0, BETTER, AS),
    ("COEFFICIENT", coefficient, 1.0, AS, SHORT),
    ("EARLY", lambda share: early(1.0 - share), 0.75, AS, SHORT),
    ("NEAR", near, 0.05, AS, SHORT),
    ("SEEDS", ends, 3, AS, SHORT),
    ("SOON", soon, 180, BETTER, SHORT),
    ("LEVEL", settles, 0.05, AS, SHORT),
    ("LEVEL", smoother, 0.05, BETTER, SHORT),
    ("LEVEL", overshooting, 0.05, AS, SHORT),
    ("LEVEL", smallest, 0.05, AS, SHORT),
    ("FINE", fine, 0.01, BETTER, SHORT),
    ("FOLLOWS", sine, 0.1, AS, SHORT),
    ("FOLLOWS", square, 0.1, AS, SHORT),
    ("FOLLOWS", worse, 0.1, AS, SHORT),
    ("FOLLOWS", worse_and_wilder, 0.1, BETTER, SHORT),
    ("TRANSIENT", lambda until: sine(3.0, until), 10.0, AS, SHORT),
]


@pytest.mark.parametrize(("name", "judge", "threshold", "below", "above"), CASES)
def test_a_number_moved_over_its_threshold_changes_the_verdict(name, judge, threshold, below, above):
    assert THRESHOLDS[name].value == pytest.approx(threshold if name != "EARLY" else 0.25)
    assert judge(0.99 * threshold).verdict is below
    assert judge(1.02 * threshold).verdict is above


def test_samples_have_to_be_exactly_as_many():
    assert [samples(number).verdict for number in (999, 1000, 1001)] == [SHORT, AS, SHORT]


def test_a_level_is_judged_at_its_last_seconds_alone():
    time = np.arange(0.0, 40.0, 0.1)
    target = np.where(time % 20 < 10, 0.4, -0.4)[:, None].repeat(2, 1)
    for second, verdict in ((5.2, AS), (4.8, SHORT)):  # an offset in this second before the end of each level
        off = 40.0 * (np.abs(10 - time % 10 - second) < 0.06)[:, None]
        assert verdicts.square_agrees("xi", time, target, target + off, target)[0].verdict is verdict, second


def test_the_course_of_an_error_is_better_only_if_it_is_small_in_every_episode():
    def course(*error: float, below: float = 0.05) -> Verdict:
        of = (np.arange(len(error)) + 1.0, np.array(error), np.array([]), below)
        return model_verdicts.learning_agrees("xi", *of).verdict

    assert course(0.049, 0.048, 0.049) is course(0.04, 0.049, 0.04) is BETTER
    assert course(0.049, 0.051, 0.049) is course(0.04, 0.04, 0.34, 0.04, 0.04) is SHORT
    assert [course(0.049, away, 0.049) for away in (np.nan, np.inf)] == [SHORT, SHORT]
    assert course(0.051, 0.9, 0.049) is course(0.049, 0.9, 0.051) is SHORT
    assert course(1.0, 0.049) is AS and course(1.0, 0.051) is SHORT


def test_every_threshold_is_moved_here_and_has_words():
    moved = {name for name, *_ in CASES} | {"SAMPLES", "SETTLED"}
    assert moved == set(THRESHOLDS)
    assert all(one.words.endswith(".") and one.unit for one in THRESHOLDS.values())
    assert THRESHOLDS["LEVEL"].value == Level().error


@pytest.mark.parametrize("module", [verdicts, model_verdicts])
def test_no_number_of_a_verdict_stands_outside_the_thresholds(module):
    named = {name for name, value in vars(module).items() if isinstance(value, thresholds.Threshold)}
    assert named
    assert not [n for n, v in vars(module).items() if isinstance(v, int | float) and not n.startswith("_")]


def test_verdicts_are_four():
    assert [judged(True), judged(True, True), judged(False, True), judged(False), judged(None)] == [
        AS, AS, BETTER, SHORT, Verdict.UNKNOWN,
    ]  # fmt: skip
