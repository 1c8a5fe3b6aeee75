"""A benchmark goes on where its file ends, and a command is called as a user calls it."""

import csv
from argparse import Namespace

from benchmarks.training import called, over_seeds


def test_what_the_file_has_is_not_measured_again(tmp_path, capsys):
    asked, out = [], tmp_path / "rows.csv"

    def measure(plant, seed):
        asked.append((plant, seed))
        return [{"plant": plant, "seed": seed, "error": 10 * seed}]

    def run(plants, seeds):
        over_seeds(Namespace(plants=plants, seeds=seeds, out=out), ("plant", "seed", "error"), measure)

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
    spent, complaint = called("train", ["system=nowhere"], tmp_path)
    assert "nowhere" in complaint and 0 < spent < 600
    assert not list(tmp_path.iterdir())
