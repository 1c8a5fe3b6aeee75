"""What identification reaches: terms found, errors of coefficients and predictions, and time, beside PySINDy's.

Plants move by Runge-Kutta steps of 1 ms between the samples. Times are CPU time of the process, one thread; medians.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks import textbook_systems
from benchmarks.common import add_written, commit
from benchmarks.pysindy_regression import (
    Score,
    best_threshold,
    integral_rows,
    own_rows,
    score,
    stlsq,
)
from benchmarks.textbook_systems import cramer_rao
from dynasindy.data.rollout_data import disturb, record_plant, record_plants
from dynasindy.excitation import Aprbs, Chirp, Excitation
from dynasindy.safe_io import Row, read_rows, write_rows
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import paper_table
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.world_model import one_step_error
from dynasindy.systems import System, Tras, Xi, integrate
from dynasindy.systems.transitions import Transitions
from dynasindy.systems.trms33 import Trms33

KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}
HOVER = (-0.12, 0.21)
SEEDS = 10
"""Seeds at least before the published figures are replaced."""
RESULTS = Path("docs/results/identification.csv")
COLUMNS = ("case", "method", "measure", "value", "target", "commit")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--seeds", type=int, default=SEEDS, help="seeds of each case with seeds")
    parser.add_argument("--only", nargs="*", choices=list(CASES), help="names of cases; all by default")
    add_written(parser, RESULTS, SEEDS, "seeds")


def main(arguments: argparse.Namespace) -> None:
    """Measure, print a table and write it as CSV."""
    # A quick look must not replace the published figures.
    out = RESULTS if arguments.out is None and arguments.seeds >= SEEDS else arguments.out
    torch.set_num_threads(1)
    rows: list[Row] = []
    for name in arguments.only or CASES:
        for row in CASES[name](arguments.seeds):
            rows.append({"case": name, **row, "commit": commit()})
            print(f"{name:<14}{row['method']:<26}{row['measure']:<58}{row['value']:<40}{row['target']}", flush=True)
    if out is None:
        print(f"written to no file: fewer than {SEEDS} seeds; name one by --out")
        return
    _write(rows, out, replace=arguments.only is None)
    print(f"written to {out}")


def _write(rows: list[Row], path: Path, replace: bool) -> None:
    """Write the rows; those of other cases that stand in the file stay unless all cases were measured."""
    fresh = {row["case"] for row in rows}
    kept = [] if replace else [row for row in read_rows(path) if row["case"] not in fresh]
    order = {name: k for k, name in enumerate(CASES)}
    ordered = sorted([*kept, *rows], key=lambda row: order.get(row["case"], len(order)))
    write_rows(path, COLUMNS, ordered)


def row(method: str, measure: str, value: str, target: str = "") -> Row:
    """Return one row of the table."""
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


def xi_recording(seconds: float, dt: float, seed: int) -> Transitions:
    """Record the plant `xi` under random steps held for 0.5 s, around hover."""
    return xi_recordings(seconds, dt, [seed])[0]


def xi_recordings(seconds: float, dt: float, seeds: Iterable[int]) -> list[Transitions]:
    """Record it for several seeds side by side."""
    signals = [Aprbs(2, seconds, amplitude=(0.6, 0.45), offset=HOVER, seed=seed) for seed in seeds]
    return record_plants(Xi(), torch.stack([signal.samples(dt) for signal in signals]), dt, round(dt / 0.001))


def noise_free(seconds: float, dt: float, goal: float, seeds: int) -> list[Row]:
    """Identify `xi` without noise, all rows unknown."""
    truth, scores, seconds_each = true_table(), [], []
    for seed in range(seeds):
        data = xi_recording(seconds, dt, seed)
        model = SindyModel(Xi().signature, "paper_table", Regression("bic"), Refinement("one_step"))
        start = time.process_time()
        model.fit(data)
        seconds_each.append(time.process_time() - start)
        scores.append(score(model.coefficients, truth))
    exact = sum(s[:2] == (19, 0) for s in scores)
    return [
        row("ours", "seeds with 19 of 19 terms and 0 false", f"{exact} of {seeds}", "all"),
        row("ours", "worst relative coefficient error, worst seed", f"{max(s[2] for s in scores):.2g}", f"<= {goal:g}"),
        row("ours", "refined fit [s], median", f"{statistics.median(seconds_each):.3g}", "<= 1" if dt < 0.05 else ""),
    ]


def noisy(seeds: int) -> list[Row]:
    """Identify `xi` from 100 s with noise of 1e-3 of each state's standard deviation."""
    truth, scores, ratios, worst = true_table(), [], [], []
    parameters = Parameters.where(truth != 0)
    for seed, clean in enumerate(xi_recordings(100.0, 0.01, range(seeds))):
        sigma = 1e-3 * clean.x_next.std(0)
        data = disturb(clean, 1e-3, 1000 + seed)
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
        row(
            "ours",
            "largest error / Cramer-Rao bound, median and worst seed",
            f"{statistics.median(worst):.2f}, {max(worst):.2f}",
            "<= 3",
        ),
        row(
            "ours",
            "rms error / Cramer-Rao bound, median over seeds",
            f"{statistics.median(ratios):.2f}",
            "1 is the bound",
        ),
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


