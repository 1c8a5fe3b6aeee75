"""PySINDy on rows that are given to it: the rows are right, and so are the choice and the scale."""

import numpy as np
import pytest
import torch
from benchmarks import identify, rivals
from benchmarks.rivals import best_threshold, given_rows, own_rows, score, stlsq

from dynasindy.sindy.named_libraries import paper_table
from dynasindy.systems import Xi


def test_scores_count_true_and_false_terms():
    truth = torch.tensor([[1.0, 0.0], [2.0, 0.0], [0.0, 4.0]])
    found = torch.tensor([[1.1, 0.5], [0.0, 0.0], [0.0, 4.0]])
    assert score(found, truth) == (2, 1, pytest.approx(1.0))


def test_given_rows_hold_the_law_of_the_plant_a_hundred_times_closer_than_the_trapezoidal_rule():
    from dynasindy.sindy.regression import integral_form

    library, truth, data = paper_table(Xi().signature), identify.true_table(), identify.xi_recording(4.0, 0.05, 0)
    misses = [
        (theta @ truth - dx).norm(dim=0) for theta, dx in (integral_form(library, data), given_rows(library, data))
    ]
    assert (misses[1] < 0.01 * misses[0]).all()


def test_own_rows_pair_each_sample_with_its_derivative():
    class Forward:
        def _differentiate(self, x, t):
            return np.vstack([np.diff(x, axis=0), np.zeros((1, x.shape[1]))]) / t

    data = identify.xi_recording(0.5, 0.01, 0)
    theta, dx = own_rows(paper_table(Xi().signature), data, Forward())
    assert len(theta) == len(dx) == len(data.x)
    assert torch.allclose(dx, (data.x_next - data.x) / 0.01)
    assert torch.equal(theta, paper_table(Xi().signature)(data.x, data.u))


def test_the_best_threshold_is_the_one_with_most_true_and_fewest_false_terms_in_the_units_of_the_data(monkeypatch):
    monkeypatch.setattr(rivals, "SCALED_THRESHOLDS", (1e-6, 0.1, 0.99))  # keeps all; only the true ones; none
    generator = torch.Generator().manual_seed(0)
    theta = torch.rand(200, 4, generator=generator, dtype=torch.float64) - 0.5
    truth = torch.tensor([[1.0, 0.0], [0.5, 3000.0], [0.0, 0.0], [0.0, 4000.0]], dtype=torch.float64)
    noise = torch.tensor([1e-2, 30.0]) * torch.randn(200, 2, generator=generator, dtype=torch.float64)
    worth, words, scores = best_threshold("rows", [(theta, theta @ truth + noise)], truth, scaled=True)
    assert scores[0][:2] == (4, 0) and scores[0][2] < 0.05 and worth == 4
    assert words.startswith("threshold=0.1,") and words.endswith("rows")


def test_the_optimiser_gets_functions_and_rates_and_gives_columns_per_state():
    import pysindy

    theta = torch.eye(4, dtype=torch.float64)[:, :3]
    found = stlsq((theta, theta @ torch.tensor([[1.0, 0], [0, 2.0], [0, 0]]).double()), pysindy.STLSQ(0.5, alpha=0))
    assert torch.allclose(found, torch.tensor([[1.0, 0], [0, 2.0], [0, 0]]).double())
