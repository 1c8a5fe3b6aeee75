"""Margins that a policy lacks at rest in the model: a cost beside that of imagined episodes.

Where a plant answers weakly, as a rotor that stands still, a loop without margin moves so little and so slowly that no
imagined episode shows it. Its linear model does, where the policy rests, of movements as a check looks at:

| name   | symbol | equation                                                                          |
| ------ | ------ | --------------------------------------------------------------------------------- |
| slopes | A, B   | of the state one control period later, by state and input, over `MOVEMENT`        |
| gain   | K      | of the policy, by state, over `MOVEMENT`                                          |
| factor | d      | of one input: g, 1 / g or e^(i p) by both margins below, 1 of the others          |
| lack   |        | sum of max(0, abs(s) - 1), s the largest eigenvalue of each A + B diag(d) K       |
"""

from __future__ import annotations

import cmath
import math

import torch
from torch import Tensor, nn

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.envs.references import Step
from dynasindy.planning.rollout import Network, Rows, imagine
from dynasindy.systems import integrate
from dynasindy.systems.equilibria import Equilibria

MOVEMENT = 0.01
"""Movements by which loops are judged [ranges]: what dry friction, a rotor at standstill or a policy does about a still
smaller one concerns nobody."""
GAIN_MARGIN, PHASE_MARGIN = 2.2, math.radians(35)
"""Margins that are asked for, a little more than those of a check."""
SETTLING, NEAR = 200, 0.05
"""Control periods after which a policy rests that began at an equilibrium, and how near to it [target ranges]; one that
does not is judged at the equilibrium itself."""
FOLLOWED = 4
"""Equilibria, those where a policy lacks most, whose gradient is followed."""
SHARE = 0.5
"""Largest gradient of the lack, in norms of that of the episodes, which it would drown where a loop turns unstable."""


class MarginCost:
    """Cost of the margins that a policy lacks where it rests near the equilibria of a model.

    Args:
        env: Imagined environment, whose task tracks references.
        equilibria: Equilibria of its model.
    """

    def __init__(self, env: ControlEnv, equilibria: Equilibria) -> None:
        task = env.task
        assert isinstance(task, Tracking)
        params = Step(equilibria.targets.tolist()).sample(torch.Size((len(equilibria),)), torch.Generator())
        self.env, self.task, self.moved, self.u = env, task, equilibria.moved, equilibria.u
        self.start, self.sizes = Rows.start(equilibria.x, params, self.u.shape[-1]), MOVEMENT * task.state_ranges()
        self.followed = torch.arange(0)

    def select(self, network: Network) -> float:
        """Choose the equilibria at which a policy lacks most, none where it lacks nothing; return the mean lack."""
        whole, (n, n_x) = imagine(self.env, network, self.start, SETTLING), self.start.x.shape
        missed = (whole.states[-1] - self.start.x)[:, self.task.outputs].abs() / self.task.boxes()
        near = (missed <= NEAR).all(-1, keepdim=True)
        # Beside its target a policy may rest on the other side of a kink, as with a rotor that turns backwards.
        self.x = whole.states[-1].where(near, self.start.x)
        sizes = torch.cat([self.sizes, torch.full(self.u.shape[1:], MOVEMENT, dtype=torch.float64)])
        around = torch.cat([self.x, whole.applied[-1].where(near, self.u)], -1).unsqueeze(1) + _back_and_forth(sizes)
        ends = integrate(self.env.system, around[..., :n_x], around[..., n_x:], self.env.dt, self.env.substeps)[0]
        slopes = _slopes(ends[..., -1, :], sizes)[:, self.moved].nan_to_num(0.0, 0.0, 0.0)
        self.a, self.b = slopes[..., :n_x][..., self.moved], slopes[..., n_x:]
        every = torch.arange(n)
        lack = self._lack(self._gain(network, every).detach()[..., self.moved].double(), every)
        worst = lack.topk(min(FOLLOWED, n)).indices
        self.followed = worst[lack[worst] > 0]
        return float(lack.mean())

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
        x = self.x[places].unsqueeze(1) + _back_and_forth(self.sizes).float()
        params = self.start.params[places].unsqueeze(1).expand(-1, x.shape[1], -1, -1)
        u = network(self.task.observation(x, params, torch.zeros(*x.shape[:2], 1)))
        return _slopes(u, self.sizes.float())

    def _lack(self, k: Tensor, places: Tensor) -> Tensor:
        """Return what gains lack at some equilibria, `(n,)`."""
        a, b, k = self.a[places], self.b[places], k.nan_to_num(0.0, 0.0, 0.0)
        each = torch.einsum("nxu,nuy->nuxy", b, k).unsqueeze(1)
        change = torch.tensor(
            [GAIN_MARGIN - 1, 1 / GAIN_MARGIN - 1, cmath.exp(1j * PHASE_MARGIN) - 1], dtype=torch.complex128
        )
        loops = (a + b @ k)[:, None, None] + change[:, None, None, None] * each
        return (torch.linalg.eigvals(loops).abs().amax(-1) - 1).clamp_min(0).sum((1, 2))


def _back_and_forth(sizes: Tensor) -> Tensor:
    """Return a step of each size forth, and one of each back, `(2 k, k)`."""
    return torch.cat([torch.diag(sizes), -torch.diag(sizes)])


def _slopes(ends: Tensor, sizes: Tensor) -> Tensor:
    """Return the slopes `(n, m, k)` of values `(n, 2 k, m)` after k steps of these sizes forth, and back."""
    forth, back = ends.chunk(2, 1)
    return ((forth - back) / (2 * sizes.unsqueeze(-1))).mT
