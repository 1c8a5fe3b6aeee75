"""Which runs leave a usable result."""

import math

import pytest

from dynasindy.dyna.recorder import judge_run
from dynasindy.findings import note, weak

HELD = {"share": {"x": 0.004}, "worst": {"x": 0.02}, "away": {}, "idle": {}}


def metrics(untrained, trained, **held):
    returns = {"untrained": {"return": untrained}, "evaluation": {"return": trained}}
    return {"scenario": "step", **returns, "held": HELD | held}


@pytest.mark.parametrize(
    ("untrained", "trained", "percent"),
    [(-250.0, -10.0, 96.0), (1.0, 2.0, 100.0), (-1000.0, -998.0, 0.2)],
)
def test_the_trained_policy_has_to_be_better_than_the_untrained_one(untrained, trained, percent):
    verdict, hardly = judge_run(metrics(untrained, trained)), percent < 1
    returns = {"scenario": "step", "trained": trained, "untrained": untrained, "percent": pytest.approx(percent)}
    assert verdict.usable and verdict.controlled
    assert verdict.findings[0] == (weak if hardly else note)("run.better", **returns, hardly=hardly)
    assert "\n" not in "".join(map(str, verdict.findings))


@pytest.mark.parametrize(("untrained", "trained"), [(-10.0, -250.0), (-10.0, -10.0), (-10.0, None), (None, -10.0)])
def test_a_policy_that_is_no_better_or_of_no_finite_return_is_no_result(untrained, trained):
    verdict = judge_run(metrics(untrained, trained))
    worse = verdict.findings[0]
    assert not verdict.usable and (worse.code, worse.severity) == ("run.no_better", "wrong")
    for name, value in (("trained", trained), ("untrained", untrained)):
        assert worse.values[name] == value if value is not None else math.isnan(worse.values[name])
    assert "\n" not in str(verdict.findings[0])


def test_an_output_within_what_is_asked_for_is_controlled():
    verdict = judge_run(metrics(-2.0, -1.0))
    outputs = {"x": {"least": 0.004, "most": 0.004, "worst": 0.02, "of_turn": False}}
    facts = {"outputs": outputs, "within": 0.01, "away": {}, "idle": [], "grew": True, "ringing": []}
    facts |= {"lost": 0.1, "moving": False}
    assert verdict.controlled and verdict.findings[1] == note("run.tracked", controlled=True, **facts)


def test_states_that_still_ring_are_named_and_speak_against_nothing():
    names = [f"x{k}" for k in range(12)]
    verdict = judge_run(metrics(-2.0, -1.0, ringing=dict.fromkeys(names, 0.5)))
    told = verdict.findings[1]
    assert verdict.controlled and told.severity == "note" and told.values["ringing"] == names
    assert "x0" in str(told) and "x11" not in str(told)  # of many the first ones


@pytest.mark.parametrize(
    ("held", "within", "words"),
    [
        ({}, 0.003, "x 0.4 %"),
        ({"share": {"x": None}}, 0.01, "x no number"),
        ({"worst": {"x": 0.11}}, 0.01, "11 % at worst"),
        ({"share": {"x": 0.004, "y": 700.0}, "worst": {"x": 0.0, "y": 700.0}}, 0.01, "y 70,000 %"),
        ({"away": {"theta": 0.5}}, 0.01, "50 % of the runs"),
    ],
)
def test_a_large_error_a_lost_reference_and_a_state_that_runs_away_are_no_control(held, within, words):
    verdict = judge_run(metrics(-2.0, -1.0, **held), within)
    assert not verdict.controlled and verdict.usable
    told = verdict.findings[1]
    assert (told.code, told.severity, told.values["controlled"]) == ("run.tracked", "wrong", False)
    assert set(told.values["away"]) == set(held.get("away", {})) and words in str(told)


@pytest.mark.parametrize(("share", "helps"), [(0.004, True), (0.4, False)])
def test_what_does_not_come_to_rest_beside_outputs_that_are_held_is_to_be_tracked(monkeypatch, share, helps):
    held = {"share": {"p": share}, "worst": {"p": share}, "away": {"q": 1.0}, "rates": ["v"]}
    held |= {"targets": {"p": [-1.0, 1.0]}}
    told = judge_run(metrics(-2.0, -1.0, **held)).findings[1]
    assert told.values.get("targets") == ({"p": [-1.0, 1.0]} if helps else None)
    assert ("{'p': (-1.0, 1.0), 'v': (0.0, 0.0)}" in str(told)) is helps
    monkeypatch.setattr("dynasindy.sentences._words_of_commands", True)
    assert ("plant.outputs=[p,v] plant.low=[-1,0] plant.high=[1,0]" in str(told)) is helps


def test_a_verdict_says_its_limits():
    told = str(judge_run(metrics(-2.0, -1.0), 0.02).findings[1])
    assert "2 % on average" in told and "20 % at worst" in told


def test_a_mileage_that_runs_on_is_named_and_no_failure():
    verdict = judge_run(metrics(-2.0, -1.0, idle={"way": 1.0}))
    assert verdict.controlled and verdict.findings[1].values["idle"] == ["way"]


@pytest.mark.parametrize(
    ("trained", "away", "controlled"), [(-1.0, {}, None), (-9.0, {}, None), (-1.0, {"v": 0.25}, False)]
)
def test_where_nothing_is_tracked_the_return_counts(trained, away, controlled):
    verdict = judge_run(metrics(-2.0, trained, share={}, worst={}, away=away))
    told = verdict.findings[1]
    assert verdict.controlled is told.values["controlled"] is controlled
    assert told.severity == ("note" if controlled is None else "wrong")
    assert (told.values["grew"], told.values["outputs"]) == (trained > -2, {})
    assert told.values["away"] == {name: {"share": share, "swings": False} for name, share in away.items()}
    assert "errors" not in str(told)


def decision(episode, reward, is_open=0.0):
    judged = {"judged_reward_error": reward, "judged_state_error": 0.1}
    return {"episode": float(episode), "open_below": 0.05, "close_above": 0.1, "open": is_open, **judged}


@pytest.mark.parametrize(
    ("rows", "counts", "error"),
    [
        ([decision(1, 0.01, is_open=1.0), decision(2, 0.3)], (1, 2, 2), 0.3),
        ([decision(1, 0.3), decision(2, 0.07)], (2, 2, 2), 0.07),
        ([decision(1, 0.3), decision(2, 0.01, is_open=1.0)], (1, 2, 1), 0.3),
        ([decision(1, float("inf"))], (1, 1, 1), float("inf")),
        ([decision(1, float("nan"))], (1, 1, 1), pytest.approx(float("nan"), nan_ok=True)),
    ],
)
def test_a_model_that_was_not_trusted_is_told_with_its_error_and_the_limits(rows, counts, error):
    facts = dict(zip(("closed", "episodes", "episode"), counts, strict=True))
    told, *_ = judge_run(metrics(1.0, 2.0), decisions=rows).findings
    assert told == weak("run.gate_closed", **facts, error=error, open_below=0.05, close_above=0.1)
    assert "\n" not in str(told)


def test_of_a_model_that_was_always_trusted_nothing_is_told():
    plain = judge_run(metrics(1.0, 2.0)).findings
    assert judge_run(metrics(1.0, 2.0), decisions=[decision(1, 0.01, is_open=1.0)]).findings == plain
