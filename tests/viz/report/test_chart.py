import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from dynasindy.viz.framework import framework
from dynasindy.viz.gate import gate
from dynasindy.viz.learning import average_rewards
from dynasindy.viz.report.chart import chart, plain
from dynasindy.viz.response import step_response

TIME = np.arange(100) * 0.2
ALPHA = "\N{GREEK SMALL LETTER ALPHA}"
REFERENCE = np.full((100, 2), 0.4)
OUTPUT = REFERENCE * (1 - np.exp(-TIME))[:, None]


def named(panel, kind="lines"):
    return {part["name"]: part for part in panel[kind]}


def test_the_numbers_of_a_figure_are_those_that_were_drawn():
    found = chart(step_response(TIME, REFERENCE, {"a": OUTPUT}, {"a": -OUTPUT}, title="Step"))
    assert found["title"] == "Step" and found["columns"] == 1 and len(found["panels"]) == 4
    upper, lower = found["panels"][0], found["panels"][3]
    line = named(upper)["a"]
    assert line["x"] == {"first": 0.0, "step": 0.2, "count": 100}
    np.testing.assert_allclose(line["y"], OUTPUT[:, 0], rtol=6e-4)
    assert named(upper)["reference"]["dash"] == "6 3" and line["dash"] == "" and "step" not in line
    held = named(lower)["a"]
    assert held["step"] == 1 and held["x"]["count"] == 101 and held["y"][-1] == held["y"][-2]
    assert upper["ylabel"] == f"azimuth {ALPHA}_a [rad]" and lower["xlabel"] == "time [s]"
    spans = named(upper, "spans")
    assert spans["5 % band"]["y"] == pytest.approx([0.38, 0.42]) and spans["steady state: last 5 s"]["x"] == [15, 20]
    assert upper["x"] == [0.0, 20.0, "linear"]
    json.dumps(found)


def test_single_seeds_and_words_on_bands_come_with_the_curves():
    rows = np.array([[0.0, 1.0], [2.0, 5.0], [4.0, 9.0]])
    (panel,) = chart(average_rewards({"a": rows, "b": rows + 1}, [2, 4], window=1))["panels"]
    seeds = [line for line in panel["lines"] if line["name"] == "a (3 seeds)" and "seed" in line]
    assert [(line["seed"], line["y"]) for line in seeds] == [(k + 1, list(row)) for k, row in enumerate(rows)]
    assert panel["notes"] == ["line: interquartile mean over seeds", "band: its 95 % bootstrap interval"]
    band = named(panel, "bands")["a (3 seeds)"]
    assert band["alpha"] == 0.2 and band["color"] == "#0072b2" and {min(band["x"]), max(band["x"])} == {2, 4}


def test_levels_gaps_rings_and_logarithms_of_the_gate():
    decisions = {name: [0.1, np.nan, 0.2] for name in ("reward_error", "judged_reward_error")}
    decisions |= {"episode": [1, 2, 3], "open_below": [0.3] * 3, "close_above": [0.5] * 3, "open": [1, 0, 0]}
    decisions |= {"held_out_error_before": [0.1] * 3, "held_out_error_after": [0.2] * 3, "refit_kept": [1, 0, 1]}
    upper, lower = chart(gate(decisions))["panels"]
    assert upper["y"][2] == "log" and named(upper)["held-out windows, judged"]["y"] == [0.1, None, 0.2]
    ring = named(lower)["rolled back"]
    assert (ring["ring"], ring["dash"], ring["y"]) == (1, None, [0.2])
    assert [span["x"] for span in upper["spans"]] == [[1.5, 2.5], [2.5, 3.5]]
    assert {span["name"] for span in upper["spans"]} == {"model not trusted"}


def test_a_line_across_the_axis_is_a_level():
    figure = Figure()
    axis = figure.subplots()
    axis.axhline(0.05, linestyle="--", label="required")
    axis.axvline(3.0)
    axis.set_yscale("symlog", linthresh=10)
    (panel,) = chart(figure)["panels"]
    assert named(panel)["required"]["level"] == 0.05 and named(panel)[""]["at"] == 3.0
    assert panel["linear"] == 10 and "x" not in named(panel)["required"]


def test_a_drawing_has_no_numbers():
    assert chart(framework()) is None


def test_mathematics_is_letters():
    assert plain(r"main rotor speed $\omega_{p}$ [rpm]") == "main rotor speed ω_p [rpm]"
    assert plain(r"$\Omega_{a}$ and \$5") == "Ω_a and $5"
