"""A run stopped anywhere ends as one that was not; its checkpoints and its folder."""

import csv
import dataclasses
import json
import os
import subprocess
import sys
from functools import partial

import pytest
import torch
from leftovers import left_by
from recipes import make_recipe

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna import Stopped
from dynasindy.dyna.experiment import LoopSettings
from dynasindy.dyna.recorder import Evaluating
from dynasindy.dyna.run import Checkpoints, result, run, run_report
from dynasindy.envs import ControlEnv, Multisine, Step
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.findings import note
from dynasindy.planning import GradientPlanning, ImaginedReplay
from dynasindy.safe_io import locked
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Diverged, Xi

REPLAYED = partial(ImaginedReplay, rollouts=6, horizon=4, generations=2)
GRADIENT = partial(
    GradientPlanning, updates=2, more_updates=2, rollouts=4, window=3, check_every=1, searches=0,
    input_delay=0.5,
)  # fmt: skip
PLANNERS = {
    "none": partial(ImaginedReplay, rollouts=0, every=10**6),
    "replay": REPLAYED,
    "gradient": GRADIENT,
}
PROVENANCE = "a: 1\n", {"command": "train", "commit": "abc"}


CALLS = 50 * 8 + 20 * 8 * 2 + 50 * 8 + 4
"""Calls of the plant up to the second episode: an evaluation, the excitation, an episode, as RK4 makes them."""


class Plug(Xi):
    """A plant that is unplugged at a certain call."""

    calls, last = 0, None

    def forward(self, x, u):
        Plug.calls += 1
        if Plug.calls == Plug.last:
            raise KeyboardInterrupt
        return super().forward(x, u)


def recipe(planning, episodes=3):
    known = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}
    model = partial(SindyModel, known=known, regression=Regression("bic"), refinement=Refinement("integral"))
    return make_recipe(
        Plug(),
        env=partial(ControlEnv, dt=0.1, substeps=2, dtype=torch.float64),
        excitation=partial(Multisine, duration=2.0),
        world_model=model,
        agent=partial(TD3, hidden=(8, 8), policy_average=0.01),
        replay=partial(DynaReplay, 60, 16, 0.5, model_capacity=30),  # both rings turn over
        planning=planning,
        train=LoopSettings(episodes, 0.2, held_out=2),
        seed=3,
    )


def go(folder, name, last=None, episodes=3, config=PROVENANCE[0], **options):
    Plug.calls, Plug.last = 0, last
    evaluating = Evaluating(Scenario("step", Step([[0.1, 0.1]]), seconds=5.0), every=2)
    return run(recipe(PLANNERS[name], episodes), evaluating, folder, config, PROVENANCE[1], **options)


def test_a_run_stopped_again_and_again_ends_as_the_one_that_was_not(tmp_path):
    go(tmp_path / "whole", "gradient", episodes=2)
    calls = Plug.calls
    stops = 0
    for share in (0.03, 0.6, 0.2):
        with pytest.raises(Stopped, match="stopped; "):
            go(tmp_path / "parts", "gradient", last=round(share * calls), episodes=2)
        stops += 1
    go(tmp_path / "parts", "gradient", episodes=2)
    assert Plug.calls < calls  # what was done is not repeated
    assert stops == 3 and left_by(tmp_path / "parts") == left_by(tmp_path / "whole")
    assert not (tmp_path / "parts" / "checkpoints").exists()


def test_a_finished_run_is_not_repeated_and_one_of_other_settings_is_refused(tmp_path):
    """Settings are the same whatever does not change a result, or says nothing."""
    metrics = go(tmp_path, "none", episodes=1, config="a: 1\nfolder: here\nthreads: 1\nresume: null\n")
    for same in ("a: 1\nfolder: there\nthreads: 2\nresume: there\n", "a: 1\nb: null\n"):
        found = go(tmp_path, "none", last=100, episodes=1, config=same)  # but for its check, the plant is not touched
        assert found == metrics
    for other in ("a: 2\nfolder: here\nthreads: 1\n", "a: 1\nb: 1\n", ""):
        with pytest.raises(ValueError, match="such"):
            go(tmp_path, "none", episodes=1, config=other)


def test_a_stopped_run_can_be_ended_and_then_gone_on_with(tmp_path):
    go(tmp_path / "whole", "none")
    with pytest.raises(Stopped, match="episode"):
        go(tmp_path / "parts", "none", last=CALLS)
    ended = go(tmp_path / "parts", "none", finish=True)
    assert ended["episodes"] == 1 and ended["cost"]["real_steps"] == 40
    assert go(tmp_path / "parts", "none")["episodes"] == 3
    ours, theirs = (left_by(tmp_path / name) for name in ("parts", "whole"))
    for files in (ours, theirs):  # it was evaluated once more
        del files["metrics.json"]["cost"]
    assert ours == theirs


def test_numbers_that_go_wrong_are_said_with_the_episode_and_lose_nothing(tmp_path):
    class Loose(Plug):
        def forward(self, x, u):
            return super().forward(x, u) * (torch.nan if Plug.calls > CALLS else 1.0)

    Plug.calls, Plug.last = 0, None
    evaluating = Evaluating(Scenario("step", Step([[0.1, 0.1]]), seconds=5.0), every=2)
    loose = dataclasses.replace(recipe(PLANNERS["none"]), system=Loose())
    with pytest.raises(Diverged, match="episode"):
        run(loose, evaluating, tmp_path, *PROVENANCE)
    assert not (tmp_path / "policy.pt").exists()
    assert go(tmp_path, "none")["episodes"] == 3  # on the plant as it should be


