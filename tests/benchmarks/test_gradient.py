"""The benchmark of planning by gradient: its rows, its plants, and how it is carried on."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from dynasindy.benchmarks import gradient
from dynasindy.evaluation.rows import read_rows

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
        calm = parts.plant.rollout(50, parts.excitation)
        parts.replay.extend_real(calm)
        spread = (parts.replay.real[:]["next", "samples"] - calm["next", "samples"]).std((0, 1))
        torch.testing.assert_close(spread, torch.tensor(std, dtype=spread.dtype), rtol=0.3, atol=0)


def test_rows_already_in_the_file_are_not_measured_again(tmp_path, monkeypatch, capsys):
    calls = []

    def measured(case, plant, seed):
        calls.append(seed)
        values = dict.fromkeys(gradient.COLUMNS, 1.0)
        return [{**values, "case": case, "plant": plant, "seed": seed, "scenario": "step"}]

    monkeypatch.setattr(gradient, "measure", measured)
    options = ["--cases", "step", "--plants", "xi", "--out", str(tmp_path / "gradient.csv")]
    gradient.main([*options, "--seeds", "0"])
    gradient.main([*options, "--seeds", "0", "1"])
    assert calls == [0, 1]
    assert len(read_rows(tmp_path / "gradient.csv")) == 2
    assert "step" in capsys.readouterr().out.splitlines()[-1]


def test_inputs_are_late_in_flight_and_not_in_the_data():
    env = gradient.build_recipe(gradient.CASES["late"], "xi", 0, TINY).build().plant
    (late,) = gradient._in_flight(gradient.CASES["late"], 0)
    policy = late(lambda tensordict: tensordict.set("action", torch.ones(2)), env)
    actions = env.rollout(3, policy)["action"]
    assert actions[:, 0].tolist() == [0.0, 1.0, 1.0]
    assert gradient._in_flight(gradient.CASES["step"], 0) == []


def test_what_nothing_was_tuned_on_is_flown_by_the_policies_of_the_tuned_cases(monkeypatch):
    assert gradient.CASES["unseen"] == replace(gradient.CASES["step"], episodes=0, unseen=True)
    assert gradient.CASES["unseen_moving"] == replace(gradient.CASES["moving"], unseen=True)
    asked = {}

    def flown(name):
        def fly(env, policy, *box):
            asked[name] = (env, policy, *box)
            return iter([(name, "m", "result", "errors")])

        return fly

    monkeypatch.setattr(gradient, "holding", flown("holding"))
    monkeypatch.setattr(gradient, "following", flown("following"))
    monkeypatch.setattr(gradient, "_numbers", lambda result, errors: {"azimuth": (result, errors)})
    parts = SimpleNamespace(plant="env", agent=SimpleNamespace(deployed="policy"))
    for case in ("unseen", "unseen_moving"):
        ((_, metric, numbers),) = gradient.judge(gradient.CASES[case], "tras", parts, 3)
        assert metric == "m" and numbers == {"azimuth": ("result", "errors")}
    assert asked == {
        "holding": ("env", "policy", (-0.5, -0.5), (0.5, 0.4), gradient.NOISE, 3),
        "following": ("env", "policy"),
    }
