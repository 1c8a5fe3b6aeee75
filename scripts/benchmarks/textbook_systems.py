"""Two textbook systems with an input in one equation: what identification from noisy states is measured on."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.pysindy_regression import Score, best_threshold, score, smoothed_rows, stlsq, weak_rows
from dynasindy.data.rollout_data import disturb, record_plants
from dynasindy.excitation import Aprbs
from dynasindy.safe_io import Row
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.library import Library
from dynasindy.sindy.named_libraries import polynomial
from dynasindy.sindy.regression import Rows
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import Estimate, Flow, Windows, linearise_windows
from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions


def cramer_rao(library: Library, truth: Tensor, clean: Transitions, sigma: Tensor) -> Tensor:
    """Return the smallest standard error of each true term, the start state unknown, `(P,)`.

    Args:
        library: candidate functions.
        truth: the true coefficients, `(n_features, n_x)`.
        clean: the recording without noise.
        sigma: standard deviation of the white noise of each state, `(n_x,)`.
    """
    windows, parameters = Windows.of(clean, 50), Parameters.where(truth != 0)
    model = linearise_windows(Flow.of(Estimate(library, truth, windows.first.clone()), parameters, windows), sigma)
    n = len(model.scale)
    inverse = torch.linalg.inv(model.triangle[:n, :n])
    return (inverse.square().sum(-1).sqrt() / model.scale)[n - len(parameters) :]


LEVELS = (0.01, 0.05, 0.1, 0.2)
"""Standard deviation of the noise, relative to that of each state."""
SMOOTHED = (0, 9, 17, 35)
"""Samples that PySINDy's states and derivatives are smoothed over; 0 takes them as measured."""


class VanDerPol(System):
    """The oscillator of van der Pol, which comes to a limit cycle: x' = y, y' = mu (1 - x^2) y - x + gain u.

    Args:
        mu: strength of the damping [1/s].
        gain: what a full input adds to y' [1/s^2].
    """

    def __init__(self, mu: float = 1.0, gain: float = 3.0) -> None:
        super().__init__(Signature(("x", "y"), ("-", "1/s"), ("u",), (2.0, 3.0)))
        self.mu, self.gain = mu, gain

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`, of states `(*batch, 2)` under inputs `(*batch, 1)`."""
        place, rate = x.unbind(-1)
        return torch.stack((rate, self.mu * (1 - place.square()) * rate - place + self.gain * u[..., 0]), -1)


class Lorenz(System):
    """The chaotic system of Lorenz: x' = sigma (y - x) + gain u, y' = x (rho - z) - y, z' = x y - beta z.

    Args:
        sigma: rate of x [1/s].
        rho: height of the fixed points plus one.
        beta: decay of z [1/s].
        gain: what a full input adds to x' [1/s].
    """

    def __init__(self, sigma: float = 10.0, rho: float = 28.0, beta: float = 8 / 3, gain: float = 50.0) -> None:
        super().__init__(Signature(("x", "y", "z"), ("-", "-", "-"), ("u",), (20.0, 25.0, 40.0)))
        self.sigma, self.rho, self.beta, self.gain = sigma, rho, beta, gain

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 3)`, of states `(*batch, 3)` under inputs `(*batch, 1)`."""
        a, b, c = x.unbind(-1)
        first = self.sigma * (b - a) + self.gain * u[..., 0]
        return torch.stack((first, a * (self.rho - c) - b, a * b - self.beta * c), -1)


@dataclass(frozen=True)
class Case:
    """Describe one experiment: all states measured, the input random and held, a full polynomial library.

    Attributes:
        plant: what moves.
        start: its start state.
        seconds: length [s].
        dt: sampling time [s].
        hold: time for which a level of the input is held [s].
        degree: of the library's monomials of states and input.
        levels: of the noise.
    """

    plant: System
    start: tuple[float, ...]
    seconds: float
    dt: float
    hold: float
    degree: int = 3
    levels: Sequence[float] = LEVELS

    def library(self) -> Library:
        """Build the candidate functions."""
        return polynomial(self.plant.signature, self.degree)

    def clean(self, seeds: int) -> list[Transitions]:
        """Record the plant without noise, once for each seed."""
        signals = [Aprbs(1, self.seconds, self.dt, hold=self.hold, amplitude=1.0, seed=k) for k in range(seeds)]
        u = torch.stack([signal.samples(self.dt) for signal in signals])
        return record_plants(self.plant, u, self.dt, round(self.dt / 0.001), torch.tensor(self.start))

    def truth(self) -> Tensor:
        """Return the plant's coefficients in the library, `(n_features, n_x)`, read off its rates."""
        generator, library = torch.Generator().manual_seed(0), self.library()
        x = torch.randn(1000, self.plant.signature.n_x, generator=generator, dtype=torch.float64)
        u = torch.randn(1000, 1, generator=generator, dtype=torch.float64)
        found: Tensor = torch.linalg.lstsq(library(x, u), self.plant(x, u)).solution
        return torch.where(found.abs() > 1e-8, found, 0.0)


