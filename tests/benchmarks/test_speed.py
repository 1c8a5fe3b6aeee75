"""The benchmark of machine code does the same job with and without it, and leaves plants as they were."""

import subprocess

import pytest
import torch
from benchmarks import speed
from benchmarks.arguments import parsed

from dynasindy.safe_io import read_rows, write_rows
from dynasindy.sindy import SindyModel
from dynasindy.systems import System, Tras
from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compiler

HEAD = ["job", "cpu_seconds", "beside", "beside_cpu_seconds", "ratio", "commit"]
OLD = (("environment", 1, "torch code", 2, 2, "a"), ("start-up", 9, "import torch", 9, 1, "a"))
X, U = torch.zeros(6, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
def test_plants_go_without_machine_code_for_a_while():
    whole = System.compiled
    model = SindyModel(Tras().signature, "rotor")

    def failing():
        with speed._compiled(False):
            assert Tras().compiled(X, U) is None
            assert model.compiled(X.float(), U.float()) is None
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    assert System.compiled is whole
    with speed._compiled(True):
        assert Tras().compiled(X, U) is not None
        assert model.compiled(X.float(), U.float()) is not None


def test_a_row_holds_both_times_and_their_ratio():
    row = speed.measure("job", speed.Job(lambda ours: 2.0 if ours else 5.0, "that"))
    assert list(row) == HEAD
    assert (row["cpu_seconds"], row["beside"], row["beside_cpu_seconds"], row["ratio"]) == (2.0, "that", 5.0, 2.5)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
def test_every_seed_pays_for_the_compiler(monkeypatch):
    calls, build = [], compiling.build
    monkeypatch.setattr(compiling, "build", lambda *files: calls.append(1) or build(*files))
    monkeypatch.setattr(speed, "train", lambda *_: Tras().compiled(X, U))
    for seed in (0, 1):
        speed.controller("tras", seed, True)
    assert len(calls) == 2


def test_every_job_is_written(tmp_path, monkeypatch):
    asked = []

    def controller(plant, seed, machine_code):
        asked.append((plant, seed, machine_code))
        return {1: 1.0, 2: 8.0, 3: 3.0}[seed] * (1 if machine_code else 2)

    monkeypatch.setattr(speed, "controller", controller)
    monkeypatch.setattr(speed, "imagined_replay", lambda machine_code: 4.0 if machine_code else 10.0)
    monkeypatch.setattr(speed, "start_up", lambda ours: 5.0 if ours else 2.0)
    monkeypatch.setattr(speed, "STEPS", 3)
    monkeypatch.setattr(speed, "REPEATS", 2)
    speed.main(parsed("speed", ["--seeds", "1", "2", "3", "--out", str(tmp_path / "speed.csv")]))
    rows = read_rows(tmp_path / "speed.csv")
    assert [row["job"] for row in rows] == [
        "environment",
        "controller xi",
        "controller tras",
        "imagined replay xi",
        "start-up",
    ]
    assert [float(row["cpu_seconds"]) for row in rows[1:]] == [3.0, 3.0, 4.0, 5.0]  # the median seed
    assert [float(row["ratio"]) for row in rows[1:]] == [2.0, 2.0, 2.5, 0.4]
    assert [row["beside"] for row in rows] == [*["torch code"] * 4, "import torch"]
    assert set(asked) == {
        (plant, seed, code) for plant in ("xi", "tras") for seed in (1, 2, 3) for code in (True, False)
    }


def test_a_checkout_runs_its_own_code_on_the_same_command(tmp_path, monkeypatch):
    # The stand-in of a script says which package it would import.
    for folder, name in ((tmp_path / "now", "this"), (tmp_path / "then", "that")):
        (folder / "scripts").mkdir(parents=True)
        (folder / "package_of_it.py").write_text(f"NAME = '{name}'\n")
        (folder / "scripts" / "train.py").write_text(
            "import sys, pathlib, package_of_it\n"
            "with (pathlib.Path(__file__).parents[2] / 'said').open('a') as said:\n"
            "    print(package_of_it.NAME, *sys.argv[1:-1], file=said)\n"
        )
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    (tmp_path / "then" / "pyproject.toml").write_text("")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", str(tmp_path / "then"), *words], check=True)
    head = subprocess.run(
        ["git", "-C", str(tmp_path / "then"), "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    )
    monkeypatch.chdir(tmp_path / "now")
    words = ["--jobs", "imagined replay xi before", "--before", "../then", "--out", str(tmp_path / "speed.csv")]
    speed.main(parsed("speed", words))
    ours, theirs = ((tmp_path / "said").read_text()).splitlines()
    assert ours.split()[0] == "this" and theirs.split()[0] == "that"
    assert ours.split()[1:] == theirs.split()[1:] and "planning.rollouts=800" in ours.split()
    (row,) = read_rows(tmp_path / "speed.csv")
    assert head.stdout.startswith(row["beside"]) and len(row["beside"]) >= 7


def test_an_earlier_commit_is_compared_with_only_where_its_checkout_is_given(tmp_path, capsys):
    with pytest.raises(SystemExit, match="needs --before FOLDER"):
        speed.main(parsed("speed", ["--jobs", "imagined replay xi before", "--out", str(tmp_path / "speed.csv")]))
    with pytest.raises(SystemExit):
        parsed("speed", ["--before", str(tmp_path)])
    assert "has no scripts/train.py; give a folder made by `git worktree add" in capsys.readouterr().err
    assert not (tmp_path / "speed.csv").exists()


def test_a_file_with_other_columns_is_refused_before_anything_is_measured(tmp_path, monkeypatch):
    (tmp_path / "speed.csv").write_text("job,machine_code_cpu_seconds\nenvironment,1\n")
    monkeypatch.setattr(speed, "start_up", lambda ours: pytest.fail("measured"))
    with pytest.raises(SystemExit, match=r"has the columns job, machine_code_cpu_seconds, and .* give another file"):
        speed.main(parsed("speed", ["--jobs", "start-up", "--out", str(tmp_path / "speed.csv")]))


def test_imagined_replay_is_one_command_with_machine_code_and_without(monkeypatch):
    said = []
    monkeypatch.setattr(speed.subprocess, "run", lambda words, **_: said.append(words[1:]))
    assert speed.imagined_replay(True) < 1.0 and speed.imagined_replay(False) < 1.0
    with_code, without = said
    assert without[:-1] == [*with_code[:-1], "world_model.machine_code=false", "agent.machine_code=false"]
    assert with_code[:2] == ["scripts/train.py", "experiment=dyna"] and "planning.rollouts=800" in with_code


def test_a_job_is_measured_alone_and_the_rows_of_the_others_stay(tmp_path, monkeypatch):
    out = tmp_path / "speed.csv"
    write_rows(out, HEAD, [dict(zip(HEAD, row)) for row in OLD])
    monkeypatch.setattr(speed, "start_up", lambda ours: 4.0 if ours else 2.0)
    speed.main(parsed("speed", ["--jobs", "start-up", "--out", str(out)]))
    rows = read_rows(out)
    assert [(row["job"], float(row["ratio"])) for row in rows] == [("environment", 2.0), ("start-up", 0.5)]


def test_the_start_is_over_when_the_first_line_comes(monkeypatch):
    # A process that waits is ended after its line, and only what it computed before that counts.
    busy = "import time\nend = time.process_time() + {}\nwhile time.process_time() < end: pass\n"
    after = "print('Run folder', flush=True)\ntime.sleep(600)"
    monkeypatch.setattr(speed, "REPEATS", 2)
    monkeypatch.setattr(speed, "STARTS", {True: ("-c", busy.format(0.3) + after), False: ("-c", "pass")})
    assert speed.start_up(True) >= 0.3
    with pytest.raises(RuntimeError, match="did not start"):
        speed.start_up(False)
