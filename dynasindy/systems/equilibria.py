"""Where a model rests with its tracked states at given values, and what it is like there.

A rest is a state and an input with f(x, u) = 0. There may be fewer inputs than tracked states (a cart with a pole) or
more (two pumps of one tank), and a reference may have no rest; so each is the least-squares solution, and is counted
as found if little is left of f.

By its linearisation there a model has oscillations, and leaves the place at some rate:

| name        | symbol | equation                                                                             |
| ----------- | ------ | ------------------------------------------------------------------------------------ |
| mode        | s, v, w | A v = s v, w' A = s w', states in their ranges, v and w of length 1                 |
| damping     | z      | -Re(s) / abs(s)                                                                      |
| oscillation | T      | 2 pi / abs(Im(s)) [s]                                                                |
| moved       |        | by an input whose b has abs(w' b) > SHARE abs(s) abs(w' v): it bends the mode by so much |
| seen        |        | in an output whose part of v is larger than SHARE                                    |
| doubling    |        | log(2) / Re(s) [s], of a mode that grows                                             |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import eig, expm
from torch import Tensor

from dynasindy.systems.base import System

STARTS = 64
"""Guesses from which the first rest is searched."""
ITERATIONS = 60
"""Steps of Levenberg and Marquardt's method."""
LEFT, NEARLY = 1e-3, 5e-2
"""Rate of change [ranges of the states per second] that counts as none; the larger one where no reference has a rest by
the smaller: a cosine and a sine of one angle, both tracked, have one in theory, and nearly one in a fitted model."""
PERIOD = 0.05
"""Longest control period that `LEFT` and `NEARLY` are meant for [s]; a slower plant rests with so much less."""
GONE = 1e-6
"""Part of a motion that is left after a step of a difference equation, below which nothing is."""
_STEP = 1e-5


@dataclass(frozen=True)
class Equilibria:
    """Equilibria of a model, one per reference, and its linearisation there.

    Attributes:
        targets: Values of the tracked states, `(n, n_r)`.
        x: States, `(n, n_x)`.
        u: Inputs, `(n, n_u)`.
        a: df/dx, `(n, n_x, n_x)` [1/s].
        b: df/du, `(n, n_x, n_u)` [1/s].
        moved: States that take part: those tracked and those that anything depends on, bool `(n_x,)`.
        unheld: Values of the tracked states that no input within its range holds, `(m, n_r)`.
        needed: Inputs that would hold them, `(m, n_u)`, NaN where no input would.
    """

    targets: Tensor
    x: Tensor
    u: Tensor
    a: Tensor
    b: Tensor
    moved: Tensor
    unheld: Tensor
    needed: Tensor

    def __len__(self) -> int:
        return len(self.targets)

    def middle(self) -> int:
        """Return the place of the rest whose targets are nearest to the mean of all."""
        return int((self.targets - self.targets.mean(0)).square().sum(-1).argmin())


