"""Domain randomization: imagined plants whose inputs' delay and strength are not the model's.

A policy that is planned on one model alone may use all that inputs can do, and hold the model by a hair's breadth: the
plant, whose inputs are a few hundredths weaker, is lost then. A gain margin is what is asked of any controller:

| name   | symbol | equation                                                         |
| ------ | ------ | ---------------------------------------------------------------- |
| factor | k      | input that acts = u_e + k (u - u_e), k between 1 - share and 1 + share |
| rest   | u_e    | input that holds the reference in the model                      |

What holds a plant at rest stays as it is, so that no policy has to be wrong there for some of the factors. Where a
reference moves, u_e is what would hold it at that moment. Where an actuator reaches less than [-1, 1] to a side, as a
pump that cannot draw, no strength takes an input beyond that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.planning.regulator import Regulator
from dynasindy.systems.equilibria import Equilibria


@dataclass(frozen=True)
class InputStrength:
    """How strong the inputs of imagined episodes are.

    Attributes:
        share: By how much inputs are weaker or stronger at most.
        rest: Inputs at rest, `(T or 1, rows, n_u)`, of task parameters `(rows, n_r, 5)` at times `(T, rows, 1)` [s]; of
            the first time alone where no reference moves.
        limits: Least and largest input that acts, `(2, n_u)`, infinite where there is none.
        factor: Of the inputs' distance from rest, `(rows, n_u)`.
    """

    share: float
    rest: Callable[[Tensor, Tensor], Tensor]
    limits: Tensor
    factor: Tensor

    @classmethod
    def of(cls, env: ControlEnv, rests: Equilibria, share: float) -> InputStrength | None:
        """Return the strengths of a model, 1 all of them; None where none is asked for or nothing is regulated."""
        if not share or (regulator := Regulator.of(env, rests)) is None:
            return None
        task = env.task
        assert isinstance(task, Tracking)
        low, high = task.input_limits

        def _rest(params: Tensor, t: Tensor) -> Tensor:
            moving = bool(params[..., 1].any())  # amplitudes
            return regulator.rest(task.reference(params, t if moving else t[:1]).float())[1]

        limits = torch.stack([low.where(low > -1, -torch.inf), high.where(high < 1, torch.inf)])
        return cls(share, _rest, limits, torch.ones(1, limits.shape[1]))

    def draw(self, rows: int, rng: torch.Generator) -> InputStrength:
        """Return strengths between the ends, each input's its own, for so many episodes."""
        drawn = torch.rand(rows, self.factor.shape[1], generator=rng)
        return replace(self, factor=1 + self.share * (2 * drawn - 1))

    def ends(self, rows: int) -> InputStrength:
        """Return strengths to test a policy with: the weakest, that of the model, and the strongest, in turn."""
        turn = torch.arange(rows).remainder(3).sub(1).unsqueeze(-1)
        return replace(self, factor=(1 + self.share * turn).expand(-1, self.factor.shape[1]))

    def acting(self, u: Tensor, rest: Tensor) -> Tensor:
        """Return the inputs that act when `u` is commanded, about those at rest, `(rows, n_u)`."""
        return torch.lerp(rest, u, self.factor).clamp(self.limits[0], self.limits[1])

    def slope(self, acting: Tensor) -> Tensor:
        """Return the derivative of the inputs that acted by those commanded, each by its own, `(*batch, rows, n_u)`.

        Args:
            acting: What `acting` returned, `(*batch, rows, n_u)`.
        """
        return self.factor * ((acting > self.limits[0]) & (acting < self.limits[1]))
