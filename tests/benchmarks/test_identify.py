"""The identification benchmark at small size: what it counts is right, and its easy cases hold."""

import csv

import pytest
import torch
from benchmarks import identify
from benchmarks.arguments import parsed

from dynasindy.systems import Xi


def test_the_true_table_is_the_published_one():
    truth = identify.true_table()
    assert int((truth != 0).sum()) == 19
    assert float(truth.abs().max()) == pytest.approx(3.7e4)


def test_ten_seconds_without_noise_give_the_plant():
    rows = identify.noise_free(10.0, 0.01, 1e-6, 1)
    assert rows[0]["value"] == "1 of 1"
    assert float(rows[1]["value"]) < 1e-6


def test_control_rate_data_give_the_plant():
    rows = identify.noise_free(20.0, 0.05, 1e-4, 1)
    assert rows[0]["value"] == "1 of 1"
    assert float(rows[1]["value"]) < 1e-4


def test_pysindy_is_nearly_exact_once_it_has_the_integral_form_and_scaled_rates():
    values = [row["value"] for row in identify.pysindy_rows(1) if "10 s" in row["measure"]]
    default, best, given, exact, scaled, scaled_exact = values
    counts = [tuple(map(float, value.split(", ")[:2])) for value in (default, best, given, scaled)]
    assert all(false > 20 for _, false in counts[:2])
    assert all(true >= 18 and false <= 8 for true, false in counts[2:])
    assert {exact, scaled_exact} <= {"0 of 1", "1 of 1"}


@pytest.mark.slow
def test_the_rotor_model_of_tras_predicts_episodes():
    rows = identify.tras(1)
    assert float(rows[0]["value"]) < 2.0


def test_rows_of_other_cases_stay_in_the_file(tmp_path, monkeypatch):
    path = tmp_path / "table.csv"
    quick = {name: lambda seeds, name=name: [identify.row(name, "m", str(seeds))] for name in ("first", "second")}
    monkeypatch.setattr(identify, "CASES", quick)
    monkeypatch.setattr(identify, "commit", lambda: "abc")
    identify.main(parsed("identify", ["--seeds", "1", "--out", str(path)]))
    monkeypatch.setattr(identify, "commit", lambda: "def")
    second = parsed("identify", ["--seeds", "2", "--out", str(path)])
    second.only = ["second"]
    identify.main(second)
    with path.open() as file:
        kept = [(r["case"], r["value"], r["commit"]) for r in csv.DictReader(file)]
    assert kept == [("first", "1", "abc"), ("second", "2", "def")]


@pytest.mark.parametrize(("seeds", "written"), [("9", False), ("10", True)])
def test_a_quick_look_leaves_the_published_figures(tmp_path, monkeypatch, seeds, written):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(identify, "CASES", {"first": lambda seeds: [identify.row("m", "what", str(seeds))]})
    identify.main(parsed("identify", ["--seeds", seeds]))
    assert identify.RESULTS.is_file() == written


def test_the_plant_of_the_noise_free_cases_is_that_of_the_package():
    data = identify.xi_recording(0.1, 0.01, 0)
    assert torch.allclose((data.x_next[0] - data.x[0]) / 0.01, Xi()(data.x[0], data.u[0]), rtol=0.2, atol=1.0)