def open_loop_errors(model: SindyModel, states: Tensor, inputs: Tensor) -> Tensor:
    """Return the NRMSE of 400-step open-loop predictions, `(episodes, n_x)`."""
    with torch.no_grad():
        predicted = model.simulate(states[:, 0], inputs, 0.05, 5)
    error = (predicted - states)[:, 1:].square().mean(1).sqrt() / states[:, 1:].std((0, 1))
    return error.nan_to_num(math.inf, math.inf)


def rig(plant: System, library: str, excitation: Excitation, goal: str) -> list[Row]:
    """Identify a first-principles plant from 20 s and predict unseen episodes open loop."""
    data = record_plant(plant, excitation.samples(0.01), 0.01, 10)
    model = SindyModel(plant.signature, library, Regression("bic", tolerance=1e-4), Refinement(), known=KNOWN)
    model.fit(data)
    states, inputs = episodes(plant)
    errors = open_loop_errors(model, states, inputs)
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


def tras(seeds: int) -> list[Row]:
    """Identify `tras` from 20 s."""
    return rig(Tras(), "rotor", Chirp(2, 20.0, amplitude=(0.4, 0.2), offset=(-0.11, 0.25)), "<= 2")


def trms33(seeds: int) -> list[Row]:
    """Identify `trms33` from 20 s; its Coulomb friction and the products of its inertias are in no library."""
    excitation = Aprbs(2, 20.0, amplitude=(0.3, 0.15), offset=(0.22, 0.56))
    rows = rig(Trms33(), "rotor_reaction", excitation, "best honest figure")
    return [*rows, rig(Trms33(), "rotor", excitation, "")[0]]


def pysindy_rows(seeds: int) -> list[Row]:
    """Fit PySINDy to the same data of `xi` with the same 27 functions: defaults, and the best thresholds of a grid.

    Given rows are averages over the sampling intervals, as ours, from which its optimiser learns without derivatives
    of its own; scaled rates are those of each state divided by their 2-norm, so that one threshold suits all states.
    """
    import pysindy

    truth, library, rows = true_table(), paper_table(Xi().signature), []
    for label, seconds, dt in (("10 s at 0.01 s", 10.0, 0.01), ("20 s at 0.05 s", 20.0, 0.05)):
        data = [xi_recording(seconds, dt, seed) for seed in range(seeds)]
        own = {order: [own_rows(library, d, pysindy.FiniteDifference(order)) for d in data] for order in (2, 4)}
        given = [integral_rows(library, d) for d in data]
        default = [score(stlsq(pair, pysindy.STLSQ()), truth) for pair in own[2]]
        rows.append(_pysindy_row("PySINDy defaults", label, default))
        best = max((best_threshold(f"order {k}", pairs, truth) for k, pairs in own.items()), key=lambda one: one[0])
        rows.append(_pysindy_row(f"PySINDy best: {best[1]}", label, best[2]))
        for words, scaled in (("", False), (" and scaled rates", True)):
            _, name, scores = best_threshold("fourth order", given, truth, scaled)
            method = f"PySINDy, our integral form{words}, best: {name}"
            exact = sum(found[:2] == (19, 0) for found in scores)
            rows.append(_pysindy_row(method, label, scores))
            rows.append(row(method, f"xi, {label}: seeds with 19 of 19 terms and 0 false", f"{exact} of {seeds}"))
    return rows


def _pysindy_row(method: str, label: str, scores: list[Score]) -> Row:
    true, false, worst = (statistics.median(s[k] for s in scores) for k in range(3))
    return row(method, f"xi, {label}: true, false terms, worst error, median seed", f"{true:g}, {false:g}, {worst:.2g}")


