"""What benchmarks share: the commit of a row, rows that a file has already, commands."""

import dataclasses
import subprocess

import pytest
import torch
from benchmarks import common

from dynasindy.safe_io import read_rows
from dynasindy.systems.tras import TrasConstants


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository of one commit, in whose folder the module is taken to lie."""
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    (tmp_path / "common.py").write_text("x = 1\n")
    (tmp_path / "docs" / "results").mkdir(parents=True)
    (tmp_path / "docs" / "results" / "table.csv").write_text("a\n")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    monkeypatch.setattr(common, "__file__", str(tmp_path / "common.py"))
    return tmp_path


def test_a_row_names_the_commit_of_clean_code_and_says_where_code_was_changed(checkout, monkeypatch):
    head = subprocess.run(["git", "-C", str(checkout), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    clean = common.commit()
    assert len(clean) >= 7 and head.stdout.startswith(clean)
    (checkout / "docs" / "results" / "table.csv").write_text("a\n1\n")  # a row of the benchmark itself
    assert common.commit() == clean
    (checkout / "common.py").write_text("x = 2\n")
    assert common.commit() == f"{clean}-dirty"
    (checkout / "installed.py").write_text("")  # a package in a checkout of something else
    monkeypatch.setattr(common, "__file__", str(checkout / "installed.py"))
    assert common.commit() == "unknown"


def test_what_the_file_has_is_not_measured_again(tmp_path, monkeypatch):
    monkeypatch.setattr(common, "commit", lambda: "abc")
    asked, out = [], tmp_path / "rows.csv"

    def measure(plant, seed):
        asked.append((plant, seed))
        return [{"plant": plant, "seed": seed, "error": 10 * seed}]

    for keys in ([("b", 1)], [("a", 0), ("b", 0), ("a", 1), ("b", 1)]):
        common.carry_on(out, ("plant", "seed", "error", "commit"), ("plant", "seed"), keys, measure)
    assert asked == [("b", 1), ("a", 0), ("b", 0), ("a", 1)]
    assert [(row["plant"], row["seed"], row["error"]) for row in read_rows(out)] == [
        ("b", "1", "10"),
        ("a", "0", "0"),
        ("b", "0", "0"),
        ("a", "1", "10"),
    ]
    assert {row["commit"] for row in read_rows(out)} == {"abc"}


def test_a_command_that_leaves_nothing_says_why(tmp_path):
    with pytest.raises(RuntimeError, match="nowhere"):
        common.run_command("train", ["system=nowhere"], tmp_path, tmp_path / "metrics.json")
    assert not list(tmp_path.iterdir())


def test_every_constant_is_detuned_by_a_factor_of_its_own():
    nominal, other = TrasConstants(), common.detuned(TrasConstants(), 0.1, seed=3)
    values = [torch.tensor(dataclasses.astuple(p)[i]).flatten() for p in (other, nominal) for i in range(18)]
    factors = torch.cat(values[:18]) / torch.cat(values[18:])
    assert (factors - 1).abs().max() <= 0.1 + 1e-6 and (factors - 1).abs().mean() > 0.03
    assert factors.unique().numel() == factors.numel() == 24
    assert other == common.detuned(nominal, 0.1, seed=3) != common.detuned(nominal, 0.1, seed=4)
