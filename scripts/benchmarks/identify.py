"""What identification reaches: terms found, errors of coefficients and predictions, and time, beside PySINDy's.

Plants move by Runge-Kutta steps of 1 ms between the samples. Times are CPU time of the process, one thread; medians.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import torch
import yaml
from torch import Tensor

from benchmarks.common import RESULTS, EquationSystem, commit
from benchmarks.pysindy_regression import Score, best_threshold, score, smoothed_rows, stlsq, weak_rows
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Aprbs, Chirp, Excitation
from dynasindy.safe_io import Row, read_rows
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.library import Library
from dynasindy.sindy.named_libraries import paper_table, polynomial
from dynasindy.sindy.regression import Rows
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import Descent, Estimate, Flow, Windows, linearise_windows
from dynasindy.sindy.world_model import one_step_error
from dynasindy.systems import Signature, System, Tras, Xi, integrate
from dynasindy.systems.transitions import Transitions
from dynasindy.systems.trms33 import Trms33

KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}
HOVER = (-0.12, 0.21)
SEEDS = 10
"""Seeds at least before the published figures are replaced."""
RATIO = "error / Cramer-Rao bound"
COLUMNS = ("case", "method", "measure", "value", "target", "commit")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--only", nargs="*", choices=list(CASES), help="names of cases; all by default")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="seeds of each case")
    parser.add_argument("--out", type=Path, help=f"CSV file to write; the published one from {SEEDS} seeds on")


def main(arguments: argparse.Namespace) -> None:
    """Measure, print a table and write it as CSV."""
    torch.set_num_threads(1)
    out = arguments.out or (RESULTS / "identification.csv" if arguments.seeds >= SEEDS else None)
    print(f"writes {out or 'no file, as too few seeds are measured to replace the published one: give --out'}")
    rows, names = [], arguments.only or list(CASES)
    for name in names:
        for found in CASES[name](arguments.seeds):
            rows.append({"case": name, **found, "commit": commit()})
            print("  ".join(f"{rows[-1][column]:<14}" for column in COLUMNS[:-1]), flush=True)
    if out is not None:
        kept = [found for found in read_rows(out) if found["case"] not in names]
        order = {name: k for k, name in enumerate(CASES)}
        with out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(sorted([*kept, *rows], key=lambda one: order.get(one["case"], len(order))))


def row(method: str, measure: str, value: str, target: str = "") -> Row:
    """Return a row of the table of identification."""
    return {"method": method, "measure": measure, "value": value, "target": target}


def true_table() -> Tensor:
    """Return the published coefficients in the paper's library, `(27, 6)`, read off the plant."""
    model = SindyModel(Xi().signature, "paper_table", Regression(threshold=0.9))
    generator = torch.Generator().manual_seed(0)
    x = 2 * torch.rand(2000, 6, generator=generator, dtype=torch.float64) - 1
    x[:, 4:] *= 3000
    u = 2 * torch.rand(2000, 2, generator=generator, dtype=torch.float64) - 1
    model.fit_derivatives(x, u, Xi()(x, u))
    return model.coefficients


def xi_recordings(seconds: float, dt: float, seeds: Iterable[int]) -> list[Transitions]:
    """Record the plant `xi` under random steps held for 0.5 s, around hover, for several seeds."""
    signals = [Aprbs(2, duration=seconds, amplitude=(0.6, 0.45), offset=HOVER, seed=seed) for seed in seeds]
    return [record_plant(Xi(), signal.samples(dt), dt, round(dt / 0.001)) for signal in signals]


def noise_free(seconds: float, dt: float, goal: float, seeds: int) -> list[Row]:
    """Identify `xi` without noise, all rows unknown."""
    truth, scores, seconds_each = true_table(), [], []
    for seed in range(seeds):
        (data,) = xi_recordings(seconds, dt, [seed])
        model = SindyModel(Xi().signature, "paper_table", Regression("bic"), Refinement("one_step"))
        start = time.process_time()
        model.fit(data)
        seconds_each.append(time.process_time() - start)
        scores.append(score(model.coefficients, truth))
    exact = sum(s[:2] == (19, 0) for s in scores)
    return [
        row("ours", "seeds with 19 of 19 terms and 0 false", f"{exact} of {seeds}", "all"),
        row("ours", "worst relative coefficient error, worst seed", f"{max(s[2] for s in scores):.2g}", f"<= {goal:g}"),
        row("ours", "refined fit [s], median", f"{median(seconds_each):.3g}", "<= 1" if dt < 0.05 else ""),
    ]


