"""What the benchmark of real logs reads of them."""

import numpy as np
import pytest
import torch

from dynasindy.benchmarks.rigs import Log, _ahead_rows, _columns, replayed


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
