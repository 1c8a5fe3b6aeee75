"""The linear model against a linear recurrence that is known."""

import numpy as np
import pytest
import torch

from dynasindy.evaluation.forecast_errors import LinearModel
from dynasindy.systems.transitions import Transitions


def recording(n: int = 300) -> Transitions:
    """y[k+1] = 1.2 y[k] - 0.5 y[k-1] + 0.7 u[k] - 0.2 u[k-1] + 0.1, and a state that nobody measured."""
    u = np.random.default_rng(0).normal(size=n)
    y = [0.0, 0.3]
    for k in range(1, n):
        y.append(1.2 * y[k] - 0.5 * y[k - 1] + 0.7 * u[k] - 0.2 * u[k - 1] + 0.1)
    x = torch.full((n + 1, 2), torch.nan, dtype=torch.float64)
    x[:, 0] = torch.tensor(y)
    return Transitions.from_trajectory(x, torch.from_numpy(u)[:, None], 0.1)


def test_it_is_the_recurrence_of_the_plant():
    model = LinearModel._of_order(recording(), 2)
    assert model is not None and model.seen.tolist() == [True, False]
    assert model.weights.flatten().tolist() == pytest.approx([1.2, -0.5, 0.7, -0.2, 0.1], abs=1e-9)


def test_it_predicts_as_far_as_it_is_asked():
    data = recording()
    model, starts = LinearModel.fit(data, 10, 4), torch.tensor([20, 50])
    later = starts.unsqueeze(-1) + torch.arange(10)
    predicted = model.predict(data, starts, later)
    assert torch.allclose(predicted[..., 0], data.x_next[later][..., 0], atol=1e-6)
    assert bool(predicted[..., 1].isnan().all())


@pytest.mark.parametrize("most", [1, 2, 3, 16])
def test_no_order_is_beyond_the_largest(most):
    found = LinearModel.fit(recording(), 10, most)
    assert found.order <= most and (most == 1 or found.order > 1)  # one past sample does not do


def test_orders_are_compared_over_all_stretches_that_are_long_enough():
    """Two stretches of 12 and 20 rows; a model that predicts zero misses all of what is there."""
    both = recording(40)
    data = both.select(torch.tensor([True] * 12 + [False] * 8 + [True] * 20))
    misses = []
    for start in range(len(data)):
        rows = range(start, start + 5)
        if start and rows[-1] < len(data) and data.segment[start - 1] == data.segment[rows[-1]]:
            misses += [float(data.x_next[k, 0]) ** 2 for k in rows]
    zero = LinearModel(2, torch.tensor([True, False]), torch.zeros(5, 1, dtype=torch.float64))
    expected = sum(misses) / len(misses) / float(data.x_next[:, 0].var())
    assert len(misses) == 5 * (7 + 15) and zero._error(data, 5) == pytest.approx(expected)


def lossy(share: float = 0.1) -> Transitions:
    """The recurrence, of which some samples of y were lost."""
    data, lost = recording(), torch.from_numpy(np.random.default_rng(1).random(301) < share)
    x = torch.cat([data.x, data.x_next[-1:]])
    x[lost, 0] = torch.nan
    return Transitions.from_trajectory(x, data.u, data.dt)


def test_lost_samples_cost_their_rows_and_nothing_else():
    data = lossy()
    model = LinearModel.fit(data, 10, 2)
    assert model.order == 2 and model.seen.tolist() == [True, False]
    assert model.weights.flatten().tolist() == pytest.approx([1.2, -0.5, 0.7, -0.2, 0.1], abs=1e-9)
    starts = torch.arange(5, 200)
    predicted = model.predict(data, starts, starts.unsqueeze(-1) + torch.arange(10))[..., 0]
    lost = (data.x[starts, 0].isnan() | data.x[starts - 1, 0].isnan()).numpy()
    real = recording().x_next[starts.unsqueeze(-1) + torch.arange(10), 0]
    assert lost.any() and bool(predicted[torch.from_numpy(lost)].isnan().all())
    assert torch.allclose(predicted[torch.from_numpy(~lost)], real[torch.from_numpy(~lost)], atol=1e-6)


def test_without_a_complete_row_there_is_no_linear_model():
    data = recording()
    every = torch.cat([data.x, data.x_next[-1:]])
    every[1::2] = torch.nan  # of no interval both ends were measured
    model = LinearModel.fit(Transitions.from_trajectory(every, data.u, data.dt), 10, 4)
    starts = torch.tensor([20])
    assert not len(model.weights) and not bool(model.seen.any())
    assert bool(model.predict(data, starts, starts.unsqueeze(-1) + torch.arange(3)).isnan().all())
