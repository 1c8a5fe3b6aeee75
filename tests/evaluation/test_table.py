import json

import pytest

from dynasindy.evaluation.table import sweep_table


def write(folder, name, trained):
    run = folder / name
    run.mkdir(parents=True)
    evaluation = {"return": trained, "steady_state_error/alpha_a": 0.01, "rmse/alpha_a": 0.02}
    cost = {"real_steps": 600, "plant_seconds": 30.0, "wall_seconds": 100.0}
    (run / "metrics.json").write_text(
        json.dumps({"cost": cost, "untrained": {"return": -9.0}, "evaluation": evaluation})
    )


def test_seeds_are_joined_and_settings_are_not(tmp_path):
    # The interquartile mean of 1, 2, 3, 100 is that of 2 and 3.
    for seed, trained in enumerate((1.0, 2.0, 3.0, 100.0)):
        write(tmp_path, f"{seed}_planning=dyna,seed={seed}", trained)
    write(tmp_path, "4_planning=none,seed=0", -50.0)
    dyna, none = sweep_table(tmp_path).splitlines()[2:]
    assert dyna.startswith("| `planning=dyna` | 4 | 600 (30 s) | -9") and "| 2.5 [" in dyna
    assert none.startswith("| `planning=none` | 1 |") and "| -50 [-50, -50] |" in none


def test_a_run_without_a_finite_figure_is_counted_and_not_left_out(tmp_path):
    write(tmp_path, "0_planning=dyna,seed=0", 1.0)
    write(tmp_path, "1_planning=dyna,seed=1", None)
    (row,) = sweep_table(tmp_path).splitlines()[2:]
    assert "| not finite in 1 of 2 |" in row


def test_a_folder_without_finished_runs_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no finished run"):
        sweep_table(tmp_path)
