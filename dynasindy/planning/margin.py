"""Inputs that are weaker or stronger than in the model, imagined.

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

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.planning.regulator import Regulator, Weights
from dynasindy.planning.rests import Rests
from dynasindy.planning.strength import Strength
from dynasindy.tasks import Tracking


class Margin:
    """Draws how strong inputs are.

    Args:
        regulator: Knows the inputs at rest.
        task: Gives the references of an episode.
        share: By how much inputs are weaker or stronger at most.
    """

    def __init__(self, regulator: Regulator, task: Tracking, share: float) -> None:
        self.regulator, self.task, self.share = regulator, task, share
        low, high = task.input_limits
        ends = torch.stack([low.where(low > -1, -torch.inf), high.where(high < 1, torch.inf)])
        self.limits = ends if bool(ends.isfinite().any()) else None

    @classmethod
    def of(cls, env: ControlEnv, rests: Rests | None, share: float) -> Margin | None:
        """Return the margin of a model; None where none is asked for, or nothing rests or is regulated."""
        if not share or rests is None or (regulator := Regulator.of(env, rests, Weights())) is None:
            return None
        assert isinstance(env.task, Tracking)
        return cls(regulator, env.task, share)

    def draw(self, params: Tensor, rng: torch.Generator) -> Strength:
        """Return strengths between the ends, each input's its own, for episodes with task parameters `(rows, ...)`."""
        rest = self._rest(params, torch.zeros(len(params), 1))
        factor = 1 + self.share * (2 * torch.rand(rest.shape, generator=rng) - 1)
        return Strength(factor, rest, self.limits, self._along(params))

    def ends(self, params: Tensor) -> Strength:
        """Return strengths to test a policy with: the weakest, that of the model, and the strongest, in turn."""
        rest = self._rest(params, torch.zeros(len(params), 1))
        turn = torch.arange(len(rest)).remainder(3).sub(1).unsqueeze(-1)
        return Strength((1 + self.share * turn).expand_as(rest), rest, self.limits, self._along(params))

    def _rest(self, params: Tensor, t: Tensor) -> Tensor:
        return self.regulator.rest(self.task.reference(params, t).float())[1]

    def _along(self, params: Tensor) -> Callable[[Tensor, Tensor], Tensor] | None:
        """Return what holds references that move at a time; None where all of them stay."""
        return self._rest if bool(params[..., 1].any()) else None  # amplitudes
