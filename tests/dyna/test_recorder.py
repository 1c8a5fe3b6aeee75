"""What a run leaves, and which runs leave a usable result."""

import csv
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from recipes import make_recipe

from dynasindy.control import load
from dynasindy.dyna.callback import Episode, Place
from dynasindy.dyna.loop import LoopSettings, train
from dynasindy.dyna.recorder import Evaluating, Recorder, judge_run
from dynasindy.dyna.refit import Refit
from dynasindy.envs import Step
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.findings import note, weak
from dynasindy.planning import ModelError
from dynasindy.progress import listening
from dynasindy.sindy import Oracle, SindyModel
from dynasindy.systems import Tras, Xi


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run"))


def record(folder, tensorboard=False):
    """Run three episodes of the true model without planning, evaluated every second time."""
    recipe = make_recipe(train=LoopSettings(3, 0.1))
    parts = recipe.build()
    scenario = Scenario("step", Step([[0.1, 0.1], [0.2, -0.1]]), episodes=2, seconds=6.0)
    recorder = Recorder(folder, parts, Evaluating(scenario, 2, tensorboard=tensorboard), 3)
    recorder.heard = []
    with listening(recorder.heard.append):
        recorder.begin()
    train(parts, recipe.train, recorder)
    return folder, parts, recorder


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_row_per_episode_with_the_cost_so_far(recorded):
    folder, _, _ = recorded
    progress = rows(folder / "progress.csv")
    assert [float(row["real_steps"]) for row in progress] == [40, 60, 80]
    assert [float(row["plant_seconds"]) for row in progress] == pytest.approx([2, 3, 4])
    assert [float(row["updates"]) for row in progress] == [2, 4, 6]


def test_only_evaluated_episodes_have_evaluated_figures(recorded):
    folder, _, _ = recorded
    given = [bool(row["evaluated_return"]) for row in rows(folder / "progress.csv")]
    assert given == [False, True, True]  # every second one, and the last


def test_evaluation_neither_counts_nor_changes_the_run(recorded):
    _, parts, recorder = recorded
    before = parts.env.rng.get_state(), parts.agent.noise.sigma, len(parts.replay.real)
    recorder.evaluate()
    assert torch.equal(parts.env.rng.get_state(), before[0])
    assert (parts.agent.noise.sigma, len(parts.replay.real)) == before[1:]


def test_the_end_leaves_policy_model_and_metrics(recorded):
    folder, parts, recorder = recorded
    metrics = recorder.finish({"seed": 0})
    assert json.loads((folder / "metrics.json").read_text()) == metrics
    saved = torch.load(folder / "policy.pt", weights_only=True)
    assert all(torch.equal(saved[name], value) for name, value in parts.agent.deployed.state_dict().items())
    assert (folder / "model.json").is_file()
    final = metrics["evaluation"]
    assert metrics["units"] == {"alpha_a": "rad", "alpha_p": "rad"} and metrics["steady_seconds"] == pytest.approx(1.5)
    for axis in ("alpha_a", "alpha_p"):  # without a box, errors count in their unit
        assert metrics["held"]["share"][axis] == pytest.approx(final[f"steady_state_error/{axis}"], rel=1e-5)
    assert metrics["verdict"]["controlled"] is False
    last = metrics["findings"][-1]
    assert (last["code"], last["severity"], set(last["values"]["outputs"])) == (
        "run.tracked",
        "wrong",
        {"alpha_a", "alpha_p"},
    )
    *flown, end = rows(folder / "data" / "step_response.csv")
    assert len(flown) == 120 and all(row["u_a [-]"] for row in flown)
    # The state at which the last period ends, to which no input belongs.
    last = recorder.evaluate().trajectory["next", "state"][0, -1]
    assert end["u_a [-]"] == end["u_p [-]"] == "" and float(end["time [s]"]) == pytest.approx(6.0)
    assert float(end["alpha_p [rad]"]) == pytest.approx(float(last[1]), rel=1e-6)
    assert metrics["drawn"]["row"] == 0


def test_steps_of_evaluation_are_counted_apart(tmp_path):
    _, _, recorder = record(tmp_path)
    cost = recorder.finish({})["cost"]
    assert cost["real_steps"] == 80
    # The untrained policy, after episodes 2 and 3, and at the end: two references of 120 periods each.
    assert cost["evaluation_steps"] == 4 * 2 * 120


def test_both_errors_of_the_model_stand_under_their_names(recorded, tmp_path):
    _, parts, recorder = recorded
    again = Recorder(tmp_path, parts, replace(recorder.evaluating, every=5), 3)
    again.begin()
    rollout = parts.env.rollout(4)
    figures = ((0.25, 0.75), (0.5 / parts.plant.task.unit, 1.0), (2.0, 3.0))
    error, one_step, tested = (ModelError(a, b, torch.zeros(4, 6)) for a, b in figures)
    again.episode(Episode(2, rollout, error, one_step, False, Refit(4.0, 5.0, True, tested)), Place(2, 7, 8, 9))
    (decided,), (logged,) = rows(tmp_path / "gate.csv"), rows(tmp_path / "progress.csv")
    assert [float(decided[key]) for key in ("reward_error", "state_error")] == [0.25, 0.75]
    assert [float(decided[key]) for key in ("judged_reward_error", "judged_state_error")] == [2.0, 3.0]
    assert [float(logged[key]) for key in ("reward_error", "state_error", "model_trusted")] == [0.25, 0.75, 0.0]
    assert float(logged["one_step_reward_error"]) == pytest.approx(0.5)
    assert float(logged["episode"]) == 2.0
    assert float(logged["return"]) == pytest.approx(float(rollout["next", "reward"].sum()), rel=1e-5)
    spent = [float(logged[key]) for key in ("real_steps", "plant_seconds", "imagined_transitions", "updates")]
    assert spent == pytest.approx([7, 7 * 0.05, 8, 9])


