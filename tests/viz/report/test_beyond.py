import csv

import numpy as np
import pytest
from benchmarks.arguments import REPORTED

from dynasindy.viz.report import beyond
from dynasindy.viz.report.document import Picture, Table, Text
from dynasindy.viz.report.sources import Results


def one(section, kind):
    (part,) = [part for part in section.parts if isinstance(part, kind)]
    return part


@pytest.mark.parametrize(
    ("build", "command"),
    [
        (beyond.baselines, "python scripts/benchmark.py baselines"),
        (beyond.identification, "python scripts/benchmark.py identify"),
        (beyond.speed, "python scripts/benchmark.py td3"),
    ],
)
def test_a_table_that_is_missing_leaves_the_command_that_makes_it(empty, build, command):
    assert f"`{command}` makes it." in one(build(empty), Text).words


def test_baselines_are_means_over_seeds(empty):
    header = [
        "plant",
        "controller",
        "model",
        "seed",
        "real_seconds",
        "scenario",
        "metric",
        "azimuth",
        "pitch",
        "ms_per_action",
    ]
    rows = [
        ["xi", name, "sindy", seed, 10, "step", metric, factor * seed, 0.02, 1.5]
        for name, factor in (("mpc", 0.01), ("pid", 0.04))
        for seed in (1, 2, 3)
        for metric in ("rmse", "control_variation")
    ]
    with (empty.folder / "baselines.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    table = one(beyond.baselines(empty), Table)
    assert list(table.header[4:]) == ["RMSE [rad]", "control variation [1/s]", "ms per action"]
    assert table.rows == [
        ["mpc", "sindy", "10", "3", "0.02 / 0.02", "0.02 / 0.02", "1.5"],
        ["pid", "sindy", "10", "3", "0.08 / 0.02", "0.08 / 0.02", "1.5"],
    ]


def test_one_or_two_seeds_stand_for_themselves():
    rows = [{"k": "a", "seed": s, "v": v} for s, v in (("0", "0.1234"), ("1", "2"))]
    assert beyond._grouped(rows, ["k"], ["v"]) == [["a", "2", "0.123, 2"]]
    assert beyond._grouped(rows[:1], ["k"], ["v"]) == [["a", "1", "0.123"]]


def test_the_gradient_table_groups_seeds_and_shows_the_worst(empty):
    columns = (
        "case,plant,seed,plant_seconds,scenario,metric,azimuth,pitch,azimuth_worst,pitch_worst,return,wall_seconds"
    )
    lines = [f"step,xi,{seed},10.0,step,m,{0.1 * seed},0.2,0.3,0.4,{seed},7" for seed in range(4)]
    (empty.folder / "gradient.csv").write_text("\n".join([columns, *lines]) + "\n")
    section = beyond.gradient(empty)
    # Of 0, 1, 2, 3 the interquartile mean keeps 1 and 2.
    (row,) = one(section, Table).rows
    words = ["xi", "trained on steps", "64 steps", "10.0", "4", "m"]
    assert row == [*words, "0.15", "0.2", "0.3", "0.4", "1.5", "7"]
    missing = [part.words for part in section.parts if isinstance(part, Text) and "no saved run" in part.words]
    assert len(missing) == 6 and "python scripts/train.py system=xi folder=runs/xi_gradient" in missing[0]


def test_what_is_no_error_stands_in_tables_of_its_own_and_names_are_words(empty):
    columns = (
        "case,plant,seed,plant_seconds,scenario,metric,azimuth,pitch,azimuth_worst,pitch_worst,return,wall_seconds"
    )
    lines = [
        "unseen_moving,xi,0,10.0,staircase,mean_abs_error_last_5s,0.1,0.2,0.3,0.4,5,7",
        "detuned,xi,0,10.0,detuned_gust_integral,max_abs_error_5s_after_gust,0.1,0.2,0.3,0.4,5,7",
        "noise,xi,0,10.0,step_integral_inputs,mean_abs_change_per_period_last_5s,0.01,0.02,0.03,0.04,5,7",
        "noise,xi,0,10.0,step_nis,mean_nis,1.5,1.5,1.6,1.6,5,7",
    ]
    (empty.folder / "gradient.csv").write_text("\n".join([columns, *lines]) + "\n")
    errors, inputs, nis = [part for part in beyond.gradient(empty).parts if isinstance(part, Table)]
    assert [row[1:7] for row in errors.rows] == [
        [
            "trained on steps, sines and squares, flown elsewhere",
            *("eight targets, one after the other", "10.0", "1", "mean error of the last 5 s", "0.1"),
        ],
        [
            "flown with constants off by up to 10 %",
            *("64 steps in a gust, integral action", "10.0", "1", "largest error from 5 s after the gust", "0.1"),
        ],
    ]
    assert list(inputs.header[-2:]) == ["tail input [-]", "main input [-]"]
    case = "noise on all states, behind an observer"
    assert inputs.rows == [["xi", case, "64 steps, integral action", "10.0", "1", "0.01", "0.02"]]
    assert nis.rows == [["xi", case, "64 steps", "10.0", "1", "1.5"]] and nis.header[-1] == "mean [-]"


def test_every_case_that_is_reported_has_words():
    assert set(REPORTED) == set(beyond.CASE_WORDS)
    assert not any("_" in words for words in (*beyond.CASE_WORDS.values(), *beyond.FLIGHT_WORDS.values()))


def test_a_trained_run_is_drawn_in_three_scenarios(results, tmp_path):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "xi_gradient").symlink_to(results.folder / "runs" / "xi_dyna_rollouts_800")
    section = beyond.gradient(Results(tmp_path, {"xi_gradient": {}}))
    figures = {part.name: part.figure for part in section.parts if isinstance(part, Picture)}
    assert list(figures) == ["gradient_step_xi", "gradient_sine_xi", "gradient_square_xi"]
    reference, policy = figures["gradient_step_xi"].axes[1].lines[:2]
    np.testing.assert_allclose(reference.get_ydata() - policy.get_ydata(), 0.01)


def test_the_gates_decisions_are_drawn(results):
    picture = one(beyond.trust(results), Picture)
    assert picture.name == "gate_xi_dyna" and "made by `python scripts/x.py`" in picture.source


def test_cells_without_numbers_are_counted():
    rows = [{"k": "a", "seed": s, "v": v} for s, v in (("0", ""), ("1", "2"))]
    assert beyond._grouped(rows, ["k"], ["v"]) == [["a", "2", "none in 1 of 2"]]
