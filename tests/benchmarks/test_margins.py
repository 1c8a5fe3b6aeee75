"""Rows of margins are the least of what a check found, counted by hand."""

import math

import pytest
from benchmarks.margins import COLUMNS, row_of


def found():
    margins = {
        "pump": {"gain": 3.456, "phase": 41.26, "delay": 0.12345, "disk": 0.71, "lower": 0.1},
        "valve": {"gain": 7.0, "phase": 60.0, "delay": 0.02, "disk": 0.9, "lower": 0.3},
    }
    metrics = {
        "verdict": {"held": "CONTROLLED: errors at the end"},
        "evaluation": {"return": 57.504},
        "held": {"share": {"h1": 0.0002, "h2": 0.00034567}, "worst": {"h1": 0.01, "h2": 0.002}},
        "check": {"margins": margins, "weak": ["slew", "noise"]},
    }
    radii = {"draw 1": 0.99, "draw 2": 1.0, "draw 3": None, "a in b' +20 %": 1.5}
    changes = [{"change": name, "spectral_radius": radius} for name, radius in radii.items()]
    return metrics, {"targets": [{"stable": True}, {"stable": False}, {"stable": True}], "changes": changes}


def test_a_row_holds_the_least_margins_and_counts_what_is_not_stable():
    row = row_of(*found())
    assert row == {
        **{"verdict": "CONTROLLED", "return": 57.5, "error_percent": 0.0346, "worst_percent": 1.0},
        **{"gain": 3.46, "phase_deg": 41.3, "delay_s": 0.02, "disk": 0.71},
        **{"targets": 3, "unstable_targets": 1, "draws": 3, "unstable_draws": 2, "weak": 2},
    }
    assert {"plant", "planning", "seed", *row, "cpu_seconds", "commit"} == set(COLUMNS)


def test_what_runs_away_has_an_error_without_end_and_no_margins():
    metrics, checked = found()
    metrics["held"]["share"]["h1"], metrics["check"]["margins"] = None, {}
    row = row_of(metrics, checked)
    assert row["error_percent"] == math.inf and all(math.isnan(row[name]) for name in ("gain", "delay_s"))
    assert row["worst_percent"] == pytest.approx(1.0)
