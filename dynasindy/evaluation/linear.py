"""A linear model on past inputs and outputs (ARX), by least squares: what any other model has to beat.

y[k+1] = A_0 y[k] + .. + A_p-1 y[k-p+1] + B_0 u[k] + .. + B_p-1 u[k-p+1] + c
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.sindy.prediction import variance
from dynasindy.sindy.regression import least_squares
from dynasindy.systems.transitions import Transitions

ORDERS = (1, 2, 4, 8, 16)
"""Numbers of past samples to choose from."""
TRIED = 100
"""Start times from which each order is tried."""


@dataclass(frozen=True)
class LinearModel:
    """A linear model on past samples.

    Attributes:
        order: past samples that it reads.
        seen: states that it reads and predicts, bool `(n_x,)`: those that were measured twice in a row.
        weights: of past outputs and inputs, newest first, and of one, `(order * (n_y + n_u) + 1, n_y)`.
    """

    order: int
    seen: Tensor
    weights: Tensor

    @classmethod
    def fit(cls, data: Transitions, steps: int, most: int) -> LinearModel:
        """Fit the order that predicts the data themselves best, over as many steps.

        Rows that read a lost sample are left out. Where too few are complete for any order, the model has no weights.

        Args:
            data: the recording, NaN where a state was not measured.
            steps: sampling times over which orders are compared.
            most: largest order.
        """
        models = [cls._of_order(data, order) for order in ORDERS if order <= most]
        errors = [model._error(data, steps) if model else math.inf for model in models]
        best = models[min(range(len(models)), key=errors.__getitem__)]
        return best or cls(1, _seen(data), torch.zeros(0))

    @classmethod
    def _of_order(cls, data: Transitions, order: int) -> LinearModel | None:
        seen, rows = _seen(data), _rows(data, order)
        columns, target = _regressors(data, rows, order, seen), data.x_next[rows][:, seen].double()
        complete = ~(columns.isnan().any(-1) | target.isnan().any(-1))
        columns, target = columns[complete], target[complete]
        if not bool(seen.any()) or len(columns) < 2 * columns.shape[1]:
            return None
        scale = columns.norm(dim=0).clamp_min(1e-300)
        return cls(order, seen, least_squares(columns / scale, target) / scale.unsqueeze(-1))

    def predict(self, data: Transitions, starts: Tensor, later: Tensor) -> Tensor:
        """Predict from some rows on, `(S, T, n_x)`; infinite where it runs away.

        States that were not measured are NaN, and all of them where one of the past samples was lost.

        Args:
            data: the recording.
            starts: rows at which predictions begin, with `order` rows of their segment before them, `(S,)`.
            later: rows whose inputs act in turn, `(S, T)`.
        """
        predicted = torch.full((*later.shape, len(self.seen)), math.nan, dtype=torch.float64)
        if not len(self.weights):
            return predicted
        past = (starts.unsqueeze(-1) - torch.arange(self.order)).clamp_min(0)
        outputs = data.x[past][..., self.seen].double()
        inputs = torch.cat([data.u[past[:, 1:]].flip(1), data.u[later]], 1).double()
        one = torch.ones(len(starts), 1, dtype=torch.float64)
        lost = outputs.isnan().flatten(1).any(-1)
        for k in range(later.shape[1]):
            recent = inputs[:, k : k + self.order].flip(1)
            after = torch.cat([outputs.flatten(1), recent.flatten(1), one], -1) @ self.weights
            predicted[:, k, self.seen] = after
            outputs = torch.cat([after.unsqueeze(1), outputs[:, :-1]], 1)
        predicted[:, :, self.seen] = predicted[:, :, self.seen].nan_to_num(math.inf, math.inf, -math.inf)
        predicted[lost] = math.nan
        return predicted

    def _error(self, data: Transitions, steps: int) -> float:
        """Return the mean squared error over some steps, each state relative to its spread."""
        rows = _rows(data, self.order)
        last = torch.ones(len(rows), dtype=torch.bool)
        ahead = rows + steps - 1
        last &= (ahead < len(data)) & (data.segment[ahead.clamp_max(len(data) - 1)] == data.segment[rows])
        rows = rows[last] if bool(last.any()) else rows[:1]
        starts = rows[torch.linspace(0, len(rows) - 1, min(TRIED, len(rows))).long()]
        later = (starts.unsqueeze(-1) + torch.arange(steps)).clamp_max(len(data) - 1)
        real = data.x_next[later]
        error = (self.predict(data, starts, later) - real)[..., self.seen].square().nanmean((0, 1))
        spread = variance(data.x_next[:, self.seen].double()).clamp_min(1e-300)
        return float((error / spread).sum().nan_to_num(math.inf, math.inf))


def _seen(data: Transitions) -> Tensor:
    """Return which states were measured at both ends of an interval, bool `(n_x,)`: others have no such equation."""
    return ~(data.x.isnan() | data.x_next.isnan()).all(0)


def _rows(data: Transitions, order: int) -> Tensor:
    """Return the rows that have `order - 1` rows of their segment before them."""
    rows = torch.arange(order - 1, len(data))
    return rows[data.segment[rows] == data.segment[rows - order + 1]]


def _regressors(data: Transitions, rows: Tensor, order: int, seen: Tensor) -> Tensor:
    past = rows.unsqueeze(-1) - torch.arange(order)
    parts = [data.x[past][..., seen].flatten(1), data.u[past].flatten(1), torch.ones(len(rows), 1)]
    return torch.cat([part.double() for part in parts], -1)
