import csv
import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
import torch

from dynasindy.agents import TD3, DynaReplay
from dynasindy.control import load
from dynasindy.dyna.callback import Episode, Place
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.loop import LoopSettings, train
from dynasindy.dyna.recorder import Evaluating, Recorder
from dynasindy.dyna.refit import Refit
from dynasindy.envs import Chirp, ControlEnv, RandomStep, Step, Tracking
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.planning import Gate, ModelError, NoPlanning
from dynasindy.progress import listening
from dynasindy.sindy import Oracle, SindyModel
from dynasindy.systems import Tras, Xi


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run"))


def record(folder, tensorboard=False):
    """Run three episodes of the true model without planning, evaluated every second time."""
    recipe = Recipe(
        system=Tras(),
        task=partial(Tracking, reference=RandomStep([-0.5, -0.5], [0.5, 0.4]), max_steps=20),
        env=ControlEnv,
        excitation=partial(Chirp, duration=1.0),
        world_model=partial(Oracle, system=Tras()),
        agent=partial(TD3, hidden=(8,)),
        replay=partial(DynaReplay, 1000, 16),
        planning=NoPlanning,
        gate=Gate(),
        train=LoopSettings(3, 0.1),
    )
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
    again.episode(Episode(2, rollout, error, one_step, False, Refit(None, 4.0, 5.0, True, tested)), Place(2, 7, 8, 9))
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
