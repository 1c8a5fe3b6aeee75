"""What controllers share: what they see, and the integral of the error, kept from winding up.

All see the same: the states, the reference and its rate now (zero for steps and squares), nothing of its future.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dynasindy.systems import Signature
from dynasindy.tasks import references


class Controller(TensorDictModuleBase):
    """Policy that reads `state`, `reference`, `step_count` and, for the reference's rate, `task_params`.

    Without `task_params` the reference is taken to be at rest. What a controller keeps from step to step belongs to
    the row of the batch and starts anew where `step_count` is 0.

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

    @abstractmethod
    def act(self, x: Tensor, reference: Tensor, rate: Tensor, first: Tensor) -> Tensor:
        """Return the input in [-1, 1], `(*batch, n_u)`.

        Args:
            x: states `(*batch, n_x)`, float64.
            reference: wanted outputs `(*batch, n_r)`, float64.
            rate: their rates `(*batch, n_r)` [unit of the output per second], float64.
            first: whether a row begins an episode, `(*batch, 1)`.
        """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` (float32)."""
        x, reference, steps = (tensordict.get(key) for key in self.in_keys)
        params = tensordict.get("task_params", None)
        rate = torch.zeros_like(reference) if params is None else references.rate(params, steps * self.dt)
        action = self.act(x.double(), reference.double(), rate.double(), steps == 0)
        return tensordict.set("action", action.to(torch.float32))


class TrackingController(Controller):
    """Controller with integral action.

    The integral holds still while the input it feeds is at its limit (conditional integration), so it does not wind
    up.

    Args:
        signature: names of the states.
        outputs: names of the tracked states.
        dt: control period [s].
    """

    def __init__(self, signature: Signature, outputs: Sequence[str], dt: float) -> None:
        super().__init__(signature, outputs, dt)
        self.integral = torch.zeros(0)

    @abstractmethod
    def unlimited(self, x: Tensor, reference: Tensor, rate: Tensor, integral: Tensor) -> Tensor:
        """Return the input `(*batch, n_u)` before its limits.

        Args:
            x: states `(*batch, n_x)`.
            reference: wanted outputs `(*batch, n_r)`.
            rate: their rates `(*batch, n_r)` [unit of the output per second].
            integral: integral of the error up to now `(*batch, n_r)` [unit of the output times s].
        """

    @abstractmethod
    def held(self, saturated: Tensor) -> Tensor:
        """Return which integrals hold still `(*batch, n_r)`, from which inputs are at a limit `(*batch, n_u)`."""

    def act(self, x: Tensor, reference: Tensor, rate: Tensor, first: Tensor) -> Tensor:
        """Return the input in [-1, 1], `(*batch, n_u)`, and carry the integral on."""
        error = reference - x[..., self.outputs]
        if self.integral.shape != error.shape:
            self.integral = torch.zeros_like(error)
        integral = torch.where(first, 0.0, self.integral)
        unlimited = self.unlimited(x, reference, rate, integral)
        self.integral = integral + self.dt * error.masked_fill(self.held(unlimited.abs() > 1.0), 0.0)
        return unlimited.clamp(-1.0, 1.0)
