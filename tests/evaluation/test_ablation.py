"""Tables of an ablation, and statistics over seeds against SciPy."""

import json
import math

import numpy as np
import pytest
import torch
from scipy import stats

from dynasindy.evaluation.ablation import (
    Level,
    bootstrap_interval,
    gather,
    interquartile_mean,
    read_ablation,
    sweep_table,
    to_markdown,
)
from dynasindy.safe_io import DamagedFileError

LEVEL = Level(0.05, 3)


def gathered(*arguments):
    """Return the rows of the table as records, which lack what is not measured."""
    return [row.dropna().to_dict() for _, row in gather(*arguments).iterrows()]


HEADER = (
    "episode,return,real_steps,plant_seconds,imagined_transitions,updates,wall_seconds,"
    "evaluated_return,evaluated_steady_state_error/y,evaluated_steady_state_error/z"
)


def run_folder(root, setting, seed, errors, system="xi", experiment="dyna"):
    """Write a finished run whose n-th evaluation has the n-th error on axis z and half of it on y."""
    folder = root / system / experiment / setting / f"seed_{seed}"
    folder.mkdir(parents=True)
    (folder / "metrics.json").write_text(json.dumps({"seed": seed}))
    lines = [f"{n},-1,{200 + 400 * n},{10 + 20 * n},{100 * n},{50 * n},{7 * n},{-100 * e},{e / 2},{e}"
             for n, e in enumerate(errors, start=1)]  # fmt: skip
    (folder / "progress.csv").write_text("\n".join([HEADER, *lines]) + "\n")
    return folder


@pytest.mark.parametrize(
    ("errors", "place"),
    [
        ([0.05, 0.05, 0.05], 2),
        ([0.04, 0.04, 0.06, 0.04, 0.04, 0.04, 0.9], 5),
        ([0.04, 0.04, 0.06], None),
        ([math.inf, 0.01, 0.01], None),
    ],
)
def test_the_level_counts_where_the_last_of_three_evaluations_holds_it(errors, place):
    assert LEVEL.reached(errors) == place


def test_a_run_is_judged_by_its_worse_axis_and_priced_where_it_reached_the_level(tmp_path):
    run_folder(tmp_path / "runs", "s", 0, [0.2, 0.05, 0.04, 0.03, 0.08])
    (row,) = gathered(tmp_path / "runs", tmp_path, LEVEL)
    assert row["episodes_to_level"] == 4 and row["real_steps_to_level"] == 1800 and row["plant_seconds_to_level"] == 90
    assert row["updates_to_level"] == 200 and row["imagined_to_level"] == 400
    assert row["return_at_level"] == pytest.approx(-3.0)
    assert row["area_under_curve"] == pytest.approx(-8.0) and row["final_return"] == pytest.approx(-8.0)
    assert row["steady_state_error"] == 0.08 and row["steady_state_error/y"] == 0.04


def test_episodes_without_an_evaluation_are_left_out(tmp_path):
    folder = run_folder(tmp_path / "runs", "s", 0, [0.04, 0.04, 0.04])
    text = (folder / "progress.csv").read_text().replace("-4.0,0.02,0.04", ",,", 1)
    (folder / "progress.csv").write_text(text)
    (row,) = gathered(tmp_path / "runs", tmp_path, LEVEL)
    assert "episodes_to_level" not in row and row["episodes"] == 3
    assert len(read_ablation(tmp_path / "ablation_curves.csv")) == 2


@pytest.mark.parametrize("name", ["ablation.csv", "ablation_curves.csv"])
@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("\n", "its first line is no line of different headings"),
        ("system,setting\nxi,s\n", "it lacks 'experiment'"),
        ("system,experiment,setting,seed\nxi,dyna,s,one\n", "could not convert"),
    ],
)
def test_a_table_that_cannot_be_read_is_told_and_no_file_changes(tmp_path, name, text, why):
    run_folder(tmp_path / "one", "a", 0, [0.04])
    gather(tmp_path / "one", tmp_path, LEVEL)
    (tmp_path / name).write_text(text)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()}
    run_folder(tmp_path / "two", "b", 0, [0.04])
    with pytest.raises(DamagedFileError) as told:
        gather(tmp_path / "two", tmp_path, LEVEL)
    assert str(tmp_path / name) in str(told.value) and why in str(told.value)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()} == before
    (tmp_path / name).rename(tmp_path / "moved")
    assert "b" in set(gather(tmp_path / "two", tmp_path, LEVEL)["setting"])


def test_rows_of_other_settings_stay_and_those_of_the_same_are_replaced(tmp_path):
    run_folder(tmp_path / "one", "a", 0, [0.04])
    run_folder(tmp_path / "one", "b", 0, [0.04])
    gather(tmp_path / "one", tmp_path, LEVEL)
    run_folder(tmp_path / "two", "b", 5, [0.03])
    rows = gathered(tmp_path / "two", tmp_path, LEVEL)
    assert [(row["setting"], row["seed"]) for row in rows] == [("a", 0), ("b", 5)]
    written = read_ablation(tmp_path / "ablation.csv")
    assert [(row["seed"], row["steady_state_error"]) for _, row in written.iterrows()] == [(0, 0.04), (5, 0.03)]


