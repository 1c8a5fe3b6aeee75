"""What tracking controllers share: the integral of the error, kept from step to step and kept from winding up."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dynasindy.systems import Signature


class TrackingController(TensorDictModuleBase):
    """Policy that reads `state` and `reference` and integrates the error of some states.

    The integral belongs to the row of the batch and starts anew where `step_count` is 0. It holds still while
    the input it feeds is at its limit (conditional integration), so it does not wind up.

    Args:
        signature: names of the states.
        outputs: names of the tracked states.
        dt: control period [s].

    Raises:
        ValueError: an output does not exist, or `dt` is not positive.
    """

    in_keys: ClassVar[list[str]] = ["state", "reference", "step_count"]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, signature: Signature, outputs: Sequence[str], dt: float) -> None:
        super().__init__()
        if not dt > 0:
            raise ValueError(f"control period dt={dt}; give a time > 0 s, such as 0.05")
        self.outputs = [signature.state_index(name) for name in outputs]
        self.dt = dt
        self.integral = torch.zeros(0)

    @abstractmethod
    def unlimited(self, x: Tensor, reference: Tensor, integral: Tensor) -> Tensor:
        """Return the input `(*batch, n_u)` before its limits.

        Args:
            x: states `(*batch, n_x)`.
            reference: wanted outputs `(*batch, n_r)`.
            integral: integral of the error up to now `(*batch, n_r)` [unit of the output times s].
        """

    @abstractmethod
    def held(self, saturated: Tensor) -> Tensor:
        """Return which integrals hold still `(*batch, n_r)`, from which inputs are at a limit `(*batch, n_u)`."""

    def act(self, x: Tensor, reference: Tensor, first: Tensor) -> Tensor:
        """Return the input in [-1, 1], `(*batch, n_u)`, and carry the integral on.

        Args:
            x: states `(*batch, n_x)`, float64.
            reference: wanted outputs `(*batch, n_r)`, float64.
            first: whether a row begins an episode, `(*batch, 1)`.
        """
        if self.integral.shape != reference.shape:
            self.integral = torch.zeros_like(reference)
        integral = torch.where(first, 0.0, self.integral)
        unlimited = self.unlimited(x, reference, integral)
        error = reference - x[..., self.outputs]
        self.integral = integral + self.dt * error.masked_fill(self.held(unlimited.abs() > 1.0), 0.0)
        return unlimited.clamp(-1.0, 1.0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` (float32) from `state`, `reference` and `step_count`."""
        x, reference, steps = (tensordict.get(key) for key in self.in_keys)
        action = self.act(x.double(), reference.double(), steps == 0)
        tensordict.set("action", action.to(torch.float32))
        return tensordict