def noisy(seeds: int) -> list[Row]:
    """Identify `xi` from 100 s with noise of 1e-3 of each state's standard deviation."""
    truth, scores, ratios, worst = true_table(), [], [], []
    parameters = Parameters.where(truth != 0)
    for seed, clean in enumerate(xi_recordings(100.0, 0.01, range(seeds))):
        sigma = 1e-3 * clean.x_next.std(0)
        data = clean.disturbed(1e-3, 1000 + seed)
        model = SindyModel(Xi().signature, "paper_table", Regression("bic"), Refinement("auto"))
        model.fit(data)
        scores.append(score(model.coefficients, truth))
        bound = cramer_rao(paper_table(Xi().signature), truth, clean, sigma)
        z = parameters.read(model.coefficients - truth).abs() / bound
        ratios.append(float(z.square().mean().sqrt()))
        worst.append(float(z.max()))
    good = sum(t >= 18 and f <= 1 for t, f, _ in scores)
    exact = sum((t, f) == (19, 0) for t, f, _ in scores)
    return [
        row("ours", "seeds with >= 18 terms and <= 1 false", f"{good} of {seeds}", ">= 8 of 10"),
        row("ours", "seeds with 19 of 19 terms and 0 false", f"{exact} of {seeds}"),
        row("ours", f"largest {RATIO}, median and worst seed", f"{median(worst):.2f}, {max(worst):.2f}", "<= 3"),
        row("ours", f"rms {RATIO}, median over seeds", f"{median(ratios):.2f}", "1 is the bound"),
    ]


def episodes(plant: System, n: int = 32) -> tuple[Tensor, Tensor]:
    """Record 400 unseen periods of 0.05 s from rest; episodes that touch a stop are dropped.

    `tras` tracks random steps under a PD controller; `trms33`, which that would not hold, gets random held inputs.

    Returns:
        States `(n, 401, 6)` and inputs `(n, 400, 2)`.
    """
    generator = torch.Generator().manual_seed(7)
    x = torch.zeros(n, 6, dtype=torch.float64)
    states, inputs, stopped = [x], [], torch.zeros(n, dtype=torch.bool)
    for k in range(400):
        if k % (100 if isinstance(plant, Tras) else 20) == 0:
            drawn = 2 * torch.rand(n, 2, generator=generator, dtype=torch.float64) - 1
        if isinstance(plant, Tras):
            error = drawn * torch.tensor([0.5, 0.3]) - x[:, :2]
            u = torch.tensor([-0.11, 0.3]) + error * torch.tensor([0.6, 0.3]) - x[:, 2:4] * torch.tensor([0.6, 0.15])
        else:
            u = torch.tensor([0.22, 0.56]) + drawn * torch.tensor([0.12, 0.08])
        u = u.clamp(-1, 1)
        with torch.no_grad():
            samples, touched = integrate(plant, x, u, 0.05, 50, plant.stops)
        x, stopped = samples[:, -1], stopped | touched
        states.append(x)
        inputs.append(u)
    return torch.stack(states, 1)[~stopped], torch.stack(inputs, 1)[~stopped]


def rig(plant: System, library: str, excitation: Excitation, goal: str) -> list[Row]:
    """Identify a first-principles plant from 20 s and predict unseen episodes open loop."""
    data = record_plant(plant, excitation.samples(0.01), 0.01, 10)
    model = SindyModel(plant.signature, library, Regression("bic", tolerance=1e-4), Refinement(), known=KNOWN)
    model.fit(data)
    states, inputs = episodes(plant)
    with torch.no_grad():
        missed = (model.simulate(states[:, 0], inputs, 0.05, 5) - states)[:, 1:].square().mean(1).sqrt()
    errors = (missed / states[:, 1:].std((0, 1))).nan_to_num(math.inf, math.inf)  # NRMSE of 400 steps open loop
    flat = (states[:, :-1].reshape(-1, 6), inputs.reshape(-1, 2), states[:, 1:].reshape(-1, 6))
    one = one_step_error(model, Transitions(*flat, 0.05, torch.arange(len(flat[0]))), 5)
    names = plant.signature.state_names
    whole = errors.square().mean(0).sqrt()
    per_state = ", ".join(f"{n} {100 * e:.2g}" for n, e in zip(names, whole.tolist(), strict=True))
    each = ", ".join(f"{n} {100 * e:.1g}" for n, e in zip(names, one.tolist(), strict=True))
    what = f"{len(states)} episodes, 400 steps open loop, NRMSE [%]"
    method = f"ours, {library}"
    return [
        row(method, f"{what}, worst state", f"{100 * float(whole.max()):.2g}", goal),
        row(method, what, per_state),
        row(method, "one-step error of 0.05 s [% of deviation]", each),
    ]


def tras(_: int) -> list[Row]:
    """Identify `tras` from 20 s."""
    return rig(Tras(), "rotor", Chirp(2, duration=20.0, amplitude=(0.4, 0.2), offset=(-0.11, 0.25)), "<= 2")


def trms33(_: int) -> list[Row]:
    """Identify `trms33` from 20 s; its Coulomb friction and the products of its inertias are in no library."""
    excitation = Aprbs(2, duration=20.0, amplitude=(0.3, 0.15), offset=(0.22, 0.56))
    rows = rig(Trms33(), "rotor_reaction", excitation, "best honest figure")
    return [*rows, rig(Trms33(), "rotor", excitation, "")[0]]


