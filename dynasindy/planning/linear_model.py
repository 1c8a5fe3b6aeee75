"""Equilibria and linear models of any system, from its vector field alone."""

from collections.abc import Sequence

import torch
from scipy.linalg import expm
from torch import Tensor
from torch.autograd.functional import jacobian
from torch.nn.functional import pad

from dynasindy.systems import System
from dynasindy.systems.steps import steps_of

_TOLERANCE = 1e-9
_ITERATIONS = 50
_STEP = 1e-6
GONE = 1e-6
"""Part of a motion that is left after a step of a difference equation, below which nothing is."""


def jacobians(system: System, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return A = df/dx `(n_x, n_x)` and B = df/du `(n_x, n_u)` in float64 at `x` `(n_x,)`, `u` `(n_u,)`."""
    a, b = jacobian(system, (x.double(), u.double()))
    return a, b


def discretize(a: Tensor, b: Tensor, dt: float, step: float | None = None) -> tuple[Tensor, Tensor]:
    """Sample a linear system exactly: x[k+1] = Ad x[k] + Bd u[k] under an input held for `dt` [s].

    Args:
        a: `(n_x, n_x)` [1/s].
        b: `(n_x, n_u)` [1/s].
        dt: sampling time [s].
        step: of the difference equation x + step (a x + b u) that it is [s]; None of a differential equation.

    Raises:
        ValueError: the sampling time is not made of whole steps of the difference equation.
    """
    if step is not None:
        h, count, _ = steps_of(step, dt, 1)
        once = torch.eye(len(a), dtype=a.dtype) + h * a
        powers = [torch.linalg.matrix_power(once, k) for k in range(count)]
        return once @ powers[-1], h * torch.stack(powers).sum(0) @ b
    # The input is a state that does not change. scipy.signal has this as a function, for a second of imports.
    held = pad(torch.cat((a, b), 1), (0, 0, 0, b.shape[1]))
    sampled = torch.as_tensor(expm((held * dt).numpy()))[: len(a)]
    return sampled[:, : len(a)], sampled[:, len(a) :]


def modes(a: Tensor, step: float | None = None) -> Tensor:
    """Return the modes s of a linear system, its motions e^(s t), complex `(n_x,)` [1/s].

    Args:
        a: `(n_x, n_x)` [1/s].
        step: of the difference equation x + step a x that it is [s]; None of a differential equation.
    """
    rates = torch.linalg.eigvals(a)
    return rates if step is None else continuous_rates(rates, step)


def continuous_rates(rates: Tensor, step: float) -> Tensor:
    """Return the modes s [1/s], in continuous time, of a difference equation x + step a x, given the eigenvalues of a.

    What is gone after a step has no mode; it counts as one of which `GONE` is left.
    """
    factors = 1 + step * rates
    return torch.where(factors.abs() > GONE, factors, GONE).log() / step


class EquilibriumSolver:
    """Where a system rests with its outputs at given values: f(x, u) = 0, by Newton's method.

    Args:
        system: the vector field.
        outputs: names of the states that are held, as many as there are inputs.

    Raises:
        ValueError: the numbers of outputs and inputs differ, or there is no equilibrium at the origin.
    """

    def __init__(self, system: System, outputs: Sequence[str]) -> None:
        signature = system.signature
        if len(outputs) != signature.n_u:
            raise ValueError(
                f"outputs {list(outputs)} are {len(outputs)} and inputs are {signature.n_u}; name one output per input"
            )
        self.system = system
        self.outputs = [signature.state_index(name) for name in outputs]
        self.free = [i for i in range(signature.n_x) if i not in self.outputs]
        scale = torch.tensor(signature.x_scale, dtype=torch.float64)
        self.scale = torch.cat((scale[self.free], torch.ones(signature.n_u, dtype=torch.float64)))
        self.home = self._search(torch.zeros(len(outputs), dtype=torch.float64))

    def __call__(self, reference: Tensor, guess: Tensor | None = None, drift: Tensor | None = None) -> Tensor:
        """Return the unknowns `(*batch, n_free + n_u)`, scaled, that hold the outputs at `reference` `(*batch, n_r)`.

        Args:
            reference: values of the outputs.
            guess: unknowns to start from, by default those at the origin.
            drift: rates of change to be met, f(x, u) = drift, `(*batch, n_x)`; all zero by default. See `moving`.

        Raises:
            ValueError: Newton's method finds no equilibrium for a reference.
        """
        reference = reference.double()
        flat = reference.reshape(-1, reference.shape[-1])
        unknowns = (self.home if guess is None else guess).expand(*reference.shape[:-1], -1)
        unknowns = unknowns.reshape(len(flat), -1).clone()
        shift = 0.0 if drift is None else drift.reshape(len(flat), -1) / self._ranges()
        for _ in range(_ITERATIONS):
            residual = self._residual(unknowns, flat) - shift
            if residual.abs().max() < _TOLERANCE:
                return unknowns.reshape(*reference.shape[:-1], -1)
            unknowns = unknowns - torch.linalg.solve(self._slope(unknowns, flat), residual)
        worst = flat[residual.abs().amax(-1).argmax()].tolist()
        raise ValueError(f"the system does not rest with its outputs at {worst}; keep references within its reach")

    def moving(self, rate: Tensor) -> Tensor:
        """Return the drift `(*batch, n_x)` under which the outputs move at `rate` `(*batch, n_r)`, all else at rest."""
        drift = torch.zeros(*rate.shape[:-1], self.system.signature.n_x, dtype=torch.float64)
        drift[..., self.outputs] = rate.double()
        return drift

    def state_and_input(self, reference: Tensor, unknowns: Tensor) -> tuple[Tensor, Tensor]:
        """Return the state `(*batch, n_x)` and the input `(*batch, n_u)` of an equilibrium."""
        values = unknowns * self.scale
        n_free = len(self.free)
        x = torch.zeros(*reference.shape[:-1], n_free + len(self.outputs), dtype=torch.float64)
        x = x.index_copy(-1, torch.tensor(self.outputs), reference.double())
        x = x.index_copy(-1, torch.tensor(self.free, dtype=torch.int64), values[..., :n_free])
        return x, values[..., n_free:]

    def _residual(self, unknowns: Tensor, reference: Tensor) -> Tensor:
        x, u = self.state_and_input(reference, unknowns)
        return self.system(x, u) / self._ranges()

    def _ranges(self) -> Tensor:
        return torch.tensor(self.system.signature.x_scale, dtype=torch.float64)

    def _slope(self, unknowns: Tensor, reference: Tensor) -> Tensor:
        """Return the residual's Jacobian `(batch, n, n)`, by central differences in one call of the system."""
        steps = _STEP * torch.eye(unknowns.shape[-1], dtype=torch.float64)
        around = torch.stack((unknowns.unsqueeze(1) + steps, unknowns.unsqueeze(1) - steps))
        ahead, behind = self._residual(around, reference.unsqueeze(1).expand(2, -1, len(steps), -1))
        return ((ahead - behind) / (2 * _STEP)).mT

    def _search(self, reference: Tensor) -> Tensor:
        """Search from several starts: at rest the slope of a rotor's thrust is zero and Newton's method stuck."""
        from scipy.optimize import root  # where Newton's method did not arrive

        generator = torch.Generator().manual_seed(0)
        for _ in range(_ITERATIONS):
            start = 0.5 * torch.randn(self.scale.shape, generator=generator, dtype=torch.float64)
            found = root(lambda v: self._residual(torch.as_tensor(v), reference).numpy(), start.numpy(), method="lm")
            unknowns = torch.as_tensor(found.x)
            u = unknowns[len(self.free) :]
            if self._residual(unknowns, reference).abs().max() < 1e-6 and u.abs().max() <= 1:
                return unknowns
        raise ValueError("the system does not rest with its outputs at zero; choose other outputs")
