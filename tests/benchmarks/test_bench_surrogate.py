"""The stand-in's log is one that a user could have written."""

import csv
from pathlib import Path

import pytest
from benchmarks import bench_surrogate

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "standin.csv"


def test_the_command_is_found_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "log.csv").write_text("time,alpha_a\n0,1\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    # What is wrong is the log, which the command has read, and not that there is no command.
    with pytest.raises(RuntimeError, match=r"identify.py ended with 2: error: .*has no column 'alpha_p'"):
        list(bench_surrogate.identified(tmp_path))
    assert not list(elsewhere.iterdir())


def test_its_published_rows_are_of_all_three_methods_on_each_log():
    with RESULTS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    logs = {(row["case"], row["log"]) for row in rows}
    assert len(rows) == 3 * len(logs)
    for case, log in logs:
        ours, linear, held = [row for row in rows if (row["case"], row["log"]) == (case, log)]
        for state in ("alpha_a", "alpha_p", "omega_a", "omega_p"):
            assert float(ours[state]) < float(linear[state]) < float(held[state])