def test_a_checkpoint_of_another_run_costs_one_line(tmp_path):
    with pytest.raises(Stopped):
        go(tmp_path, "replay", last=CALLS)
    Plug.calls, Plug.last = 0, None
    evaluating = Evaluating(Scenario("step", Step([[0.1, 0.1]]), seconds=5.0), every=2)
    wider = dataclasses.replace(recipe(REPLAYED), agent=partial(TD3, hidden=(9, 8)))
    with pytest.raises(ValueError, match="checkpoints"):
        run(wider, evaluating, tmp_path, *PROVENANCE)


@pytest.mark.parametrize("name", ["replay", "gradient"])
def test_a_task_without_references_goes_the_whole_way(settle, tmp_path, name):
    Plug.last = None
    made = recipe(PLANNERS[name], 1)
    made = dataclasses.replace(made, task=partial(settle, reach=0.01, max_steps=20))
    evaluating = Evaluating(Scenario("task", episodes=2, seconds=None))
    metrics = run(made, evaluating, tmp_path / "run", *PROVENANCE)
    assert metrics["held"]["share"] == metrics["findings"][-1]["values"]["outputs"] == {}
    assert metrics["verdict"]["controlled"] is None  # nothing is said of control
    told = run_report(metrics, tmp_path / "run")
    assert "scenario 'task'" in told and "steady-state" not in told
    stable = note(
        "check.stability", targets=2, unstable=0, outputs=["x"], target=[0.0], radius=0.9, slowest=1.0, dt=0.1
    )
    checked = run_report(metrics | {"check": {"findings": [stable.record()]}}, tmp_path / "run")
    assert "stable at 2 of 2" in checked and "stable at 2 of 2" not in told
    earlier = {key: value for key, value in metrics.items() if key != "findings"}  # as another version wrote it
    assert "NOT JUDGED" not in run_report(earlier, tmp_path / "run")
    rows = list(csv.DictReader((tmp_path / "run" / "progress.csv").open()))
    assert float(rows[0]["evaluated_return"]) == pytest.approx(metrics["evaluation"]["return"], rel=1e-6)
    names = next(csv.reader((tmp_path / "run" / "data" / "step_response.csv").open()))
    assert names[-1] == "u_p [-]" and not (tmp_path / "run" / "controller.json").exists()


def test_the_newest_two_are_kept_and_the_newest_is_read(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    assert checkpoints.newest() is None
    for number in (1, 2, 10):
        checkpoints.save(number, {"number": number, "weights": torch.full((3,), float(number))})
    assert sorted(file.name for file in checkpoints.folder.iterdir()) == ["000002.pt", "000010.pt"]
    state = checkpoints.newest()
    assert state["number"] == 10 and torch.equal(state["weights"], torch.full((3,), 10.0))


@pytest.mark.parametrize(
    "damage",
    [
        lambda raw: raw[:-1],  # the end is missing, as after a power cut
        lambda raw: raw[:100],
        lambda raw: b"",
        lambda raw: raw[:-200] + bytes([raw[-200] ^ 1]) + raw[-199:],  # one bit of the payload
        lambda raw: b"something else\n" + raw,
        lambda raw: raw + b"0",
    ],
)
def test_a_damaged_file_is_passed_over_for_the_one_before(tmp_path, damage):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"number": 1})
    newest = checkpoints.save(2, {"number": 2, "weights": torch.zeros(100)})
    newest.write_bytes(damage(newest.read_bytes()))
    assert checkpoints.newest() == {"number": 1}


class Payload:
    def __reduce__(self):
        return os.system, ("touch canary",)


def test_a_checkpoint_is_data_and_runs_no_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.save(1, {"attack": Payload()})
    assert checkpoints.newest() is None
    assert not (tmp_path / "canary").exists()


def test_what_is_removed_is_what_was_made(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.save(1, {})
    (checkpoints.folder / "mine.txt").write_text("keep")
    checkpoints.remove()
    assert [file.name for file in checkpoints.folder.iterdir()] == ["mine.txt"]


def test_a_disk_that_cannot_be_read_is_no_reason_to_begin_anew(tmp_path, monkeypatch):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"number": 1})

    def fail(*_, **__):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(type(tmp_path), "open", fail)
    with pytest.raises(OSError, match="Input/output"):
        checkpoints.newest()
    monkeypatch.undo()
    assert checkpoints.newest() == {"number": 1}


def finished(folder, episodes=3):
    record = {"episodes": episodes, "cost": {}, "evaluation": {}, "untrained": {}}
    record |= {"equations": [], "verdict": {}}
    (folder / "metrics.json").write_text(json.dumps(record))
    (folder / "model.json").write_text("{}")
    torch.save({"weight": torch.zeros(2)}, folder / "policy.pt")
    return record


def test_a_run_has_ended_if_its_files_are_sound(tmp_path):
    assert result(tmp_path, 3) is None
    record = finished(tmp_path)
    assert result(tmp_path, 3) == record
    assert result(tmp_path, 4) is None  # it was ended after three of four episodes


@pytest.mark.parametrize("name", ["metrics.json", "model.json", "policy.pt"])
@pytest.mark.parametrize("size", [0, 10])
def test_a_cut_file_is_no_result(tmp_path, name, size):
    finished(tmp_path)
    (tmp_path / "model.json").write_text(json.dumps({"library": list(range(20))}))
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:size])
    assert result(tmp_path, 3) is None


HOLD = (
    "import sys; from pathlib import Path; from dynasindy.safe_io import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
)


def test_two_processes_cannot_work_in_one_folder(tmp_path):
    other = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout.readline() == b"held\n"
    with pytest.raises(ValueError, match="works"), locked(tmp_path):
        pass
    other.kill()  # a claim does not outlive its process, however that ends
    other.wait()
    with locked(tmp_path):
        pass