def cramer_rao(library: Library, truth: Tensor, clean: Transitions, sigma: Tensor) -> Tensor:
    """Return the smallest standard error of each true term, the start state unknown, `(P,)`.

    Args:
        library: candidate functions.
        truth: the true coefficients, `(n_features, n_x)`.
        clean: the recording without noise.
        sigma: standard deviation of the white noise of each state, `(n_x,)`.
    """
    windows, parameters = Windows.of(clean, Descent(50)), Parameters.where(truth != 0)
    model = linearise_windows(Flow.of(Estimate(library, truth, windows.first.clone()), parameters, windows), sigma)
    n = len(model.scale)
    inverse = torch.linalg.inv(model.triangle[:n, :n])
    return (inverse.square().sum(-1).sqrt() / model.scale)[n - len(parameters) :]


LEVELS = (0.01, 0.05, 0.1, 0.2)
"""Standard deviation of the noise, relative to that of each state."""
SMOOTHED = (0, 9, 17, 35)
"""Samples that PySINDy's states and derivatives are smoothed over; 0 takes them as measured."""


@dataclass(frozen=True)
class Experiment:
    """A textbook system: all states measured, the input random and held, a full polynomial library.

    Attributes:
        states: Name to unit.
        scale: Ranges of the states.
        rates: Formula of the rate of change of each state.
        start: Start state.
        seconds: Length [s].
        dt: Sampling time [s].
        hold: Time for which a level of the input is held [s].
    """

    states: Mapping[str, str]
    scale: Sequence[float]
    rates: Mapping[str, str]
    start: Sequence[float]
    seconds: float
    dt: float
    hold: float

    @property
    def plant(self) -> EquationSystem:
        """What moves."""
        names, units = tuple(self.states), tuple(self.states.values())
        return EquationSystem(Signature(names, units, ("u",), tuple(self.scale)), {}, self.rates)

    def library(self) -> Library:
        """Build the candidate functions."""
        return polynomial(self.plant.signature, 3)

    def clean(self, seeds: int) -> list[Transitions]:
        """Record the plant without noise, once for each seed."""
        signals = [
            Aprbs(1, duration=self.seconds, dt=self.dt, hold=self.hold, amplitude=1.0, seed=k) for k in range(seeds)
        ]
        steps, start = round(self.dt / 0.001), torch.tensor(self.start)
        return [record_plant(self.plant, signal.samples(self.dt), self.dt, steps, start) for signal in signals]

    def truth(self) -> Tensor:
        """Return the plant's coefficients in the library, `(n_features, n_x)`, read off its rates."""
        generator, library = torch.Generator().manual_seed(0), self.library()
        x = torch.randn(1000, len(self.states), generator=generator, dtype=torch.float64)
        u = torch.randn(1000, 1, generator=generator, dtype=torch.float64)
        found: Tensor = torch.linalg.lstsq(library(x, u), self.plant(x, u)).solution
        return torch.where(found.abs() > 1e-8, found, 0.0)


TEXTBOOK = {
    name: Experiment(**facts)
    for name, facts in yaml.safe_load(Path(__file__).with_name("textbook_systems.yaml").read_text()).items()
}
"""The textbook systems, by name."""


def textbook(case: Experiment, seeds: int) -> list[Row]:
    """Identify a textbook system at each level of noise, by ours and by PySINDy's regression on rows of three kinds."""
    library, truth = case.library(), case.truth()
    recordings, rows = case.clean(seeds), []
    for level in LEVELS:
        data = [clean.disturbed(level, 1000 + seed) for seed, clean in enumerate(recordings)]
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
    worst = max(found[2] for found in scores)
    bounds, goal = f"{median(ratios):.2f}, {max(ratios):.2f}", "all" if level < 0.02 else ""
    return [
        row("ours", f"{where}: seeds with all terms and 0 false", f"{_exact(scores, truth)} of {len(data)}", goal),
        row("ours", f"{where}: rms error / Cramer-Rao bound, median and worst seed", bounds, "<= 2"),
        row("ours", f"{where}: worst relative coefficient error, worst seed", f"{worst:.2g}"),
        row("ours", f"{where}: fit [s], median", f"{median(seconds):.2g}"),
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
    true, false, worst = (median(found[k] for found in scores) for k in range(3))
    value = f"{_exact(scores, truth)} of {len(scores)}; {true:g}, {false:g}, {worst:.2g}"
    what = "seeds with all terms and 0 false; true, false terms, worst error, median seed"
    return row(method, f"{where}: {what}", value)


def _exact(scores: list[Score], truth: Tensor) -> int:
    return sum(found[:2] == (int((truth != 0).sum()), 0) for found in scores)


CASES: dict[str, Callable[[int], list[Row]]] = {
    "xi_10s": lambda seeds: noise_free(10.0, 0.01, 1e-6, seeds),
    "xi_control": lambda seeds: noise_free(20.0, 0.05, 1e-4, seeds),
    "xi_noise": noisy,
    **{name: partial(textbook, case) for name, case in TEXTBOOK.items()},
    "tras": tras,
    "trms33": trms33,
}
"""The cases of the table, by name."""
