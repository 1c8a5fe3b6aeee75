"""Sections for the engineer, against tables that are written by hand."""

import csv

import pytest

from dynasindy.viz.report import engineering
from dynasindy.viz.report.document import Picture, Table, Text

RIGS = ("rig", "model", "metric", "value", "unit", "coefficients", "delay_seconds", "cpu_seconds", "commit")
TEST = "test simulated, RMSE"


def write(results, name, header, rows):
    with (results.folder / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def row(model, metric, value, rig="tanks"):
    return dict(zip(RIGS, (rig, model, metric, value, "V", "", "", "", "abc"), strict=True))


def parts(section, kind):
    return [part for part in section.parts if isinstance(part, kind)]


def test_the_newest_score_of_each_model_on_a_test_log_is_kept():
    rows = [row("ours", TEST, "0.3"), row("ours, earlier", TEST, "0.1"), row("ours", "train simulated, RMSE", "0.1")]
    rows += [row("ours", TEST, "0.2"), row("linear", TEST, "0.4")]
    assert [(found["model"], found["value"]) for found in engineering.scored(rows)] == [
        ("ours", "0.2"),
        ("linear", "0.4"),
    ]


def test_bars_are_as_long_as_the_errors_and_lines_stand_where_others_are():
    figure = engineering.errors([row("ours", TEST, "0.2"), row("pysindy", TEST, "2.5")], {"best published": 0.191})
    (axis,) = figure.axes
    widths = {
        label.get_text(): bar.get_width() for label, bar in zip(axis.get_yticklabels(), axis.patches, strict=True)
    }
    assert widths == {"PySINDy": 2.5, "ours": 0.2}
    assert [tuple(line.get_xdata()) for line in axis.lines] == [(0.191, 0.191)]
    low, high = axis.get_xlim()
    assert low < 0.191 and high > 2.5


@pytest.mark.parametrize("others", [["ours"], []])
def test_a_model_that_runs_away_has_words_in_the_place_of_a_bar(others):
    figure = engineering.errors([row("linear", TEST, "inf"), *(row(name, TEST, "0.2") for name in others)], {})
    (axis,) = figure.axes
    assert [text.get_text() for text in axis.texts] == ["runs away", *("0.2" for _ in others)]
    assert axis.patches[0].get_width() == axis.get_xlim()[0]


def test_bars_have_at_least_two_labels_below_them_and_no_digit_that_was_not_measured():
    rows = [row("ours", TEST, "72.37"), row("held", TEST, "2409.0")]
    for few in (rows[:1], rows):
        figure = engineering.errors(few, {})
        (axis,) = figure.axes
        low, high = axis.get_xlim()
        shown = [place for place in axis.get_xticks() if low <= place <= high]
        assert len(shown) >= 2 and all(axis.xaxis.get_major_formatter()(place) for place in shown)
    assert {text.get_text() for text in axis.texts} == {"72.37", "2409"}


def test_errors_over_a_log_are_drawn_with_ours_first(empty):
    rows = [("tanks", "linear", 0, 0.5, "V", "abc"), ("tanks", "linear", 4, -0.25, "V", "abc")]
    rows += [("tanks", "ours", 0, 0.0, "V", "abc"), ("tanks", "ours", 4, 0.125, "V", "abc")]
    header = ("rig", "model", "seconds", "error", "unit", "commit")
    figure = engineering.over_time([dict(zip(header, map(str, row), strict=True)) for row in rows])
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["ours", "linear"]
    assert figure.axes[1].lines[0].get_xydata().tolist() == [[0, 0.5], [4, -0.25]]
    write(
        empty, "rigs.csv", RIGS, [row_.values() for row_ in (row("ours", TEST, "0.2"), row("ours", TEST, "3", "qube"))]
    )
    write(empty, "rigs_over_time.csv", header, rows)
    pictures = [picture.name for picture in parts(engineering.real_logs(empty), Picture)]
    assert pictures == ["rig_tanks", "rig_tanks_over_time", "rig_qube"]


def test_a_plant_that_was_not_measured_is_named(empty):
    assert all("rigs --data FOLDER` makes it" in part.words for part in parts(engineering.real_logs(empty), Text)[1:])
    write(empty, "rigs.csv", RIGS, [row("ours", TEST, "0.2").values()])
    section = engineering.real_logs(empty)
    assert [picture.name for picture in parts(section, Picture)] == ["rig_tanks"]
    missing = [part.words for part in parts(section, Text)[1:]]
    assert [words.rpartition(" ")[2] for words in missing] == ["`emps`.", "it.", "`qube`."]
    assert "/rigs_over_time.csv`" in missing[1]


def test_the_least_margin_of_any_seed_counts_and_unstable_plants_are_added_up(empty):
    header = ("plant", "planning", "seed", "gain", "phase_deg", "delay_s", "disk", "draws", "unstable_draws", "commit")
    rows = [
        ("xi", "gradient", 0, 2.5, 44.0, 0.07, 0.7, 20, 1, "abc"),
        ("xi", "gradient", 1, 3.5, 40.0, 0.09, 0.8, 20, 2, "abc"),
    ]
    write(empty, "margins.csv", header, rows)
    (table,) = parts(engineering.margins(empty), Table)
    assert table.rows == [["xi", "gradient", "2", "2.5", "40", "0.07", "0.7", "3 of 40"]]
