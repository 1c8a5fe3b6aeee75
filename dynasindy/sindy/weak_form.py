"""Rows of a regression out of measurements: rates of change averaged by a smooth bump, the functions by the same one.

Whatever is done to the rates has to be done to the functions, or the fit explains the difference: a smoothed speed no
longer jumps with its input. Both sides of the equations are averaged over some samples by one bump, which is the weak
form of the differential equation (Messenger and Bortz 2021) for inputs under zero-order hold. States that are the
rate of a measured one enter by second differences of that, not by a derivative that was smoothed before.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from dynasindy.sindy.regression import Rows, Theta
from dynasindy.systems.transitions import Transitions

OVERLAP = 4
"""Bumps that cover a sample."""


def weak_form(theta: Theta, measured: Transitions, guess: Transitions, rates: Mapping[int, int], half: int) -> Rows:
    """Average the functions and the rates of change by bumps of `2 half - 1` samples.

    Args:
        theta: `(x, u) -> (N, n_features)`.
        measured: the recording, NaN where a state was not measured.
        guess: the same, the states that were not measured guessed.
        rates: which state is the rate of which other one, `{rate: state}`.
        half: half of the length of a bump [samples].

    Returns:
        Averaged functions, `(M, n_features)`, and averaged rates of change, `(M, n_x)`, M about N over `half / 4`.

    Raises:
        ValueError: no segment has two transitions.
    """
    functions, changes = [], []
    for segment in guess.segment.unique_consecutive().tolist():
        mine = guess.segment == segment
        rows = mine.nonzero().flatten()
        if len(rows) < 2:
            continue
        within = min(half, max(1, (len(rows) - 1) // 2))
        mean = theta(0.5 * (guess.x[rows] + guess.x_next[rows]), guess.u[rows])
        rate = _rates(measured, guess, rows, rates)
        bump = (1 - torch.linspace(-1, 1, 2 * within + 1, dtype=torch.float64)[1:-1].square()) ** 4
        both = torch.cat([0.5 * (mean[:-1] + mean[1:]), rate], -1)
        averaged = torch.nn.functional.conv1d(
            both.mT.unsqueeze(1), (bump / bump.sum()).reshape(1, 1, -1), stride=max(1, within // OVERLAP)
        )[:, 0].mT
        functions.append(averaged[:, : mean.shape[1]])
        changes.append(averaged[:, mean.shape[1] :])
    if not functions:
        raise ValueError(
            "a recording with states that were not measured has no two samples that follow each other; allowed are "
            "segments of two transitions or more: give unbroken stretches"
        )
    return torch.cat(functions), torch.cat(changes)


def _rates(measured: Transitions, guess: Transitions, rows: Tensor, rates: Mapping[int, int]) -> Tensor:
    """Return rates of change over two neighbouring intervals, `(n - 1, n_x)`."""
    x = torch.cat([guess.x[rows[:1]], guess.x_next[rows]])
    raw = torch.cat([measured.x[rows[:1]], measured.x_next[rows]])
    x = torch.where(raw.isnan(), x, raw)
    rate = (x[2:] - x[:-2]) / (2 * guess.dt)
    for i, of in rates.items():
        if bool(raw[:, i].isnan().all()):
            rate[:, i] = (x[2:, of] - 2 * x[1:-1, of] + x[:-2, of]) / guess.dt**2
    return rate
