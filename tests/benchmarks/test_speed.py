"""The benchmark of machine code does the same job with and without it, and leaves plants as they were."""

import pytest
import torch

from dynasindy.benchmarks import speed
from dynasindy.benchmarks.instruments.arguments import parsed
from dynasindy.evaluation.rows import read_rows, write_rows
from dynasindy.systems import System, Tras
from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compiler
from dynasindy.world_models import SindyModel

HEAD = ["job", "machine_code_cpu_seconds", "torch_cpu_seconds", "ratio", "commit"]
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
    row = speed.measure("job", lambda machine_code: 2.0 if machine_code else 5.0)
    assert (row["machine_code_cpu_seconds"], row["torch_cpu_seconds"], row["ratio"]) == (2.0, 5.0, 2.5)


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
    assert [float(row["machine_code_cpu_seconds"]) for row in rows[1:]] == [3.0, 3.0, 4.0, 5.0]  # the median seed
    assert [float(row["ratio"]) for row in rows[1:]] == [2.0, 2.0, 2.5, 0.4]
    assert set(asked) == {
        (plant, seed, code) for plant in ("xi", "tras") for seed in (1, 2, 3) for code in (True, False)
    }


def test_imagined_replay_is_one_command_with_machine_code_and_without(monkeypatch):
    said = []
    monkeypatch.setattr(speed.subprocess, "run", lambda words, **_: said.append(words[1:]))
    assert speed.imagined_replay(True) < 1.0 and speed.imagined_replay(False) < 1.0
    with_code, without = said
    assert without[:-1] == [*with_code[:-1], "world_model.machine_code=false", "agent.machine_code=false"]
    assert with_code[:2] == ["scripts/train.py", "experiment=dyna"] and "planning.rollouts=800" in with_code


def test_a_job_is_measured_alone_and_the_rows_of_the_others_stay(tmp_path, monkeypatch):
    out = tmp_path / "speed.csv"
    write_rows(out, HEAD, [dict(zip(HEAD, row)) for row in (("environment", 1, 2, 2, "a"), ("start-up", 9, 9, 1, "a"))])
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
