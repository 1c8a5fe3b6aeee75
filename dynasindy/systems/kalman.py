"""The update of a Kalman filter by a measurement, batched."""

from __future__ import annotations

import torch
from torch import Tensor


def kalman_update(mean: Tensor, covariance: Tensor, y: Tensor, variance: Tensor) -> tuple[Tensor, ...]:
    """Return an estimate and its covariance after a measurement, v' S^-1 v, and its log-likelihood but for a constant.

    Source: Simon, Optimal State Estimation (2006), section 5.1, the covariance in Joseph's form.

    Args:
        mean: estimate x, `(*batch, n)` float64.
        covariance: of its errors, P, `(*batch, n, n)`.
        y: measurement of the states, `(*batch, n)`, NaN where there is none.
        variance: of the errors of the sensors, the diagonal of R, `(n,)`.

    Raises:
        LinAlgError: the covariance is singular.
    """
    seen = ~y.isnan()
    pick, r = torch.diag_embed(seen.double()), torch.where(seen, variance, 1.0)
    innovation = torch.where(seen, y - mean, 0.0).unsqueeze(-1)
    gained = covariance @ pick
    spread = pick @ gained + torch.diag_embed(r)
    gain = torch.linalg.solve(spread, gained.mT).mT
    left = torch.eye(mean.shape[-1], dtype=torch.float64) - gain @ pick
    after = left @ covariance @ left.mT + (gain * torch.where(seen, r, 0.0).unsqueeze(-2)) @ gain.mT
    squared = (innovation.mT @ torch.linalg.solve(spread, innovation)).squeeze(-1).squeeze(-1)
    likelihood = -0.5 * (squared + torch.linalg.slogdet(spread).logabsdet)
    return mean + (gain @ innovation).squeeze(-1), after, squared, likelihood
