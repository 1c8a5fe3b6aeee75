"""Statistics over seeds against SciPy and against known sampling distributions."""

import json

import numpy as np
import pytest
import torch
from scipy import stats

from dynasindy.evaluation.ablation import (
    bootstrap_interval,
    interquartile_mean,
    sweep_table,
)


@pytest.mark.parametrize("n", [1, 3, 4, 10, 13])
def test_interquartile_mean_is_scipy_trimmed_mean(n: int) -> None:
    values = torch.randn(5, n, dtype=torch.float64, generator=torch.Generator().manual_seed(n))
    expected = stats.trim_mean(values.numpy(), 0.25, axis=-1)
    np.testing.assert_allclose(interquartile_mean(values).numpy(), expected, rtol=1e-12)


def test_interval_is_seeded_and_leaves_the_global_generator_alone() -> None:
    scores = torch.rand(8, generator=torch.Generator().manual_seed(1))
    before = torch.random.get_rng_state()
    assert bootstrap_interval(scores, seed=4) == bootstrap_interval(scores, seed=4)
    assert bootstrap_interval(scores, seed=4) != bootstrap_interval(scores, seed=5)
    assert torch.equal(before, torch.random.get_rng_state())


def test_interval_is_scipy_s_percentile_bootstrap() -> None:
    scores = np.random.default_rng(4).gamma(2.0, size=20)

    def middle(x: np.ndarray, axis: int = -1) -> np.ndarray:
        return stats.trim_mean(x, 0.25, axis=axis)

    theirs = stats.bootstrap(
        (scores,), middle, confidence_level=0.95, n_resamples=20_000, method="percentile", random_state=0
    ).confidence_interval
    low, high = bootstrap_interval(torch.from_numpy(scores), resamples=20_000)
    width = theirs.high - theirs.low
    assert low.item() == pytest.approx(theirs.low, abs=0.03 * width)
    assert high.item() == pytest.approx(theirs.high, abs=0.03 * width)


def write(folder, name, trained, **more):
    run = folder / name
    run.mkdir(parents=True)
    evaluation = {"return": trained, "steady_state_error/alpha_a": 0.01, "rmse/alpha_a": 0.02}
    cost = {"real_steps": 600, "plant_seconds": 30.0, "wall_seconds": 100.0}
    (run / "metrics.json").write_text(
        json.dumps({"cost": cost, "untrained": {"return": -9.0}, "evaluation": evaluation} | more)
    )


def rows_of(folder):
    """Return the rows of the table of a sweep, without what stands above them."""
    lines = sweep_table(folder).splitlines()
    return lines[lines.index("") + 3 :]


def test_seeds_are_joined_and_settings_are_not(tmp_path):
    # The interquartile mean of 1, 2, 3, 100 is that of 2 and 3.
    for seed, trained in enumerate((1.0, 2.0, 3.0, 100.0)):
        write(tmp_path, f"{seed}_planning-dyna__seed-{seed}", trained)
    write(tmp_path, "4_planning-none__seed-0", -50.0)
    dyna, none = rows_of(tmp_path)
    assert "| 4 | 600 (30 s) | -9 [-9, -9] |" in dyna and "| 2.5 [" in dyna
    assert none.startswith("| `planning=none` | 1 |") and "| -50 |" in none


@pytest.mark.parametrize(
    ("part", "settings"),
    [
        (".", ["xi smoke direct", "xi smoke direct agent.critics=1", "xi smoke rollouts_0"]),
        ("xi", ["smoke direct", "smoke direct agent.critics=1", "smoke rollouts_0"]),
        ("xi/smoke/direct", ["agent.critics=1", "default"]),
    ],
)
def test_the_runs_of_an_ablation_are_found_from_each_of_its_folders(tmp_path, part, settings):
    for place in ("direct/seed_0", "direct/seed_1", "rollouts_0/seed_0", "direct/agent.critics-1/seed_3"):
        write(tmp_path / "xi" / "smoke", place, 1.0)
    rows = [row.split(" | ") for row in rows_of(tmp_path / part)]
    assert {row[0] for row in rows} == {f"| `{setting}`" for setting in settings}
    assert sum(int(row[1]) for row in rows) == (4 if "direct" not in part else 3)


def test_the_figures_of_two_seeds_stand_in_the_order_of_the_seeds_and_not_of_the_jobs(tmp_path):
    for job, seed, trained in ((9, 0, 3.0), (10, 1, 7.0)):
        write(tmp_path, f"{job}_planning-dyna__seed-{seed}", trained, seed=seed)
    (row,) = rows_of(tmp_path)
    assert "| 3, 7 |" in row


def test_a_run_without_a_finite_figure_is_counted_and_not_left_out(tmp_path):
    write(tmp_path, "0_planning-dyna__seed-0", 1.0)
    write(tmp_path, "1_planning-dyna__seed-1", None)
    (row,) = rows_of(tmp_path)
    assert "finite" in row


def test_a_fit_beside_the_runs_is_no_row(tmp_path):
    write(tmp_path, "0_seed-0", 1.0)
    fit = tmp_path / "identified"
    fit.mkdir()
    (fit / "metrics.json").write_text('{"open_loop_nrmse": {"h": 0.1}}')
    (fit / "report.txt").write_text("h' = -h")
    assert len(rows_of(tmp_path)) == 1


def test_each_cell_of_a_sweep_is_that_of_its_column(tmp_path):
    for seed in range(2):
        run = tmp_path / f"{seed}_planning-dyna__seed-{seed}"
        run.mkdir()
        errors = {"steady_state_error/a": 0.1 + seed, "steady_state_error/b": 0.3, "rmse/a": 0.5, "rmse/b": 0.7}
        cost = {"real_steps": 1800, "plant_seconds": 90.0, "wall_seconds": 11.0}
        record = {"cost": cost, "untrained": {"return": -9.0}, "evaluation": {"return": 4.0, **errors}}
        (run / "metrics.json").write_text(json.dumps(record))
    seeds, axes, _, head, _, row = sweep_table(tmp_path).splitlines()
    assert "fewer" in seeds
    assert "slash" in axes
    cells = dict(zip(head.strip("| ").split(" | "), row.strip("| ").split(" | "), strict=True))
    assert cells.pop("steady-state error, per axis [rad]") == "0.1, 1.1 / 0.3, 0.3"
    assert cells == {
        "setting": "`planning=dyna`",
        "seeds": "2",
        "real steps (plant time)": "1800 (90 s)",
        "return, untrained": "-9, -9",
        "return, trained": "4, 4",
        "RMSE, per axis [rad]": "0.5, 0.5 / 0.7, 0.7",
        "wall time of a run [s]": "11, 11",
    }
