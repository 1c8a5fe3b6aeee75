"""One PID controller per output.

| Name         | Symbol | Unit                           | Equation                                          |
| ------------ | ------ | ------------------------------ | ------------------------------------------------- |
| error        | e      | the output's                   | e = r - y                                         |
| integral     | z      | unit of the output, s          | z[k+1] = z[k] + dt e[k]                           |
| input        | u      | 1                              | u = bias + k_p e + k_i z + k_d (dr/dt - dy/dt)    |

The rate of a reference that steps is zero, so that a step does not kick the input through the derivative
(Astrom, Hagglund, Advanced PID Control, section 3.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.agents.classical.base import TrackingController
from dynasindy.systems import Signature

Numbers = Sequence[float] | Tensor


@dataclass(frozen=True)
class Gains:
    """Gains of the loops, one number per output; tensors `(*batch, n_u)` run different gains side by side.

    Attributes:
        proportional: k_p [1/unit of the output].
        integral: k_i [1/(unit s)].
        derivative: k_d [s/unit].
        bias: input at rest [1].
    """

    proportional: Numbers
    integral: Numbers
    derivative: Numbers
    bias: Numbers


class PID(TrackingController):
    """Independent PID loops: output i acts on input i.

    Args:
        signature: names of the states.
        gains: gains of the loops.
        outputs: names of the tracked states, in the order of the inputs they act on.
        rates: names of the outputs' rates.
        dt: control period [s].

    Raises:
        ValueError: a state does not exist, or numbers of outputs, rates, gains and inputs differ.
    """

    def __init__(
        self,
        signature: Signature,
        gains: Gains,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        rates: Sequence[str] = ("Omega_a", "Omega_p"),
        dt: float = 0.05,
    ) -> None:
        super().__init__(signature, outputs, dt)
        self.rates = [signature.state_index(name) for name in rates]
        values = (gains.proportional, gains.integral, gains.derivative, gains.bias)
        self.gains = [torch.as_tensor(value, dtype=torch.float64) for value in values]
        counts = [len(outputs), len(rates), *(gain.shape[-1] for gain in self.gains)]
        if set(counts) != {signature.n_u}:
            raise ValueError(
                f"PID has {counts} outputs, rates and gains (k_p, k_i, k_d, bias) for {signature.n_u} inputs; "
                "give one of each per input"
            )

    def unlimited(self, x: Tensor, reference: Tensor, rate: Tensor, integral: Tensor) -> Tensor:
        """Return u = bias + k_p e + k_i z + k_d (dr/dt - dy/dt)."""
        k_p, k_i, k_d, bias = self.gains
        error, slowness = reference - x[..., self.outputs], rate - x[..., self.rates]
        return bias + k_p * error + k_i * integral + k_d * slowness

    def held(self, saturated: Tensor) -> Tensor:
        """Hold the integral of each loop whose own input is at a limit."""
        return saturated
