"""The search that tunes PID and LQI: on a model, on references like those that policies are trained on.

Cross-entropy method: draw, simulate all candidates side by side, keep the best, draw around them. A candidate is a row
of positive numbers, searched on a logarithmic scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.agents.classical.base import TrackingController
from dynasindy.agents.classical.linearise import Equilibria
from dynasindy.agents.classical.lqi import LQI
from dynasindy.agents.classical.pid import PID, Gains
from dynasindy.systems import System, integrate
from dynasindy.tasks import references

Candidates = Callable[[Tensor], TrackingController]
"""Numbers `(population, 1, n)` to a controller whose gains differ between the rows of a batch `(population, rows)`."""

STEADY_SECONDS = 5.0
"""Length of the final part of a run that counts as steady state [s]."""


@dataclass(frozen=True)
class Trial:
    """What candidates are tried on.

    Attributes:
        system: the model that they control.
        wanted: parameters of the references to track, `(n_references, n_r, 5)`.
        outputs: names of the tracked states, one per input.
        rates: names of the outputs' rates.
        dt: control period [s].
    """

    system: System
    wanted: Tensor
    outputs: Sequence[str] = ("alpha_a", "alpha_p")
    rates: Sequence[str] = ("Omega_a", "Omega_p")
    dt: float = 0.05


@dataclass(frozen=True)
class Tuning:
    """Settings of the search.

    The cost is the sum over outputs of root mean square error, mean absolute error and, where the reference stood
    still for 10 s at the end, mean absolute error over the last 5 s, averaged over references, plus `variation` times
    the mean squared change of the inputs.

    Attributes:
        population: candidates per draw.
        elites: best candidates around which the next are drawn.
        draws: number of draws.
        seconds: length of each simulated run [s].
        variation: cost of the mean squared change of the inputs per step [unit of the outputs].
        substeps: Runge-Kutta steps per control period.
    """

    population: int = 48
    elites: int = 6
    draws: int = 10
    seconds: float = 20.0
    variation: float = 0.5
    substeps: int = 2

    def search(
        self, trial: Trial, build: Candidates, ends: tuple[Sequence[float], Sequence[float]], seed: int = 0
    ) -> Tensor:
        """Return the best numbers `(n,)`.

        Args:
            trial: what the candidates are tried on.
            build: makes a controller of a population's numbers.
            ends: smallest and largest of each number in the first draw; later draws may leave that range.
            seed: seed of the draws.
        """
        generator = torch.Generator().manual_seed(seed)
        low, high = (torch.tensor(list(end), dtype=torch.float64).log() for end in ends)
        centre, spread = (low + high) / 2, (high - low) / 4
        for _ in range(self.draws):
            noise = torch.randn(self.population, len(centre), generator=generator, dtype=torch.float64)
            drawn = centre + spread * noise
            cost = self.cost(trial, build(drawn.exp().unsqueeze(1)))
            best = drawn[cost.argsort()[: self.elites]]
            centre, spread = best.mean(0), best.std(0) + 0.02
        return centre.exp()

    @torch.no_grad()
    def cost(self, trial: Trial, controller: TrackingController) -> Tensor:
        """Return the cost of each of the controller's gains `(population,)`, infinite where a run diverges."""
        system, wanted, dt = trial.system, trial.wanted.double(), trial.dt
        steps = round(self.seconds / dt)
        final = round(STEADY_SECONDS / dt)
        times = dt * torch.arange(steps, dtype=torch.float64).reshape(-1, 1, 1)
        values, slopes = references.value(wanted, times), references.rate(wanted, times)
        still = (values[-2 * final :] == values[-1]).all(0)
        x = torch.zeros(1, len(wanted), system.signature.n_x, dtype=torch.float64)
        errors, inputs = [], []
        for step in range(steps):
            u = controller.act(x, values[step], slopes[step], torch.tensor([step == 0]))
            errors.append(values[step] - x[..., controller.outputs])
            inputs.append(u)
            samples, _ = integrate(system, x.expand(*u.shape[:-1], -1), u, dt, self.substeps, system.stops)
            x = samples[..., -1, :]
        first, *others = errors
        error = torch.stack([first.expand_as(others[-1]), *others]).abs()
        change = torch.stack(inputs).diff(dim=0).square().sum(-1).mean(0)
        settled = error[-final:].mean(0) * still
        cost = (error.square().mean(0).sqrt() + error.mean(0) + settled).sum(-1).mean(-1)
        cost = cost + self.variation * change.mean(-1)
        return cost.nan_to_num(torch.inf)


def tuned_pid(trial: Trial, tuning: Tuning | None = None, seed: int = 0) -> PID:
    """Return PID loops whose gains track best in a trial.

    Args:
        trial: What they are tried on.
        tuning: Settings of the search.
        seed: Seed of the search.

    Raises:
        ValueError: There is no equilibrium at the origin, or numbers of outputs, rates and inputs differ.
    """
    signature = trial.system.signature
    equilibria = Equilibria(trial.system, trial.outputs)
    n = signature.n_u
    bias = equilibria.state_and_input(torch.zeros(n), equilibria.home)[1]

    def _build(numbers: Tensor) -> PID:
        k_p, k_i, k_d = numbers.unflatten(-1, (3, n)).unbind(-2)
        return PID(signature, Gains(k_p, k_i, k_d, bias), trial.outputs, trial.rates, trial.dt)

    ends = [0.1] * n + [0.01] * n + [0.1] * n, [10.0] * n + [3.0] * n + [10.0] * n
    best = (tuning or Tuning()).search(trial, _build, ends, seed)
    return _build(best)


def tuned_lqi(trial: Trial, tuning: Tuning | None = None, seed: int = 0) -> LQI:
    """Return an LQI whose weights track best in a trial.

    Searched are the weights of the outputs, their rates and their integrals; those of the inputs are 1.

    Args:
        trial: What they are tried on.
        tuning: Settings of the search.
        seed: Seed of the search.

    Raises:
        ValueError: There is no equilibrium at the origin, or the linearised system cannot be stabilised.
    """
    signature = trial.system.signature
    n_x, n = signature.n_x, signature.n_u
    places = [signature.state_index(name) for name in (*trial.outputs, *trial.rates)] + [n_x + i for i in range(n)]
    start = [1.0 if i in places else 0.0 for i in range(n_x)]
    controller = LQI(trial.system, trial.outputs, trial.dt, start, [1.0] * n, [1.0] * n)

    def _gain(row: Sequence[float]) -> Tensor:
        weights = [0.0] * (n_x + n)
        for place, weight in zip(places, row, strict=True):
            weights[place] = weight
        try:
            return controller.riccati(weights, [1.0] * n)
        except ValueError:  # a candidate without a stabilising gain loses
            return torch.full((n, n_x + n), torch.nan, dtype=torch.float64)

    def _build(numbers: Tensor) -> LQI:
        controller.gain = torch.stack([_gain(row) for row in numbers.flatten(0, -2).tolist()]).unsqueeze(1)
        return controller

    ends = [1.0] * n + [0.01] * n + [1.0] * n, [3000.0] * n + [100.0] * n + [3000.0] * n
    best = (tuning or Tuning()).search(trial, _build, ends, seed)
    controller.gain = _gain(best.tolist())
    return controller
