"""What benchmarks share: stopwatches, the commit of a row, commands, simulations in open loop."""

import csv
import os
import subprocess
from argparse import Namespace

import pytest
import torch
from benchmarks import common
from benchmarks.common import measure_seeds, run_command, simulate
from tensordict import TensorDict

from dynasindy.sindy.model import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


@pytest.fixture
def clock(monkeypatch):
    """Time that goes on when told."""
    now = {"wall": 0.0, "cpu": 0.0, "called": 0.0}
    monkeypatch.setattr(common.time, "perf_counter", lambda: now["wall"])
    monkeypatch.setattr(common.time, "process_time", lambda: now["cpu"])
    # user and system, of the process and of those that it called; then the time since some moment
    monkeypatch.setattr(
        common.os, "times", lambda: os.times_result((9.0, 9.0, 0.75 * now["called"], 0.25 * now["called"], 9.0))
    )
    return now


def test_a_pause_is_left_out(clock):
    run = common.Stopwatch()
    clock.update(wall=2.0, cpu=1.0)
    run.stop(30)
    clock.update(wall=50.0, cpu=40.0)
    run.start()
    clock.update(wall=53.0, cpu=42.0, called=0.5)
    run.stop(10)
    assert run.costs() == {"updates": 40, "wall_seconds": 5.0, "cpu_seconds": 3.5}


def test_the_time_of_a_policy_is_that_of_its_calls(clock):
    def slow(tensordict):
        clock["cpu"] += 0.25
        return tensordict.set("action", torch.ones(1))

    timed = common.TimedPolicy(slow)
    for _ in range(2):
        clock["cpu"] += 10.0
        assert timed(TensorDict({}))["action"] == 1
    assert (timed.seconds, timed.calls) == (0.5, 2)


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository of one commit, in whose folder the module is taken to lie."""
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    (tmp_path / "code.py").write_text("x = 1\n")
    (tmp_path / "commit.py").write_text("")
    (tmp_path / "docs" / "results").mkdir(parents=True)
    (tmp_path / "docs" / "results" / "table.csv").write_text("a\n")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    monkeypatch.setattr(common, "__file__", str(tmp_path / "commit.py"))
    return tmp_path


def test_a_clean_checkout_names_its_commit_and_a_changed_one_says_so(checkout):
    head = subprocess.run(["git", "-C", str(checkout), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    clean = common.commit()
    assert len(clean) >= 7 and head.stdout.startswith(clean)
    (checkout / "docs" / "results" / "table.csv").write_text("a\n1\n")  # a row of the benchmark itself
    assert common.commit() == clean
    (checkout / "code.py").write_text("x = 2\n")
    assert common.commit() == f"{clean}-dirty"


def test_a_package_installed_into_a_checkout_of_something_else_is_of_no_commit(checkout, monkeypatch):
    installed = checkout / "venv" / "commit.py"
    installed.parent.mkdir()
    installed.write_text("")
    monkeypatch.setattr(common, "__file__", str(installed))
    assert common.commit() == "unknown"


def test_outside_of_a_checkout_the_commit_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(common, "__file__", str(tmp_path / "commit.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert common.commit() == "unknown"


def test_what_the_file_has_is_not_measured_again(tmp_path, capsys):
    asked, out = [], tmp_path / "rows.csv"

    def measure(plant, seed):
        asked.append((plant, seed))
        return [{"plant": plant, "seed": seed, "error": 10 * seed}]

    def run(plants, seeds):
        measure_seeds(Namespace(plants=plants, seeds=seeds, out=out), ("plant", "seed", "error"), measure)

    run(["b"], [1])
    assert asked == [("b", 1)] and capsys.readouterr().out == "plant b, seed 1, error 10\n"
    run(["a", "b"], [0, 1])
    assert asked == [("b", 1), ("a", 0), ("b", 0), ("a", 1)]
    with out.open() as file:
        assert [tuple(row.values()) for row in csv.DictReader(file)] == [
            ("b", "1", "10"),
            ("a", "0", "0"),
            ("b", "0", "0"),
            ("a", "1", "10"),
        ]


def test_a_command_that_fails_says_why_and_what_time_it_took(tmp_path):
    spent, complaint = run_command("train", ["system=nowhere"], tmp_path)
    assert "nowhere" in complaint and 0 < spent < 600
    assert not list(tmp_path.iterdir())


def test_a_simulation_takes_inputs_when_they_take_effect():
    model = SindyModel(Signature(("y",), ("-",), ("u",), (1.0,)), ["u"])
    model.set_coefficients(torch.tensor([[1.0]]))
    model.delay = 0.2
    u = torch.tensor([[1.0], [0.0], [0.0], [5.0]]).double()
    data = Transitions.from_trajectory(torch.zeros(5, 1).double(), u, 0.1)
    # y' = u two samples late; before the log its first input held.
    assert simulate(model, torch.zeros(1).double(), data, 2)[:, 0].tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.3])