def refit(seeds: int) -> list[Row]:
    """Refit after 20 s of new data on top of 1e6 and 1e7 stored samples."""
    import pysindy

    plant, library = Xi(), paper_table(Xi().signature)
    model, rows = SindyModel(plant.signature, library, Regression(normalize="rms")), []
    generator = torch.Generator().manual_seed(0)
    new = xi_recording(20.0, 0.01, 0)
    for total in (1_000_000, 10_000_000):
        while model.sums.count < total:
            n = min(100_000, total - model.sums.count)
            x = 2 * torch.rand(n, 6, generator=generator, dtype=torch.float64) - 1
            x[:, 4:] *= 3000
            u = 2 * torch.rand(n, 2, generator=generator, dtype=torch.float64) - 1
            model.sums.add((library(x, u), plant(x, u)))
        stored = model.sums.copy()
        times = []
        for _ in range(21):
            model.sums = stored.copy()
            times.append(time_call(lambda: model.update(new)))
        goal = "<= 10" if total == 1_000_000 else "<= 2 x the row above"
        rows.append(
            row(
                "ours",
                f"refit after 2000 new samples on top of {total:.0e} [ms]",
                f"{1e3 * statistics.median(times):.2f}",
                goal,
            )
        )
    x = 2 * torch.rand(1_002_000, 6, generator=generator, dtype=torch.float64) - 1
    u = 2 * torch.rand(1_002_000, 2, generator=generator, dtype=torch.float64) - 1
    theta, dx = library(x, u).numpy(), plant(x, u).numpy()
    optimizer = pysindy.STLSQ(threshold=0.9, alpha=0, normalize_columns=True)
    seconds = time_call(lambda: optimizer.fit(theta, dx))
    rows.append(row("PySINDy STLSQ, functions given", "fit of 1e6 + 2000 samples [ms]", f"{1e3 * seconds:.0f}"))
    return rows


def speed(seeds: int) -> list[Row]:
    """Imagine transitions of 0.05 s by five Runge-Kutta steps, batch 4096, float32."""
    rows = []
    models = {"xi": _fitted(Xi(), "paper_table", (0.5, 0.35)), "tras": _fitted(Tras(), "rotor", (0.3, 0.2))}
    for name, model in models.items():
        generator = torch.Generator().manual_seed(0)
        x = (torch.rand(4096, 6, generator=generator) - 0.5) * torch.tensor(model.signature.x_scale)
        u = 2 * torch.rand(4096, 2, generator=generator) - 1
        times = [time_call(partial(_imagine, model, x, u)) for _ in range(41)][1:]
        terms = int((model.coefficients != 0).sum())
        rates = f"{4096 / statistics.median(times):.3g}, best {4096 / min(times):.3g}"
        rows.append(row("ours", f"{name} model, {terms} terms: transitions per CPU-second", rates, ">= 1e6"))
    rows.append(_pysindy_speed(models["xi"]))
    return rows


def _imagine(model: SindyModel, x: Tensor, u: Tensor) -> None:
    with torch.no_grad():
        model.predict(x, u, 0.05, 5)


def _fitted(plant: System, library: str, amplitude: tuple[float, float]) -> SindyModel:
    model = SindyModel(
        plant.signature,
        library,
        Regression("bic", tolerance=1e-4),
        Refinement("one_step" if library == "paper_table" else "integral"),
        KNOWN,
    )
    model.fit(record_plant(plant, Chirp(2, 10.0, amplitude=amplitude, offset=(-0.11, 0.25)).samples(0.01), 0.01, 2))
    return model


def _pysindy_speed(model: SindyModel) -> Row:
    from dynasindy.sindy.pysindy_interchange import to_pysindy

    theirs, t = to_pysindy(model), np.arange(0, 1.05, 0.05)
    u = np.full((len(t), 2), 0.1)
    seconds = time_call(lambda: theirs.simulate(np.zeros(6), t, u=u))
    return row("PySINDy simulate", "xi model: transitions per CPU-second", f"{(len(t) - 1) / seconds:.3g}")


def time_call(call: Callable[[], object]) -> float:
    """Return the CPU time of a call [s]."""
    start = time.process_time()
    call()
    return time.process_time() - start


CASES: dict[str, Callable[[int], list[Row]]] = {
    "xi_10s": lambda seeds: noise_free(10.0, 0.01, 1e-6, seeds),
    "xi_control": lambda seeds: noise_free(20.0, 0.05, 1e-4, seeds),
    "xi_noise": noisy,
    **{name: partial(textbook_systems.measure, case) for name, case in textbook_systems.CASES.items()},
    "tras": tras,
    "trms33": trms33,
    "pysindy": pysindy_rows,
    "refit": refit,
    "speed": speed,
}
"""The cases of the table, by name."""
