"""Verdicts: every number that decides one, moved from one side of its threshold to the other, and cases by hand."""

import csv
import json
import math

import numpy as np
import pytest

from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.report import HOLDS, SAME, SHORT, build_section

STATES = SIGNATURE.state_names
SETTINGS = ("rollouts_0", "rollouts_400", "rollouts_800")
LEARNT = "runs/xi_dyna_rollouts_800"


@pytest.fixture
def judge(copied):
    """Put files into the folder of results, and return what a section then judges."""

    def _judge(section, files, below=0.2):
        for name, content in files.items():
            path = copied / name
            path.unlink()
            if isinstance(content, dict):
                path.write_text(json.dumps(content))
                continue
            with path.open("w", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(content)
        config = copied / LEARNT / "config.yaml"
        config.write_text(json.dumps(json.loads(config.read_text()) | {"gate": {"open_below": below}}))
        found = build_section(copied, section)
        return [one for case, one in found if case == "xi, `dyna`" and hasattr(one, "verdict")]

    return _judge


def learning(judge, *error, below=0.05):
    header = ["episode", "reward_error", "judged_reward_error", "open_below", "close_above", "open"]
    header += ["held_out_error_before", "held_out_error_after", "refit_kept"]
    rows = [[k, each, each, below, 1.0, 0, 0.1, 0.1, 1] for k, each in enumerate(error, 1)]
    (one,) = judge("model_learning", {f"{LEARNT}/gate.csv": [header, *rows]}, below)
    return one.verdict


def rotor(judge, error):
    """Ramps over a range of 1, the rate of one rotor missed by a percentage of that."""
    ramps = np.linspace(0.0, 1.0, 50)[:, None].repeat(6, 1)
    off = np.array([0.0] * 5 + [error / 100])
    header = ["time", *STATES, *(f"predicted_{name}" for name in STATES)]
    rows = np.hstack([0.05 * np.arange(50)[:, None], ramps, ramps + off]).tolist()
    (one,) = judge("states_before", {f"{LEARNT}/data/prediction_first_episode.csv": [header, *rows]})
    return one.verdict


def rewards(judge, none=(0.0, 1.0), some=(0.0, 1.0), many=(0.0, 1.0), to_level=("", 5, 4)):
    key = ["xi", "dyna"]
    rows = [
        [*key, name, seed, k, each, 0.1, 0.1]
        for name, curve in zip(SETTINGS, (none, some, many))
        for seed in (0, 1)
        for k, each in enumerate(curve, 1)
    ]
    runs = [
        [*key, name, seed, 9, steps, "abc1234"]
        for name, both in zip(SETTINGS, to_level)
        for seed, steps in of_seeds(both)
    ]
    head = ["system", "experiment", "setting", "seed"]
    ends = [f"evaluated_steady_state_error/{name}" for name in STATES[:2]]
    files = {
        "ablation_curves.csv": [[*head, "episode", "evaluated_return", *ends], *rows],
        "ablation.csv": [[*head, "episodes", "episodes_to_level", "commit"], *runs],
    }
    return judge("average_rewards", files)


def of_seeds(both):
    return enumerate(both if isinstance(both, tuple) else (both, both))


def early(judge, share):
    """Of a hundred evaluations planning is ahead by 1 up to `share`, from there on behind by far."""
    none = np.linspace(0.0, 1.0, 100)
    planned = none + np.where(np.arange(100) < round(100 * share), 1.0, -1000.0)
    return rewards(judge, none, planned, planned)[0].verdict


def steps(judge, *final):
    scores = [{f"steady_state_error/{name}": error for name in STATES[:2]} for error in final]
    files = {
        f"runs/xi_dyna_{name}/metrics.json": {"evaluation": score} for name, score in zip(SETTINGS, scores, strict=True)
    }
    return [one.verdict for one in judge("step", files)]


def wave(judge, shape, time, target, output):
    header = ["time", "alpha_a", "alpha_p", "reference_alpha_a", "reference_alpha_p"]
    rows = [[t, y, y, r, r] for t, y, r in zip(time, output, target)]
    files = {f"runs/xi_dyna_{name}/evaluation/{shape}.csv": [header, *rows] for name in SETTINGS}
    return judge(shape, files)[0].verdict


def sine(judge, part, until=math.inf):
    """Followed with an offset that is a part of the amplitude, from the start until some time."""
    time = 0.1 * np.arange(600)
    target = 0.4 * np.sin(np.pi * time / 30)
    return wave(judge, "sine", time, target, target + 0.4 * part * (time < until))


def square(judge, follow):
    """Levels of 10 s, the output as a function of the target and of the time since its last jump [s]."""
    time, since = 0.1 * np.arange(400), np.arange(400) % 100 / 10
    target = np.where(np.arange(400) % 200 < 100, 0.4, -0.4)
    return wave(judge, "square", time, target, follow(target, since))


CASES = {
    "the last error of the first": (lambda judge, last: learning(judge, 1.0, last, below=0.5), 0.1, HOLDS, SHORT),
    "the RMSE of a state": (rotor, 5.0, HOLDS, SHORT),
    "evaluations that are early": (lambda judge, share: early(judge, 1.0 - share), 0.75, HOLDS, SHORT),
    "episodes to the level": (lambda judge, n: rewards(judge, to_level=("", n, n))[2].verdict, 180, SAME, SHORT),
    "the error with planning": (lambda judge, error: steps(judge, 0.9, error, error / 2)[0], 0.05, HOLDS, SHORT),
    "the error of 800 rollouts": (lambda judge, error: steps(judge, 0.9, 0.8, error)[1], 0.05, HOLDS, SHORT),
    "errors that are alike": (lambda judge, error: steps(judge, 0.9, error / 2, error)[1], 0.01, SAME, SHORT),
    "a sine": (sine, 0.1, HOLDS, SHORT),
    "a level": (lambda judge, part: square(judge, lambda target, _: target * (1 + part)), 0.1, HOLDS, SHORT),
    "the transient of a sine": (lambda judge, until: sine(judge, 3.0, until), 10.0, HOLDS, SHORT),
}


@pytest.mark.parametrize(("case", "threshold", "below", "above"), CASES.values(), ids=CASES)
def test_a_number_moved_over_its_threshold_changes_the_verdict(judge, case, threshold, below, above):
    assert [case(judge, factor * threshold) for factor in (0.99, 1.02)] == [below, above]


@pytest.mark.parametrize(("second", "found"), [(5.2, HOLDS), (4.8, SHORT)])
def test_a_level_is_judged_at_its_last_seconds_alone(judge, second, found):
    """There is an offset in a moment of this second before the end of each level."""
    assert square(judge, lambda target, since: target + 40.0 * (np.abs(10 - since - second) < 0.06)) == found


def test_the_course_of_an_error_falls_or_is_small_in_every_episode(judge):
    good = [(0.049, 0.048, 0.049), (0.04, 0.049, 0.04), (1.0, 0.049)]
    poor = [(0.049, 0.051, 0.049), (0.04, 0.34, 0.04), (0.049, math.inf, 0.049), (0.049, 0.9, 0.051), (1.0, 0.051)]
    assert [learning(judge, *errors) for errors in good] == [HOLDS] * 3
    assert [learning(judge, *errors) for errors in poor] == [SHORT] * 5
    assert learning(judge, 0.049, "", 0.049) == SHORT


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        (lambda table: table["omega_p"].update(u_p=1.0099 * table["omega_p"]["u_p"]), HOLDS),
        (lambda table: table["omega_p"].update(u_p=1.02 * table["omega_p"]["u_p"]), SHORT),
        (lambda table: table["Omega_a"].pop("Omega_a"), SHORT),
        (lambda table: table["alpha_a"].update(u_p=0.002), SHORT),
    ],
    ids=["near", "off", "missing", "false"],
)
def test_coefficients_are_all_to_be_found_and_no_others(judge, copied, change, verdict):
    model = json.loads((copied / LEARNT / "model.json").read_text())
    change(model["coefficients"])
    (one,) = judge("coefficients", {f"{LEARNT}/model.json": model})
    assert one.verdict == verdict


def test_rewards_as_in_the_paper_and_the_other_way_around(judge):
    curves = (
        [-100.0, -80, -60, -40, -20, -2, -1, 0],
        [-90.0, -50, -20, -5, -1, 0, 0, 0],
        [-80.0, -20, -5, -1, 0, 0, 0, 0],
    )
    found = rewards(judge, *curves, to_level=((8, 8), (6, 5), (3, 4)))
    assert [one.verdict for one in found] == [HOLDS] * 3
    assert "no planning 8, 400 rollouts 5.5, 800 rollouts 3.5" in found[1].ours  # interquartile means of two
    assert "no planning -90, 400 rollouts -70, 800 rollouts -50" in found[0].ours  # of the first two evaluations
    falling = rewards(judge, (0.0, -50), (-100.0, -120), (-200.0, -300), to_level=(1, 2, ""))
    assert [one.verdict for one in falling] == [SHORT] * 3
