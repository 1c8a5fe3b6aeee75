"""Which runs leave a usable result."""

import re
from dataclasses import asdict

import pytest

from dynasindy.dyna.verdict import distrusted, judge_run

HELD = {"share": {"x": 0.004}, "worst": {"x": 0.02}, "away": {}, "idle": {}}


def metrics(untrained, trained, **held):
    returns = {"untrained": {"return": untrained}, "evaluation": {"return": trained}}
    return {"scenario": "step", **returns, "held": HELD | held}


@pytest.mark.parametrize(
    ("untrained", "trained", "usable", "words"),
    [
        (-250.0, -10.0, True, "is better than .* is -10, .* -250"),
        (-10.0, -250.0, False, "is worse than .* is -250, .* -10;"),
        (-10.0, -10.0, False, "no better than"),
        (-10.0, None, False, "not finite"),
        (None, -10.0, False, "not finite"),
        (1.0, 2.0, True, "is better than"),
        (-1000.0, -998.0, True, "hardly better, by 0.2 %"),
    ],
)
def test_the_trained_policy_has_to_be_better_than_the_untrained_one(untrained, trained, usable, words):
    verdict = judge_run(metrics(untrained, trained))
    assert verdict.usable is usable
    assert re.search(words, verdict.sentence)
    assert "\n" not in verdict.sentence
    told = {"usable": usable, "sentence": verdict.sentence, "controlled": True, "held": verdict.held}
    assert asdict(verdict) == told


def test_an_output_within_what_is_asked_for_is_controlled():
    verdict = judge_run(metrics(-2.0, -1.0))
    assert verdict.controlled and verdict.held.startswith("CONTROLLED: ")
    assert "average" in verdict.held


@pytest.mark.parametrize(
    ("held", "within", "words"),
    [
        ({}, 0.003, "x 0.4 %"),
        ({"share": {"x": None}}, 0.01, "x no number"),
        ({"worst": {"x": 0.11}}, 0.01, "11 % at worst"),
        ({"share": {"x": 0.004, "y": 700.0}, "worst": {"x": 0.0, "y": 700.0}}, 0.01, "y 700 times"),
        ({"away": {"theta": 0.5}}, 0.01, "theta, .* in 50 % of the runs"),
    ],
)
def test_a_large_error_a_lost_reference_and_a_state_that_runs_away_are_no_control(held, within, words):
    verdict = judge_run(metrics(-2.0, -1.0, **held), within)
    assert not verdict.controlled and verdict.usable
    assert verdict.held.startswith("NOT CONTROLLED: ") and re.search(words, verdict.held)


def test_a_mileage_that_runs_on_is_named_and_no_failure():
    verdict = judge_run(metrics(-2.0, -1.0, idle={"way": 1.0}))
    assert verdict.controlled and "runs" in verdict.held


@pytest.mark.parametrize(
    ("trained", "away", "controlled", "words"),
    [
        (-1.0, {}, None, "^NOT JUDGED: .* it grew.$"),
        (-9.0, {}, None, "^NOT JUDGED: .* did not grow.$"),
        (
            -1.0,
            {"v": 0.25},
            False,
            "^NOT CONTROLLED: .* v, .* in 25 % of the runs",
        ),
    ],
)
def test_where_nothing_is_tracked_the_return_counts(trained, away, controlled, words):
    verdict = judge_run(metrics(-2.0, trained, share={}, worst={}, away=away))
    assert verdict.controlled is controlled
    assert re.search(words, verdict.held)
    assert "errors" not in verdict.held


def decision(episode, reward, state=0.1, is_open=0.0):
    judged = {"judged_reward_error": reward, "judged_state_error": state}
    return {"episode": float(episode), "open_below": 0.05, "close_above": 0.1, "open": is_open, **judged}


@pytest.mark.parametrize(
    ("rows", "limit", "words"),
    [
        (
            [decision(1, 0.01, is_open=1.0), decision(2, 0.3)],
            9.0,
            r"after 1 of 2 .* episode 2 .* was 0\.3 .*close_above=0.1",
        ),
        (
            [decision(1, 0.3), decision(2, 0.07)],
            9.0,
            r"after 2 of 2 episodes.* after episode 2 .* above gate.open_below=0.05",
        ),
        ([decision(1, 0.3), decision(2, 0.01, is_open=1.0)], 9.0, r"after 1 of 2 episodes.* after episode 1 "),
        ([decision(1, 0.01, 2.5)], 2.0, r"its state error was 2\.5 ranges, above gate.state_error=2"),
        ([decision(1, float("inf"))], 2.0, r"was inf per control period, above gate.close_above"),
        ([decision(1, float("nan"), float("nan"))], 2.0, r"no numbers"),
    ],
)
def test_a_model_that_was_not_trusted_is_told_with_the_reason(rows, limit, words):
    told = distrusted(rows, limit)
    assert re.search(words, told) and "\n" not in told and told.endswith("; gate.csv tells of each.")


def test_of_a_model_that_was_always_trusted_nothing_is_told():
    assert distrusted([]) == "" == distrusted([decision(1, 0.01, is_open=1.0)])
