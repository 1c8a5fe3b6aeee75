"""The spread of a model: fits to resampled blocks of its data, and fits to stretches of them."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.progress import reporting_as
from dynasindy.sindy.delay import delayed
from dynasindy.sindy.difference_equation import stepwise
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.regression import Regression, RunningSums, simpson_form
from dynasindy.systems.transitions import Transitions


@dataclass(frozen=True)
class Ensemble:
    """Hold the coefficients of fits to resampled data.

    Attributes:
        members: `(n_members, n_features, n_x)`.
    """

    members: Tensor

    @property
    def median(self) -> Tensor:
        """Return the median coefficients, `(n_features, n_x)`."""
        return self.members.median(0).values

    @property
    def spread(self) -> Tensor:
        """Return the standard deviation of each coefficient over the members, `(n_features, n_x)`."""
        return self.members.std(0)

    @property
    def inclusion(self) -> Tensor:
        """Return in which part of the members each coefficient is not zero, `(n_features, n_x)`."""
        return (self.members != 0).to(torch.float64).mean(0)

    def consensus(self, share: float = 0.6) -> Tensor:
        """Return the median coefficients of the functions that at least a share of the members uses."""
        return torch.where(self.inclusion >= share, self.median, 0.0)


def bag(model: SindyModel, data: Transitions, n_members: int = 50, blocks: int = 25, seed: int = 0) -> Ensemble:
    """Fit a model's library to blocks of the data drawn with replacement.

    Neighbouring samples are alike, so blocks are drawn and not samples. The generator is its own: the same seed
    gives the same ensemble whatever was drawn elsewhere.

    Args:
        model: a fitted model, whose library, regression and constraints are used and which is not changed.
        data: transitions, at least `blocks` of them.
        n_members: number of fits.
        blocks: number of blocks of equal length.
        seed: seed of the drawing.

    Raises:
        ValueError: there is no member, there are fewer transitions than blocks, or they are not those of the model's
            steps.
    """
    if n_members < 1 or blocks < 2 or len(data) < blocks:
        raise ValueError(
            f"bag got {n_members} members and {blocks} blocks of {len(data)} transitions; allowed are 1 member, 2 "
            "blocks and as many transitions as blocks, or more: correct them"
        )
    if model.step is not None:
        _, data = stepwise(model.library, data)
    theta, dx = simpson_form(model.library, model, data)
    regression = (
        model.regression if model.refinement is None else Regression("bic", tolerance=model.refinement.tolerance)
    )
    factors = []
    for part in torch.tensor_split(torch.arange(len(data)), blocks):
        sums = RunningSums(len(model.library), model.signature.n_x)
        sums.add((theta[part], dx[part]))
        factors.append(sums)
    generator = torch.Generator().manual_seed(seed)
    members = []
    for _ in range(n_members):
        drawn = torch.randint(blocks, (blocks,), generator=generator).tolist()
        total = RunningSums(len(model.library), model.signature.n_x)
        total.r = torch.linalg.qr(torch.cat([factors[k].r for k in drawn]), mode="r")[1]
        total.count = sum(factors[k].count for k in drawn)
        members.append(regression.solve(total, model.constraints.free, model.constraints.offset))
    return Ensemble(torch.stack(members))


def refits(model: SindyModel, data: Transitions, stretches: int, name: str) -> list[SindyModel]:
    """Fit the functions that a model uses to stretches of data, each on its own.

    In contrast to `bag` it needs no measured rates: each fit is refined as the model was, from its coefficients on.

    Args:
        model: a fitted model, which is not changed.
        data: transitions, NaN where a state was not measured.
        stretches: number of stretches of equal length; each gives a model.
        name: what the data are, for those who wait.

    Raises:
        ValueError: a stretch has fewer transitions than the library has functions.
        Diverged: a coefficient is not finite.
    """
    late, places = delayed(data, model.delay), torch.arange(len(data))
    length, found = len(data) // stretches, []
    for k in range(stretches):
        member = copy.deepcopy(model)
        used = model.constraints.free & (model.coefficients != 0)
        given = torch.where(model.constraints.free, 0.0, model.constraints.offset)
        member.constraints = replace(model.constraints, free=used, offset=given)
        member.initial, member.initial_delay = model.coefficients.clone(), 0.0
        if member.refinement is not None:
            member.refinement = replace(member.refinement, longest_delay=0.0)
        with reporting_as(f"fit to {name}" if stretches == 1 else f"fit to part {k + 1} of {stretches} of {name}"):
            member.fit(late.select((places >= k * length) & (places < (k + 1) * length)))
        member.delay = model.delay
        found.append(member)
    return found
