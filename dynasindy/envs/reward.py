"""The tracking reward of the paper."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from dynasindy.safe_io import checked_class

ERROR_SHAPES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "quadratic": lambda error, width: error * error,
    "linear": lambda error, width: error * error / (width + error.abs()),
    "logarithmic": lambda error, width: width * torch.log1p((error / width).square()),
}
"""Cost of errors `(*batch, n_r)` and a width [rad], of the same shape; the last two equal e^2 / width near zero."""


Weight = Annotated[float, Field(ge=0)]


@checked_class
@dataclass(frozen=True, config={"allow_inf_nan": False, "extra": "forbid"})
class TrackingReward:
    """reward = -(a e_a^2 + b e_p^2) - c (dOmega_a^2 + dOmega_p^2) + d   (paper, reward function).

    Attributes:
        error_weights: a, b: weight of the squared error of each output [1/rad^2].
        rate_weight: c: weight of the squared change of each rate over a control period [s^2/rad^2].
        bonus: d: paid per output while its error is below `tolerance`.
        tolerance: Half width of the bonus band [rad] (paper: 0.01).
        stop_penalty: Cost of each control period in which a mechanical stop is touched.
        error_shape: "quadratic" as in the paper, or a shape that is quadratic within `width` and flatter beyond it,
            so that small errors still matter: "linear", e^2 / (width + |e|), or "logarithmic",
            width ln(1 + (e / width)^2).
        width: Error at which the shape turns over [rad].

    Raises:
        ValueError: A weight, penalty, tolerance or width is negative, or the shape is unknown.
    """

    # Departure: the paper's cost is quadratic; the linear and the logarithmic one are ours.
    # Departure: the paper pays d when "the error" is small; here each output earns its own d.
    # Departure: "the penalty of exceeding the bounds" is a cost per period at a mechanical stop; ending the
    # episode there instead would pay the agent for leaving.
    error_weights: tuple[Weight, ...] = (4.0, 4.0)
    rate_weight: Weight = 0.1
    bonus: Weight = 0.1
    tolerance: Weight = 0.01
    stop_penalty: Weight = 1.0
    error_shape: Literal["quadratic", "linear", "logarithmic"] = "quadratic"
    width: Annotated[float, Field(gt=0)] = 0.05

    def __call__(self, error: Tensor, rate_change: Tensor, at_stop: Tensor) -> Tensor:
        """Return the reward of one control period.

        Args:
            error: Tracking errors at its end [rad], `(*batch, n_r)`.
            rate_change: Change of the rates over it [rad/s], `(*batch, n)`; an output may have none.
            at_stop: Whether a stop was touched in it, bool `(*batch,)`.

        Returns:
            Rewards, `(*batch,)`.
        """
        cost = ERROR_SHAPES[self.error_shape](error, self.width) * error.new_tensor(self.error_weights)
        reward = -cost.sum(-1) - self.rate_weight * (rate_change * rate_change).sum(-1)
        reward = reward + self.bonus * (error.abs() < self.tolerance).to(error.dtype).sum(-1)
        return reward - self.stop_penalty * at_stop.to(error.dtype)
