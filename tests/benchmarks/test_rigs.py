"""What the benchmark of real logs reads of them."""

import numpy as np
import pytest
import torch
from benchmarks.rigs import Log, _ahead_rows, _axis_errors, _columns, course, replayed

from dynasindy.sindy import SindyModel
from dynasindy.systems.base import Signature


def test_a_thinned_log_keeps_samples_and_the_means_of_inputs():
    log = Log(np.arange(8.0)[:, None], np.arange(8.0)[:, None] ** 2, 0.1)
    data = log.thinned(3)
    assert data.dt == pytest.approx(0.3)
    assert data.x[:, 0].tolist() == [0, 3] and data.x_next[:, 0].tolist() == [3, 6]
    assert data.u[:, 0].tolist() == [pytest.approx((0 + 1 + 4) / 3), pytest.approx((9 + 16 + 25) / 3)]


def test_columns_go_by_the_name_before_the_unit(tmp_path):
    (tmp_path / "log.csv").write_text("time [s],q [m]\n0,1.5\n1,2.5\n")
    columns = _columns(tmp_path / "log.csv")
    assert columns["time"].tolist() == [0, 1] and columns["q"].tolist() == [1.5, 2.5]


def test_errors_ahead_are_told_together_and_of_each_angle():
    found = {row["metric"]: row["value"] for row in _ahead_rows("ours", torch.tensor([[0.03, 0.04], [0.3, 0.5]]))}
    assert found["theta 0.2 s ahead, RMSE"] == 30 and found["alpha 0.2 s ahead, RMSE"] == 40
    assert found["both angles 0.2 s ahead, RMSE"] == pytest.approx(25 * 2**0.5, rel=1e-3)
    assert found["both angles 0.5 s ahead, RMSE"] == pytest.approx(1e3 * (0.34 / 2) ** 0.5, rel=1e-3)


def test_a_log_that_is_replayed_counts_as_far_as_both_go():
    # Missed by 3 mm and 1 mm: the root of 5.
    assert replayed(np.array([0.0, 0.101, 9.0]), np.array([0.003, 0.1])) == pytest.approx(5**0.5)


def test_errors_over_a_log_end_where_a_model_runs_away():
    rows = course("ours", np.array([0.5, -1.0, np.nan, 3.0]), 0.1, "mm")
    assert [(row["seconds"], row["error"]) for row in rows] == [(0.0, 0.5), (0.1, -1.0)]
    rows = course("ours", np.arange(1000.0), 0.1, "mm")
    assert len(rows) == 250 and (rows[0]["error"], rows[-1]["seconds"]) == (0.0, 99.9)


def test_the_error_of_an_axis_is_simulated_less_measured():
    """An axis without any force that is pushed on by 1 mm: a model of it stays behind."""
    model = SindyModel(Signature(("q", "v"), ("m", "m/s"), ("u",), (0.25, 0.15)), ["v", "u"], known={"q": "v"})
    model.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, 0.0]], dtype=torch.float64))
    q = np.where(np.arange(60) < 30, 0.0, 1e-3)
    errors = _axis_errors(model, Log(np.stack([q, np.full(60, np.nan)], -1), np.zeros((60, 1)), 1e-3))
    assert errors.tolist() == pytest.approx([0.0] * 15 + [-1.0] * (len(errors) - 15), abs=1e-9)