def find_equilibria(
    system: System, outputs: Sequence[int], targets: Tensor, start: Tensor, dt: float, limits: Tensor | None = None
) -> Equilibria:
    """Return the rests that some references have; those without one, or beyond the limits of inputs, are left out.

    Args:
        system: Vector field.
        outputs: Places of the tracked states.
        targets: References, `(n, n_r)`.
        start: State near which rests are searched, `(n_x,)`.
        dt: Control period [s], which tells how slow a plant is that does not rest.
        limits: Least and largest inputs, `(2, n_u)`; if omitted, -1 and 1.
    """
    if limits is None:
        limits = torch.tensor([[-1.0], [1.0]]).expand(-1, system.signature.n_u)
    targets, search = targets.double(), _Search(system, list(outputs), start.double(), dt, limits.double())
    centre = targets[(targets - targets.mean(0)).square().sum(-1).argmin()].expand(STARTS, -1)
    around = torch.randn(STARTS, len(search.guess), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    around[0] = 0.0
    first = search.solve(centre, search.guess + 0.4 * around)
    for left in (LEFT, NEARLY):
        good = (search.left(first, centre) < left) & search.inside(first, centre)
        size = (first - search.guess).square().sum(-1).where(good, torch.inf)
        begin = first[size.argmin()] if bool(good.any()) else search.guess
        found = search.solve(targets, begin.expand(len(targets), -1))
        (x, u), rests = search.parts(found, targets), search.left(found, targets) < left
        a, b = slopes(system, x, u)
        good = rests & search.inside(found, targets) & a.isfinite().all(-1).all(-1) & b.isfinite().all(-1).all(-1)
        if bool(good.any()):
            break
    needed = u.where(rests.unsqueeze(-1), torch.nan)
    return Equilibria(targets[good], x[good], u[good], a[good], b[good], search.moved, targets[~good], needed[~good])


def slopes(system: System, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return df/dx, `(n, n_x, n_x)`, and df/du, `(n, n_x, n_u)`, by central differences [1/s]."""
    scale, n_x = torch.tensor(system.signature.x_scale, dtype=x.dtype), x.shape[-1]

    def _along(step: Tensor) -> Tensor:
        return system(x.unsqueeze(1) + step[:, :n_x] * scale, u.unsqueeze(1) + step[:, n_x:])

    _, found = central_differences(_along, torch.full((n_x + u.shape[-1],), _STEP, dtype=x.dtype))
    return found[..., :n_x] / scale, found[..., n_x:]


@torch.no_grad()
def central_differences(f: Callable[[Tensor], Tensor], steps: Tensor) -> tuple[Tensor, Tensor]:
    """Return a function at zero, `(*batch, m)`, and its slopes there, `(*batch, m, n)`.

    Args:
        f: From points `(rows, n)` to values `(*batch, rows, m)`.
        steps: Steps to both sides along each axis, `(n,)`.
    """
    n, sides = len(steps), torch.diag(steps)
    centre, forth, back = f(torch.cat([torch.zeros_like(sides[:1]), sides, -sides])).split([1, n, n], -2)
    return centre.squeeze(-2), ((forth - back) / (2 * steps.unsqueeze(-1))).mT


def modes(a: Tensor, step: float | None = None) -> Tensor:
    """Return the modes s of a linear system, its motions e^(s t), complex `(n_x,)` [1/s].

    Args:
        a: `(n_x, n_x)` [1/s].
        step: of the difference equation x + step a x that it is [s]; None of a differential equation.
    """
    rates = torch.linalg.eigvals(a)
    return rates if step is None else _continuous_rates(rates, step)


def _continuous_rates(rates: Tensor, step: float) -> Tensor:
    """Return the modes s [1/s] of a difference equation x + step a x; what is gone after a step counts as `GONE`."""
    factors = 1 + step * rates
    return torch.where(factors.abs() > GONE, factors, GONE).log() / step


def growth(a: Tensor, scale: Tensor, seconds: float, step: float | None = None) -> float:
    """Return by how much a deviation of a state may have grown after some time, in ranges; inf beyond all numbers.

    Args:
        a: df/dx, `(n_x, n_x)` [1/s].
        scale: Ranges of the states, `(n_x,)`.
        seconds: The time [s].
        step: Of the difference equation that the model is [s]; None of a differential equation.
    """
    scaled = a * scale / scale.unsqueeze(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        if step is None:
            grown = torch.as_tensor(expm((scaled * seconds).numpy()))
        else:
            once = torch.eye(len(a), dtype=a.dtype) + step * scaled
            grown = torch.linalg.matrix_power(once, max(1, round(seconds / step)))
    return float(torch.linalg.matrix_norm(grown, 2)) if bool(grown.isfinite().all()) else math.inf


def states_that_matter(system: System, outputs: Sequence[int], start: Tensor) -> Tensor:
    """Return which states are tracked or change a rate of change, bool `(n_x,)`; a mileage is neither, and never rests.

    Args:
        system: Vector field.
        outputs: Places of the tracked states.
        start: State around which derivatives are taken, `(n_x,)`.
    """
    n_x, n_u, start = system.signature.n_x, system.signature.n_u, start.double()
    generator = torch.Generator().manual_seed(1)
    scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
    x = start + scale * torch.randn(16, n_x, generator=generator, dtype=torch.float64)
    u = 2 * torch.rand(16, n_u, generator=generator, dtype=torch.float64) - 1
    matter = slopes(system, x, u)[0].abs().amax((0, 1)) > 1e-9
    matter[list(outputs)] = True
    return matter


class _Search:
    """Levenberg and Marquardt's method on f(x, u) = 0, many references at once, in ranges of the states."""

    def __init__(self, system: System, outputs: list[int], start: Tensor, dt: float, limits: Tensor) -> None:
        signature = system.signature
        self.system, self.outputs, self.start, self.limits = system, outputs, start, limits
        self.scale, self.pace = torch.tensor(signature.x_scale, dtype=torch.float64), max(1.0, dt / PERIOD)
        self.free = [i for i in range(signature.n_x) if i not in outputs]
        self.moved = states_that_matter(system, outputs, start)
        self.guess = torch.cat([start[self.free] / self.scale[self.free], limits.mean(0)])

    def parts(self, v: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Return states and inputs of unknowns `(*batch, m)`."""
        n = len(self.free)
        x = self.start.expand(*v.shape[:-1], -1).clone()
        x[..., self.outputs] = targets
        x[..., self.free] = v[..., :n] * self.scale[self.free]
        return x, v[..., n:]

    @torch.no_grad()
    def residual(self, v: Tensor, targets: Tensor) -> Tensor:
        """Return the rates of change that count, in ranges of the states per second, or per `dt / PERIOD` seconds."""
        dx: Tensor = self.pace * self.system(*self.parts(v, targets)) / self.scale
        return dx[..., self.moved]

    def left(self, v: Tensor, targets: Tensor) -> Tensor:
        return self.residual(v, targets).abs().amax(-1).nan_to_num(torch.inf)

    def inside(self, v: Tensor, targets: Tensor) -> Tensor:
        u = self.parts(v, targets)[1]
        return ((u >= self.limits[0] - 1e-6) & (u <= self.limits[1] + 1e-6)).all(-1)

    def solve(self, targets: Tensor, v: Tensor) -> Tensor:
        eye = torch.eye(v.shape[-1], dtype=v.dtype)
        damping, v = torch.full((len(v), 1, 1), 1e-3, dtype=v.dtype), v.clone()
        now = self.residual(v, targets).nan_to_num(1e6, 1e6, -1e6)
        for _ in range(ITERATIONS):
            j = self._slope(v, targets).nan_to_num(0.0, 0.0, 0.0)
            step = torch.linalg.solve(j.mT @ j + damping * eye, j.mT @ now.unsqueeze(-1)).squeeze(-1)
            tried = v - step
            then = self.residual(tried, targets).nan_to_num(1e6, 1e6, -1e6)
            better = then.square().sum(-1) < now.square().sum(-1)
            v, now = tried.where(better.unsqueeze(-1), v), then.where(better.unsqueeze(-1), now)
            damping = (damping * torch.where(better, 0.2, 4.0)[:, None, None]).clamp(1e-12, 1e8)
            if not bool((now.abs().amax(-1) > 1e-10).any()):
                break
        return v

    def _slope(self, v: Tensor, targets: Tensor) -> Tensor:
        def _around(steps: Tensor) -> Tensor:
            return self.residual(v.unsqueeze(1) + steps, targets.unsqueeze(1).expand(-1, len(steps), -1))

        return central_differences(_around, torch.full_like(v[0], _STEP))[1]


LIGHT = 0.5
"""Damping ratio below which a mode swings on; at 0.5 each swing is a sixth of the one before."""
SHARE = 1e-3
"""Part of the ranges of the states by which a mode has to be moved by an input, or seen in an output, to count."""


class LocalModes:
    """The modes of a model that an input moves or an output shows, at a place; none where a slope is not finite.

    Attributes:
        rates: of the modes, complex `(n,)` [1/s].

    Args:
        system: Vector field.
        x: Where it is linearised, `(n_x,)`.
        u: Inputs there, `(n_u,)`.
        outputs: Places of the tracked or measured states.
    """

    def __init__(self, system: System, x: Tensor, u: Tensor, outputs: Sequence[int]) -> None:
        a, b = (found[0] for found in slopes(system, x.double().unsqueeze(0), u.double().unsqueeze(0)))
        if not bool(a.isfinite().all() & b.isfinite().all()):
            self.rates = torch.zeros(0, dtype=torch.complex128)
            return
        scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
        rates, left, right = map(torch.as_tensor, eig((a * scale / scale.unsqueeze(-1)).numpy(), left=True))
        reach = (left.mH @ (b / scale.unsqueeze(-1)).to(left)).abs().amax(-1)
        moved = reach > SHARE * rates.abs() * (left.conj() * right).sum(0).abs()
        seen = right[list(outputs)].abs().amax(0) > SHARE
        self.rates = (rates if system.step is None else _continuous_rates(rates, system.step))[moved | seen]

    @property
    def oscillation(self) -> float:
        """The shortest period of the lightly damped oscillations [s]; inf where there is none."""
        swings = self.rates.imag[(self.rates.imag > 0) & (self.rates.real.abs() < LIGHT * self.rates.abs())]
        return 2 * math.pi / float(swings.max()) if len(swings) else math.inf

    @property
    def time_constant(self) -> float:
        """The shortest time constant [s]; inf where there is none."""
        fastest = float(self.rates.abs().max()) if len(self.rates) else 0.0
        return 1 / fastest if fastest else math.inf

    @property
    def doubling(self) -> float:
        """The shortest time in which a deviation doubles that nothing controls [s]; inf where none grows."""
        grows = self.rates.real[self.rates.real > 0]
        return math.log(2) / float(grows.max()) if len(grows) else math.inf
