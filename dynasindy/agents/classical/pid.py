"""One PID controller per output, and the search that tunes them on a system.

| Name         | Symbol | Unit                           | Equation                                          |
| ------------ | ------ | ------------------------------ | ------------------------------------------------- |
| error        | e      | the output's                   | e = r - y                                         |
| integral     | z      | unit of the output, s          | z[k+1] = z[k] + dt e[k]                           |
| input        | u      | 1                              | u = bias + k_p e + k_i z - k_d dy/dt              |

The derivative is that of the measured output, so a step of the reference does not kick the input
(Astrom, Hagglund, Advanced PID Control, section 3.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.agents.classical.base import TrackingController
from dynasindy.agents.classical.linearise import Equilibria
from dynasindy.systems import Signature, System, integrate

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

    def unlimited(self, x: Tensor, reference: Tensor, integral: Tensor) -> Tensor:
        """Return u = bias + k_p e + k_i z - k_d dy/dt."""
        k_p, k_i, k_d, bias = self.gains
        return bias + k_p * (reference - x[..., self.outputs]) + k_i * integral - k_d * x[..., self.rates]

    def held(self, saturated: Tensor) -> Tensor:
        """Hold the integral of each loop whose own input is at a limit."""
        return saturated


@dataclass(frozen=True)
class Tuning:
    """Cross-entropy search for PID gains: draw, simulate all side by side, keep the best, draw around them.

    Attributes:
        low: smallest k_p, k_i, k_d of the first draw.
        high: largest k_p, k_i, k_d of the first draw.
        population: gains per draw.
        elites: best gains around which the next are drawn.
        draws: number of draws.
        seconds: length of each simulated step response [s].
        variation: cost of the mean squared change of the inputs per step, beside the mean absolute error [unit].
    """

    low: tuple[float, float, float] = (0.1, 0.01, 0.1)
    high: tuple[float, float, float] = (10.0, 3.0, 10.0)
    population: int = 48
    elites: int = 6
    draws: int = 8
    seconds: float = 20.0
    variation: float = 1.0

    def run(
        self,
        system: System,
        references: Tensor,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        rates: Sequence[str] = ("Omega_a", "Omega_p"),
        dt: float = 0.05,
        seed: int = 0,
    ) -> Gains:
        """Return the gains that track steps from the origin to `references` `(n_references, n_r)` best."""
        n_u = system.signature.n_u
        bias = _resting_input(system, outputs)
        generator = torch.Generator().manual_seed(seed)
        low, high = (
            torch.tensor(ends, dtype=torch.float64).log()[:, None].expand(3, n_u) for ends in (self.low, self.high)
        )
        centre, spread = (low + high) / 2, (high - low) / 4
        for _ in range(self.draws):
            noise = torch.randn(self.population, 3, n_u, generator=generator, dtype=torch.float64)
            drawn = centre + spread * noise
            k_p, k_i, k_d = drawn.exp().unsqueeze(2).unbind(1)
            controller = PID(system.signature, Gains(k_p, k_i, k_d, bias), outputs, rates, dt)
            best = drawn[self._cost(system, controller, references.double()).argsort()[: self.elites]]
            centre, spread = best.mean(0), best.std(0) + 0.02
        rows = [tuple(row) for row in centre.exp().tolist()]
        return Gains(rows[0], rows[1], rows[2], tuple(bias.tolist()))

    @torch.no_grad()
    def _cost(self, system: System, controller: PID, references: Tensor) -> Tensor:
        """Return the cost of each of the controller's gains `(population,)`."""
        shape = self.population, len(references)
        x = torch.zeros(*shape, system.signature.n_x, dtype=torch.float64)
        reference = references.expand(*shape, -1)
        previous = controller.gains[-1]
        cost = torch.zeros(shape, dtype=torch.float64)
        for step in range(round(self.seconds / controller.dt)):
            u = controller.act(x, reference, torch.tensor([step == 0]))
            samples, _ = integrate(system, x, u, controller.dt, 5, system.stops)
            x = samples[..., -1, :]
            error = (reference - x[..., controller.outputs]).abs().sum(-1)
            cost += error + self.variation * (u - previous).square().sum(-1)
            previous = u
        return cost.mean(-1).nan_to_num(torch.inf)


def _resting_input(system: System, outputs: Sequence[str]) -> Tensor:
    equilibria = Equilibria(system, outputs)
    return equilibria.state_and_input(torch.zeros(len(outputs)), equilibria.home)[1]
