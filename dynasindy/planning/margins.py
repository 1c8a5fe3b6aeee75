"""Margins that a policy lacks at rest in the model: a cost beside that of imagined episodes.

Where a plant answers weakly, as a rotor that stands still, a loop without margin moves so little and so slowly that no
imagined episode shows it. Its linear model does, about the equilibria of the model:

| name   | symbol | equation                                                                         |
| ------ | ------ | -------------------------------------------------------------------------------- |
| slopes | A, B   | of the state one control period later, by state and input                         |
| gain   | K      | of the policy, du/dx                                                              |
| factor | d      | of one input: `GAIN`, 1 / `GAIN` or e^(i `PHASE`), 1 of the others                |
| lack   |        | sum of max(0, abs(s) - 1), s the largest eigenvalue of each A + B diag(d) K       |
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dynasindy.envs import ControlEnv
from dynasindy.planning.rollout import Network, policy_gain, sensitivities
from dynasindy.systems.equilibria import Equilibria
from dynasindy.tasks.references import Step

GAIN, PHASE = 2.2, math.radians(35)
"""Margins that are asked for, a little more than those of a check."""
FOLLOWED = 4
"""Equilibria, those where a policy lacks most, whose gradient is followed."""
SHARE = 0.5
"""Largest gradient of the lack, in norms of that of the episodes, which it would drown where a loop turns unstable."""


@dataclass
class MarginCost:
    """Cost of the margins that a policy lacks about the equilibria of a model.

    Attributes:
        env: Imagined environment.
        x: States, `(n, n_x)`.
        params: Task parameters whose references are these outputs, `(n, n_r, 5)`.
        a, b: A and B of the states that take part, `(n, n_m, n_m)` and `(n, n_m, n_u)`.
        moved: Which states do, bool `(n_x,)`.
        followed: Places of the equilibria whose gradient is followed.
    """

    env: ControlEnv
    x: Tensor
    params: Tensor
    a: Tensor
    b: Tensor
    moved: Tensor
    followed: Tensor

    @classmethod
    def of(cls, env: ControlEnv, equilibria: Equilibria) -> MarginCost:
        """Return the cost in an imagined environment, about the equilibria of its model."""
        x, moved = equilibria.x.float(), equilibria.moved
        params = Step(equilibria.targets.tolist()).sample(torch.Size((len(x),)), torch.Generator())
        a, b = sensitivities(env, x, equilibria.u.float())
        a, b = (each.double().nan_to_num(0.0, 0.0, 0.0) for each in (a[:, moved][..., moved], b[:, moved]))
        return cls(env, x, params, a, b, moved, torch.arange(0))

    def select(self, network: Network) -> None:
        """Choose the equilibria at which a policy lacks most; none where it lacks nothing."""
        every = torch.arange(len(self.x))
        lack = self._lack(self._gain(network, every).detach()[..., self.moved].double(), every)
        worst = lack.topk(min(FOLLOWED, len(lack))).indices
        self.followed = worst[lack[worst] > 0]

    def add_gradient(self, network: nn.Module) -> None:
        """Add the gradient of what a policy lacks at the equilibria that were chosen to that of its parameters."""
        if not len(self.followed):
            return
        gain = self._gain(network, self.followed)
        k = gain.detach()[..., self.moved].double().requires_grad_()
        lack, slope = self._lack(k, self.followed).sum(), torch.zeros_like(gain)
        if not bool(lack > 0):
            return
        # Where eigenvalues meet they have no slope.
        found = torch.autograd.grad(lack, k)[0].nan_to_num(0.0, 0.0, 0.0)
        slope[..., self.moved] = found.float()
        learnt = [(each, each.grad) for each in network.parameters() if each.grad is not None]
        if not learnt:
            return
        parameters, sofar = zip(*learnt, strict=True)
        added = torch.autograd.grad(gain, parameters, slope, allow_unused=True, materialize_grads=True)
        largest = SHARE * nn.utils.get_total_norm(sofar) / nn.utils.get_total_norm(added)
        for grad, more in zip(sofar, added, strict=True):
            grad += more * largest.clamp(max=1.0).nan_to_num(0.0)

    def _gain(self, network: Network, places: Tensor) -> Tensor:
        """Return K at some equilibria, `(n, n_u, n_x)`, with its graph."""
        x, params = self.x[places], self.params[places]
        return policy_gain(self.env, network, x, params, torch.zeros(len(x), 1), graph=True)[1]

    def _lack(self, k: Tensor, places: Tensor) -> Tensor:
        """Return what gains lack at some equilibria, `(n,)`."""
        a, b, k = self.a[places], self.b[places], k.nan_to_num(0.0, 0.0, 0.0)
        each = torch.einsum("nxu,nuy->nuxy", b, k).unsqueeze(1)
        change = torch.tensor([GAIN - 1, 1 / GAIN - 1, cmath.exp(1j * PHASE) - 1], dtype=torch.complex128)
        loops = (a + b @ k)[:, None, None] + change[:, None, None, None] * each
        return (torch.linalg.eigvals(loops).abs().amax(-1) - 1).clamp_min(0).sum((1, 2))
