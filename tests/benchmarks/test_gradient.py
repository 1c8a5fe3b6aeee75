"""Planning by gradient on both plants: rows of the command, and its sensors."""

import torch
from benchmark import parse
from benchmarks import gradient

from dynasindy.safe_io import read_rows

TINY = {"updates": 2, "more_updates": 1, "rollouts": 4, "window": 5}


def test_every_phase_has_a_row_that_counts_all_seconds_and_is_not_measured_again(tmp_path, monkeypatch):
    build, calls = gradient.build_recipe, []
    monkeypatch.setattr(gradient, "build_recipe", lambda *of: calls.append(of[2]) or build(*of[:3], TINY))
    options = ["--cases", "step", "--plants", "xi", "--out", str(tmp_path / "gradient.csv"), "--seeds", "0"]
    for _ in range(2):
        gradient.main(parse("gradient", options))
    rows = read_rows(tmp_path / "gradient.csv")
    assert tuple(rows[0]) == gradient.COLUMNS and calls == [0]
    assert [(row["plant_seconds"], row["updates"]) for row in rows] == [("10.0", "2"), ("30.0", "3")]
    # After a few updates the plant is still on its way, and no farther from a target than the range of targets is wide.
    assert all(0 < float(row["azimuth"]) < float(row["azimuth_worst"]) < 1.0 for row in rows)
    assert float(rows[1]["azimuth"]) < float(rows[0]["azimuth"])
    assert 0 < float(rows[0]["cpu_seconds"]) < float(rows[1]["cpu_seconds"])


def test_noise_is_in_the_data_of_the_cases_with_noise_only():
    for name, std in (("noise", gradient.NOISE), ("step", (0.0,) * 6)):
        parts = gradient.build_recipe(gradient.CASES[name], "xi", 0, TINY).build()
        calm, seen = (env.rollout(50, parts.excitation) for env in (parts.plant, parts.env))
        spread = (seen["next", "samples"] - calm["next", "samples"]).std((0, 1))
        torch.testing.assert_close(spread, torch.tensor(std, dtype=spread.dtype), rtol=0.3, atol=0)
