"""Plants that differ from the model within its uncertainty: with other coefficients, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.checking.closed_loop import ClosedLoop
from dynasindy.checking.linear_loop import RestingLoop, find_rest
from dynasindy.progress import reporting_as
from dynasindy.sindy import SindyModel

DRAWN = 0.05
"""Largest share by which coefficients are drawn at random where the model does not tell how well it knows them."""

WITHIN = f"each within {100 * DRAWN:g} % of itself, as the model tells no standard errors"
"""How they were drawn by that share."""


def variants(model: SindyModel, draws: int, seed: int) -> tuple[Tensor, str]:
    """Draw coefficients that were found in data, all at a time.

    They are drawn from the covariance of the fit, as far as the model tells it; else uniformly, within a share `DRAWN`
    of each.

    Args:
        model: The model.
        draws: Number of draws.
        seed: Their seed.

    Returns:
        Xi of each plant, `(draws, n_features, n_x)`, and by how much they are drawn, in words.
    """
    generator, xi = torch.Generator().manual_seed(seed), model.coefficients
    if model.covariance is None:
        uniform = 2 * torch.rand((draws, *xi.shape), generator=generator, dtype=xi.dtype) - 1
        return xi * (1 + DRAWN * uniform * model.constraints.free), WITHIN
    shares = 100 * model.covariance.shares(xi)
    how = f"from the covariance of the fit, with standard errors of {shares.min():.2g} to {shares.max():.2g} %"
    return model.covariance.draw(xi, draws, generator), how


@dataclass(frozen=True)
class Spread:
    """What becomes of the loop with other plants.

    Attributes:
        radius: Spectral radius, `(n_targets, n)`, infinite where no point of rest was found.
        error: Steady error of the outputs, `(n_targets, n, n_r)`, infinite where they run away.
        how: By how much they are drawn, in words.
    """

    radius: Tensor
    error: Tensor
    how: str = WITHIN

    @property
    def worst(self) -> Tensor:
        """Largest spectral radius of each plant over the targets, `(n,)`; infinite if none has a rest."""
        return self.radius.amax(0) if len(self.radius) else self.radius.new_full(self.radius.shape[1:], torch.inf)

    @property
    def farthest(self) -> Tensor:
        """Largest steady error of each plant over the targets, `(n, n_r)`."""
        return self.error.amax(0) if len(self.error) else self.error.new_zeros(self.error.shape[1:])


def spread(
    loop: ClosedLoop, r: Tensor, nominal: RestingLoop, changed: Tensor, how: str = WITHIN, seconds: float = 20.0
) -> Spread:
    """Let loops with other plants, and the same controller, rest at each target.

    Args:
        loop: The loop of the model.
        r: Targets, `(n_targets, n_r)`.
        nominal: Where that loop rests at them.
        changed: Xi of the other plants, `(n, n_features, n_x)`.
        how: By how much they are drawn, in words.
        seconds: How long a loop may run to come to rest [s].
    """
    count = len(changed)
    radii, errors = (
        torch.zeros(len(r), count, dtype=torch.float64),
        torch.zeros(len(r), count, r.shape[-1], dtype=torch.float64),
    )
    for k, target in enumerate(r.double() if count else []):
        start = nominal.select(torch.full((count,), k))
        with reporting_as(f"plants that differ from the model, target {k + 1} of {len(r)}"):
            found = find_rest(loop.varied(changed), target.expand(count, -1), start, seconds)
        radii[k] = torch.from_numpy(found.linear.radius).where(found.still, torch.inf)
        errors[k] = found.error
    return Spread(radii, errors, how)