def test_settings_changed_on_the_command_line_are_settings_of_their_own(tmp_path):
    run_folder(tmp_path / "runs", "a/train.episodes-1__agent.tau-1e-3", 0, [0.04])
    (row,) = gathered(tmp_path / "runs", tmp_path, LEVEL)
    assert row["setting"] == "a,train.episodes=1,agent.tau=1e-3"


def test_the_table_has_interquartile_means_and_says_never(tmp_path):
    for seed, episodes in enumerate([3, 4, 4, 5, 30]):  # the middle three of five: (4 + 4 + 5) / 3
        run_folder(tmp_path / "runs", "good", seed, [0.2] * (episodes - 3) + [0.04] * 3)
    for seed in range(5):
        run_folder(tmp_path / "runs", "bad", seed, [0.04, 0.04] if seed else [0.04] * 3)
    text = to_markdown(gather(tmp_path / "runs", tmp_path, LEVEL), LEVEL)
    assert "fewer" in text
    bad, good = text.splitlines()[-2:]
    assert good.startswith("| xi | dyna | good | 5 | 3 or 4 or 5 or 30 | 5/5 | 4.333 [3")
    assert bad.startswith("| xi | dyna | bad | 5 | 2 or 3 | 1/5 | never [")
    assert (tmp_path / "ablation.md").read_text() == text


def mixed_run(root, setting, errors, units=("m/s", "rad")):
    """Make a run of `run_folder` one of a vessel: y within a range of 2 m/s, z of 0.5 rad."""
    folder = run_folder(root, setting, 0, errors, "vessel")
    metrics = {"seed": 0, "units": dict(zip(("y", "z"), units)), "ranges": {"y": 2.0, "z": 0.5}}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    return folder


def test_outputs_in_different_units_are_judged_by_their_share_of_the_target_range(tmp_path):
    # Of z 0.04 is 8 % of 0.5, of y 0.02 is 1 % of 2: the level of 5 % is held at 0.025 and below.
    mixed_run(tmp_path / "runs", "s", [0.04, 0.04, 0.04, 0.02, 0.025, 0.02, 0.01])
    (row,) = gathered(tmp_path / "runs", tmp_path, LEVEL)
    assert row["episodes_to_level"] == 6 and row["steady_state_share"] == pytest.approx(0.02)
    assert "steady_state_error" not in row and row["steady_state_error/z"] == 0.01
    text = (tmp_path / "ablation.md").read_text()
    assert "evaluations" in text and " rad" not in text and "[rad]" not in text
    head, _, cells = text.splitlines()[-3:]
    found = dict(zip(head.strip("| ").split(" | "), cells.strip("| ").split(" | "), strict=True))
    assert found["steady-state error [% of the target range]"] == "2"
    lines = read_ablation(tmp_path / "ablation_curves.csv")
    assert lines["steady_state_share"].tolist()[:4] == pytest.approx([0.08, 0.08, 0.08, 0.04])


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


def test_a_run_without_a_finite_figure_is_counted_and_not_left_out(tmp_path):
    write(tmp_path, "0_planning-dyna__seed-0", 1.0)
    write(tmp_path, "1_planning-dyna__seed-1", None)
    (row,) = rows_of(tmp_path)
    assert "finite" in row


def test_plans_from_logs_have_a_table_of_what_is_predicted(tmp_path):
    for seed, flights in enumerate(([{"share": {"a": 0.02, "b": 0.5}}, {"share": {"a": 0.1, "b": 0.3}}], [None])):
        (run := tmp_path / f"{seed}_seed-{seed}").mkdir()
        record = {"seed": seed, "prediction": {"controlled": seed == 0, "flights": flights}}
        (run / "metrics.json").write_text(json.dumps(record))
    (row,) = rows_of(tmp_path)
    assert row == "| `default` | 2 | 1 of 2 | 50, not finite |"
    (run / "report.txt").write_text("y' = -y")  # a fit by identify.py, which is no row
    write(tmp_path, "2_on=plant", 4.0)  # which has a table of its own
    assert [row for row in rows_of(tmp_path) if "| 1 of 1 | 50 |" in row]
    assert "`on=plant` | 1 | 600" in sweep_table(tmp_path)


def test_each_cell_of_a_sweep_is_that_of_its_column(tmp_path):
    for seed in range(2):  # by their folders, the tenth job is before the ninth
        errors = {"steady_state_error/a": 0.1 + seed, "steady_state_error/b": 0.3, "rmse/a": 0.5, "rmse/b": 0.7}
        found, name = {"return": 4.0, **errors}, f"{9 + seed}_planning-dyna__seed-{seed}"
        write(tmp_path, name, 4.0, seed=seed, evaluation=found)
    seeds, axes, _, head, _, row = sweep_table(tmp_path).splitlines()
    assert "fewer" in seeds
    assert "slash" in axes
    cells = dict(zip(head.strip("| ").split(" | "), row.strip("| ").split(" | "), strict=True))
    assert cells.pop("steady-state error, per axis [rad]") == "0.1, 1.1 / 0.3, 0.3"
    assert cells == {
        "setting": "`planning=dyna`",
        "seeds": "2",
        "real steps (plant time)": "600 (30 s)",
        "return, untrained": "-9, -9",
        "return, trained": "4, 4",
        "RMSE, per axis [rad]": "0.5, 0.5 / 0.7, 0.7",
        "wall time of a run [s]": "100, 100",
    }
