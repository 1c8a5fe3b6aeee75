"""The benchmark of planning by gradient: its rows, its plants, and how it is carried on."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from benchmark import parse
from benchmarks import gradient

from dynasindy.safe_io import read_rows

ROOT = Path(__file__).parents[2]
TINY = {"updates": 2, "more_updates": 1, "rollouts": 4, "window": 5}


@pytest.fixture
def unjudged(monkeypatch):
    numbers = {"azimuth": 0.1, "pitch": 0.2, "azimuth_worst": 0.3, "pitch_worst": 0.4, "return": 1.0}
    monkeypatch.setattr(gradient, "judge", lambda case, plant, parts, seed: [("step", "error", dict(numbers))])


def test_every_phase_has_a_row_that_counts_all_seconds_of_plant_time(unjudged):
    rows = gradient.measure("step", "xi", 0, **TINY)
    assert [row["plant_seconds"] for row in rows] == [10.0, 30.0]
    assert [row["updates"] for row in rows] == [2, 3]
    assert all(set(row) == set(gradient.COLUMNS) for row in rows)


def test_noise_is_in_the_data_of_the_cases_with_noise_only():
    for name, std in (("noise", gradient.NOISE), ("step", (0.0,) * 6)):
        parts = gradient.build_recipe(gradient.CASES[name], "xi", 0, TINY).build()
        calm, seen = (env.rollout(50, parts.excitation) for env in (parts.plant, parts.env))
        spread = (seen["next", "samples"] - calm["next", "samples"]).std((0, 1))
        torch.testing.assert_close(spread, torch.tensor(std, dtype=spread.dtype), rtol=0.3, atol=0)


def test_the_bench_sees_no_rates_and_its_delay_is_in_the_data():
    starts = {}
    for name in ("bench", "bench_delay"):
        parts = gradient.build_recipe(gradient.CASES[name], "xi", 0, TINY).build()
        seen = parts.env.rollout(3, parts.excitation)
        assert seen["next", "samples"].isnan().all(0).all(0).tolist() == [False, False, True, True, False, False]
        u = seen["action"][0] if name == "bench" else torch.zeros(2)
        first = parts.plant.advance(torch.zeros(6).double(), u.double())[0][-1]
        starts[name] = (seen["next", "true_state"][0] - first).abs().max().item()
    assert starts == {"bench": 0.0, "bench_delay": 0.0}


def test_a_case_behind_sensors_tells_errors_inputs_and_consistency():
    case = replace(gradient.CASES["bench"], oracle=True)
    recipe = gradient.build_recipe(case, "xi", 0, TINY)
    parts = recipe.build()
    gradient.train(parts, recipe.train, gradient.Callback())
    rows = {scenario: numbers for scenario, _, numbers in gradient.judge(case, "xi", parts, 0)}
    assert list(rows) == ["step", "step_inputs", "step_nis"]
    assert 0.8 < rows["step_nis"]["azimuth"] < 1.3 and 0 < rows["step_inputs"]["azimuth"] < 0.1


def test_changes_of_inputs_are_those_of_the_last_5_s():
    u = torch.zeros(1, 400, 2)
    u[:, ::2, 0], u[:, 300:, 1] = 1.0, torch.arange(100) * 0.01
    u[:, :299, 1] = torch.rand(299)
    result = SimpleNamespace(inputs=u, time=torch.arange(400) * 0.05, seconds=20.0)
    torch.testing.assert_close(gradient._changes(result), torch.tensor([[1.0, 0.01]]))


def test_rows_already_in_the_file_are_not_measured_again(tmp_path, monkeypatch, capsys):
    calls = []

    def measured(case, plant, seed):
        calls.append(seed)
        values = dict.fromkeys(gradient.COLUMNS, 1.0)
        return [{**values, "case": case, "plant": plant, "seed": seed, "scenario": "step"}]

    monkeypatch.setattr(gradient, "measure", measured)
    options = ["--cases", "step", "--plants", "xi", "--out", str(tmp_path / "gradient.csv")]
    gradient.main(parse("gradient", [*options, "--seeds", "0"]))
    gradient.main(parse("gradient", [*options, "--seeds", "0", "1"]))
    assert calls == [0, 1]
    assert len(read_rows(tmp_path / "gradient.csv")) == 2
    assert "step" in capsys.readouterr().out.splitlines()[-1]
