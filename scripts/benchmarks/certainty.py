"""Whether the standard errors that a fit tells are those by which its coefficients scatter from log to log.

The functions of each plant are given, so that nothing but their coefficients differs. Every log has inputs, noise and
pushes of its own. An oscillator is pushed at random, or has friction and a spring that its library lacks: what its
model leaves over then lasts, and the textbook's covariance, for which every sample is a witness, is beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from benchmarks.textbook import CASES
from dynasindy.data.simulated import disturb, record_all
from dynasindy.excitation import HeldRandom
from dynasindy.safe_io import Row
from dynasindy.sindy.library import Library, variable
from dynasindy.sindy.shooting import Descent, Flow, linearise_windows, shooting_covariance
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions

LOGS = 2
"""Logs of each plant, for each seed that is asked for."""
DT, SECONDS, LASTS = 0.02, 20.0, 0.3
"""Sampling time, length of a log, and time constant of the pushes on the oscillator [s]."""
Logs = tuple[Library, Tensor, list[Transitions]]
"""Candidate functions, a first guess of the coefficients, zero where they are not fitted, and recordings."""


class Oscillator(System):
    """A mass on a spring, pushed: x' = v, v' = -4 x - 0.8 v + 3 u + d, and forces that no linear library has.

    Args:
        friction: dry friction [m/s^2].
        cubic: stiffening of the spring [1/(m^2 s^2)].
    """

    def __init__(self, friction: float = 0.0, cubic: float = 0.0) -> None:
        super().__init__(Signature(("x", "v"), ("m", "m/s"), ("u", "d"), (1.0, 2.0)))
        self.friction, self.cubic = friction, cubic

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`, of states `(*batch, 2)` under input and push `(*batch, 2)`."""
        place, rate = x.unbind(-1)
        lacking = self.friction * torch.tanh(8 * rate) + self.cubic * place**3
        return torch.stack((rate, -4 * place - 0.8 * rate + 3 * u[..., 0] + u[..., 1] - lacking), -1)


def oscillators(plant: Oscillator, push: float, logs: int) -> Logs:
    """Record an oscillator whose library is linear, with noise of 1 %.

    Args:
        plant: what moves.
        push: standard deviation of the random pushes [m/s^2].
        logs: number of recordings.
    """
    generator, n, part = torch.Generator().manual_seed(0), round(SECONDS / DT), math.exp(-DT / LASTS)
    pushes = [torch.zeros(logs, dtype=torch.float64)]
    for _ in range(n):
        new = torch.randn(logs, generator=generator, dtype=torch.float64)
        pushes.append(part * pushes[-1] + push * math.sqrt(1 - part**2) * new)
    signals = [
        HeldRandom(1, SECONDS, DT, hold=0.5, amplitude=1.0, seed=k).samples(DT)[:n].double() for k in range(logs)
    ]
    u = torch.stack([torch.cat([s, d.unsqueeze(-1)], -1) for s, d in zip(signals, torch.stack(pushes[1:], 1))])
    data = [replace(one, u=one.u[:, :1]) for one in record_all(plant, u, DT)]
    signature = replace(plant.signature, input_names=("u",))
    library = Library(signature, [variable("x"), variable("v"), variable("u")])
    guess = torch.tensor([[0.0, -4.0], [1.0, -0.8], [0.0, 3.0]], dtype=torch.float64)
    return library, guess, [disturb(one, 0.01, 1000 + k) for k, one in enumerate(data)]


def van_der_pol(logs: int) -> Logs:
    """Record van der Pol's oscillator with white noise of 10 %."""
    case = CASES["van_der_pol"]
    return case.library(), case.truth(), [disturb(one, 0.1, 1000 + k) for k, one in enumerate(case.clean(logs))]


def measure(seeds: int, xi: Callable[[int], Logs]) -> list[Row]:
    """Return rows of standard errors by the scatter over logs.

    Args:
        seeds: half the number of logs of each plant.
        xi: records the plant `xi`.
    """
    logs = LOGS * seeds
    cases: list[tuple[str, Logs, bool]] = [
        ("xi, white noise of 1e-3", xi(logs), True),
        ("van der Pol, white noise of 10 %", van_der_pol(logs), True),
        ("oscillator, random pushes", pushed := oscillators(Oscillator(), 0.6, logs), True),
        ("oscillator, random pushes", pushed, False),
        (
            "oscillator, friction and spring not in the library",
            lacking := oscillators(Oscillator(0.6, 3.0), 0.0, logs),
            True,
        ),
        ("oscillator, friction and spring not in the library", lacking, False),
    ]
    rows: list[Row] = []
    for name, given, joined in cases:
        told, textbook = ratios(*given, joined)
        what = f"{name}, {'simulation' if joined else 'prediction'}: standard error / scatter over {logs} logs"
        for method, found, target in (("ours", told, "0.5 to 2"), ("textbook", textbook, "")):
            value = f"{float(found.min()):.2g} to {float(found.max()):.2g}"
            rows.append({"method": method, "measure": f"{what}, {len(found)} terms", "value": value, "target": target})
    return rows


def ratios(library: Library, guess: Tensor, logs: list[Transitions], joined: bool) -> tuple[Tensor, Tensor]:
    """Return standard errors by the scatter of coefficients over logs: those of a fit, and those of the textbook.

    Args:
        library: candidate functions.
        guess: where fits begin, `(n_features, n_x)`; the rate of a place, if it is that, stays.
        logs: recordings.
        joined: whether whole trajectories are fitted, or windows on their own.
    """
    free = (guess != 0) & ~((guess == 1) & (guess != 0).sum(0).eq(1))
    fits, told, textbook = [], [], []
    for data in logs:
        flow = refine_trajectory(library, guess, free, data, Descent(20, joined)).flow
        known = shooting_covariance(flow)
        assert known is not None, "a model runs away"
        fits.append(flow.estimate.xi[known.features, known.states])
        told.append(known.errors)
        textbook.append(_textbook(flow))
    scatter = torch.stack(fits).std(0)
    ours, theirs = (torch.stack(each).square().mean(0).sqrt() / scatter for each in (told, textbook))
    return ours, theirs


def _textbook(flow: Flow) -> Tensor:
    """Return the standard errors that follow where every error is a witness of its own, `(P,)`."""
    model = linearise_windows(flow)
    inverse = torch.linalg.pinv(model.triangle[: len(model.scale), : len(model.scale)])
    return (inverse.square().sum(-1).sqrt() / model.scale)[len(model.scale) - len(flow.parameters) :]