@pytest.mark.parametrize(("number", "name"), [(1, "first"), (2, None), (3, "last")])
def test_the_first_and_the_last_episode_stand_beside_their_predictions(recorded, tmp_path, number, name):
    _, parts, recorder = recorded
    again = Recorder(tmp_path, parts, replace(recorder.evaluating, every=5), 3)
    again.begin()
    rollout = parts.env.rollout(4)
    predicted = ModelError(0.0, 0.0, torch.arange(24.0).reshape(4, 6))
    again.episode(Episode(number, rollout, predicted, predicted, True), Place())
    assert [file.stem for file in (tmp_path / "data").glob("*.csv")] == ([f"prediction_{name}_episode"] if name else [])
    for written in (tmp_path / "data").glob("*.csv"):
        told = rows(written)
        assert [float(row["predicted_alpha_p [rad]"]) for row in told] == [1.0, 7.0, 13.0, 19.0]
        flown = [float(row["alpha_p [rad]"]) for row in told]
        assert flown == pytest.approx(rollout["next", "state"][:, 1].tolist(), abs=1e-6)


def test_tensorboard_reads_what_is_written(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    folder, _, _ = record(tmp_path, tensorboard=True)
    events = EventAccumulator(str(folder / "tensorboard")).Reload().Scalars("return")
    logged = [float(row["return"]) for row in rows(folder / "progress.csv")]
    assert [event.step for event in events] == [1, 2, 3]
    assert [event.value for event in events] == pytest.approx(logged, rel=1e-6)


def test_a_sparse_model_leaves_a_controller_that_acts_as_the_policy_and_another_model_none(recorded, tmp_path):
    _, parts, recorder = recorded
    sparse = SindyModel(parts.plant.system.signature, ["u_a"])
    for model, wanted in ((parts.world_model, False), (sparse, True)):
        folder = tmp_path / type(model).__name__
        again = Recorder(folder, replace(parts, world_model=model), recorder.evaluating, 3)
        again.untrained = recorder.untrained
        again.finish({})
        assert (folder / "controller.json").is_file() is wanted
    saved = load(folder)
    assert (saved.dt, saved.setup.substeps, saved.setup.stops) == (0.05, parts.plant.substeps, Tras().stops)
    rollout = parts.env.rollout(3)
    acted = parts.agent.deployed(rollout[2].select("observation"))["action"]
    found = saved.act(rollout["state"][2].tolist(), rollout["reference"][2].tolist())
    assert found == pytest.approx(acted.detach().numpy(), abs=1e-6)


@pytest.mark.parametrize(("system", "told"), [(Tras(), False), (Xi(), True)])
def test_a_model_that_misses_much_of_what_was_seen_is_told(recorded, tmp_path, system, told):
    """The data are of the first plant; the second one is another."""
    _, parts, recorder = recorded
    model = Oracle(parts.plant.system.signature, system)
    again = Recorder(tmp_path, replace(parts, world_model=model), recorder.evaluating, 3)
    again.untrained = recorder.untrained
    found = [each for each in again.finish({})["findings"] if each["code"] == "model.unexplained"]
    assert [each["severity"] for each in found] == ["weak"] * told
    assert all(share > 0.05 for each in found for share in each["values"]["shares"].values())


def test_behind_sensors_the_state_of_the_observer_is_left_too(recorded, tmp_path):
    _, parts, recorder = recorded
    watched = SimpleNamespace(observer=SimpleNamespace(state_dict=lambda: {"nis": 1.25}))
    again = Recorder(tmp_path, replace(parts, sensing=watched), recorder.evaluating, 3)
    again.untrained, again.evaluate = recorder.untrained, recorder.evaluate  # which flies without sensors
    assert again.finish({})["observer"] == {"nis": 1.25}
    assert json.loads((tmp_path / "observer.json").read_text()) == {"nis": 1.25}


HELD = {"share": {"x": 0.004}, "worst": {"x": 0.02}, "away": {}, "idle": {}}


def metrics(untrained, trained, **held):
    returns = {"untrained": {"return": untrained}, "evaluation": {"return": trained}}
    return {"scenario": "step", **returns, "held": HELD | held}


@pytest.mark.parametrize(("untrained", "trained"), [(-250.0, -10.0), (1.0, 2.0), (-1000.0, -998.0)])
def test_the_trained_policy_has_to_be_better_than_the_untrained_one(untrained, trained):
    verdict = judge_run(metrics(untrained, trained))
    assert verdict.usable and verdict.controlled
    assert verdict.findings[0] == note("run.better", scenario="step", trained=trained, untrained=untrained)
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
