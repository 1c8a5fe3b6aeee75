"""Steps of the critics and of the actor down their losses, by automatic differentiation."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.optim import Adam

from dynasindy.agents.loss import TD3Loss

Check = Callable[[Tensor, str], None]
"""Takes a loss and its name before any weight moves by it; raises if it is not finite."""


class GradientSteps:
    """Steps of Adam down the two losses of TD3.

    Args:
        loss: the loss module.
        critics: the optimiser of the critics.
        actor: the optimiser of the actor.
        bound: bound of each gradient's norm; 0 leaves gradients as they are.
    """

    def __init__(self, loss: TD3Loss, critics: Adam, actor: Adam, bound: float) -> None:
        self.loss, self.optimizers, self.bound = loss, (critics, actor), bound

    def stands(self) -> bool:
        """Return whether the steps still fit what they were made of."""
        return True

    def critics(self, batch: TensorDictBase, check: Check) -> tuple[Tensor, Tensor]:
        """Take a step of the critics; return their loss and their mean value.

        Args:
            batch: transitions `(batch,)`.
            check: told of the loss before the step.
        """
        loss, parts = self.loss.value_loss(batch)
        check(loss, "the critics' loss")
        self._descend(loss, self.optimizers[0])
        return loss.detach(), parts["pred_value"].mean()

    def actor(self, batch: TensorDictBase, check: Check) -> Tensor:
        """Take a step of the actor; return its loss.

        Args:
            batch: transitions `(batch,)`.
            check: told of the loss before the step.
        """
        loss, _ = self.loss.actor_loss(batch)
        check(loss, "the actor's loss")
        self._descend(loss, self.optimizers[1])
        return loss.detach()

    def _descend(self, loss: Tensor, optimizer: Adam) -> None:
        optimizer.zero_grad()
        loss.backward()
        if self.bound:
            nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], self.bound)
        optimizer.step()


def adam_states(optimizer: Adam, weights: Sequence[Tensor]) -> list[dict[str, Tensor]]:
    """Return what Adam keeps of some weights; what it has not made yet is made as it would.

    Args:
        optimizer: The optimiser.
        weights: Tensors that lie where its parameters do.
    """
    owners = {parameter.data_ptr(): parameter for parameter in optimizer.param_groups[0]["params"]}
    states = []
    for tensor in weights:
        state = optimizer.state[owners[tensor.data_ptr()]]
        if not state:
            state["step"] = torch.zeros((), dtype=torch.float32)
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(tensor), torch.zeros_like(tensor)
        states.append(state)
    return states