CASES = {
    "van_der_pol": Case(VanDerPol(), (0.0, 0.0), 20.0, 0.02, 0.5),
    "lorenz": Case(Lorenz(), (-8.0, 7.0, 27.0), 10.0, 0.01, 0.2),
}
"""The experiments, by name."""


def measure(case: Case, seeds: int) -> list[Row]:
    """Identify a textbook system at each level of noise, by ours and by PySINDy's regression on rows of three kinds."""
    library, truth = case.library(), case.truth()
    recordings, rows = case.clean(seeds), []
    for level in case.levels:
        data = [disturb(clean, level, 1000 + seed) for seed, clean in enumerate(recordings)]
        where = f"noise {100 * level:g} %"
        rows += _ours(library, truth, level, recordings, data, where)
        rows += _theirs(library, truth, data, where)
    return rows


def _ours(
    library: Library, truth: Tensor, level: float, recordings: list[Transitions], data: list[Transitions], where: str
) -> list[Row]:
    parameters, scores, ratios, seconds = Parameters.where(truth != 0), [], [], []
    for clean, noisy in zip(recordings, data, strict=True):
        model = SindyModel(library.signature, library, Regression("bic"), Refinement("auto"))
        start = time.process_time()
        model.fit(noisy)
        seconds.append(time.process_time() - start)
        scores.append(score(model.coefficients, truth))
        bound = cramer_rao(library, truth, clean, level * clean.x_next.std(0))
        ratio = parameters.read(model.coefficients - truth) / bound
        ratios.append(float(ratio.square().mean().sqrt()))
    exact = _exact(scores, truth)
    return [
        _row(
            "ours",
            f"{where}: seeds with all terms and 0 false",
            f"{exact} of {len(data)}",
            "all" if level < 0.02 else "",
        ),
        _row(
            "ours",
            f"{where}: rms error / Cramer-Rao bound, median and worst seed",
            f"{statistics.median(ratios):.2f}, {max(ratios):.2f}",
            "<= 2",
        ),
        _row("ours", f"{where}: worst relative coefficient error, worst seed", f"{max(s[2] for s in scores):.2g}"),
        _row("ours", f"{where}: fit [s], median", f"{statistics.median(seconds):.2g}"),
    ]


def _theirs(library: Library, truth: Tensor, data: list[Transitions], where: str) -> list[Row]:
    """Fit PySINDy as it comes, and at the best smoothing, threshold and scaling of a grid, chosen by the truth."""
    import pysindy

    own = {n: [smoothed_rows(library, d, n) for d in data] for n in SMOOTHED}
    rows = [
        _score_row("PySINDy defaults", where, [score(stlsq(pair, pysindy.STLSQ()), truth) for pair in own[0]], truth)
    ]
    kinds: dict[str, list[Rows]] = {f"smoothed over {n}": pairs for n, pairs in own.items()}
    for label, chosen in (("best", kinds), ("our weak form, best", {"weak": [weak_rows(library, d) for d in data]})):
        tried = [best_threshold(k, pairs, truth, how) for k, pairs in chosen.items() for how in (None, False, True)]
        _, words, scores = max(tried, key=lambda one: one[0])
        rows.append(_score_row(f"PySINDy, {label}: {words}", where, scores, truth))
    return rows


def _score_row(method: str, where: str, scores: list[Score], truth: Tensor) -> Row:
    true, false = (statistics.median(s[k] for s in scores) for k in range(2))
    worst = statistics.median(s[2] for s in scores)
    value = f"{_exact(scores, truth)} of {len(scores)}; {true:g}, {false:g}, {worst:.2g}"
    return _row(
        method, f"{where}: seeds with all terms and 0 false; true, false terms, worst error, median seed", value
    )


def _exact(scores: list[Score], truth: Tensor) -> int:
    return sum(s[:2] == (int((truth != 0).sum()), 0) for s in scores)


def _row(method: str, what: str, value: str, target: str = "") -> Row:
    return {"method": method, "measure": what, "value": value, "target": target}
