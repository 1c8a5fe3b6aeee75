"""The benchmark of machine code does the same job with and without it, and leaves plants as they were."""

import pytest
import torch
from benchmark import parse
from benchmarks import speed

from dynasindy.safe_io import read_rows, write_rows
from dynasindy.systems import Tras
from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compiler

HEAD = ["job", "cpu_seconds", "beside", "beside_cpu_seconds", "ratio", "commit"]
OLD = (("environment", 1, "torch code", 2, 2, "a"), ("start-up", 9, "import torch", 9, 1, "a"))
X, U = torch.zeros(6, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)


def test_a_row_holds_both_times_and_their_ratio():
    row = speed.measure("job", speed.Job(lambda ours, seeds: 2.0 if ours else 5.0, "that"), [0])
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


def test_a_file_with_other_columns_is_refused_before_anything_is_measured(tmp_path, monkeypatch):
    (tmp_path / "speed.csv").write_text("job,machine_code_cpu_seconds\nenvironment,1\n")
    monkeypatch.setattr(speed, "start_up", lambda ours: pytest.fail("measured"))
    with pytest.raises(SystemExit, match=r"has the columns job, machine_code_cpu_seconds, and .* give another file"):
        speed.main(parse("speed", ["--jobs", "start-up", "--out", str(tmp_path / "speed.csv")]))


def test_a_job_is_measured_alone_and_the_rows_of_the_others_stay(tmp_path, monkeypatch):
    out = tmp_path / "speed.csv"
    write_rows(out, HEAD, [dict(zip(HEAD, row)) for row in OLD])
    monkeypatch.setattr(speed, "start_up", lambda ours: 4.0 if ours else 2.0)
    speed.main(parse("speed", ["--jobs", "start-up", "--out", str(out)]))
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
