"""What the paper's figures and tables on data and model show, against ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dynasindy.viz.report.document import Finding, Statement
from dynasindy.viz.report.thresholds import CLOSE, COEFFICIENT, FALL, LASTS, SAMPLES, judged
from dynasindy.viz.style import Array

MODEL = "A model identified from seconds of excitation, refitted as episodes come, predicts the plant."
CHIRP = Statement("a chirp excites both inputs for 10 s")
SAMPLED = Statement(f"10 s sampled every 0.01 s, {SAMPLES.value:g} samples")
FALLS = Statement("the reward error of the model is high at first and falls to almost none", MODEL)
ROTORS = Statement("the rotor speeds are predicted well", MODEL)
BEAM = Statement("angles and rates are not predicted well")
CLOSELY = Statement("all six states are predicted closely", MODEL)
AGAIN = Statement("so they are when the chirp is applied again", MODEL)
AWAY = "the model ran away"
"""What is said of an error that is no number."""
Coefficients = Mapping[str, Mapping[str, float]]


def hyperparameters_stated(number: int) -> Statement:
    """Return the statement on so many hyperparameters."""
    return Statement(f"{number} hyperparameters")


def coefficients_stated(truth: Coefficients) -> Statement:
    """Return the statement on published coefficients."""
    return Statement(f"{sum(map(len, truth.values()))} coefficients are not zero", MODEL)


def excitation_agrees(case: str, duration: float, told: str) -> Finding:
    """Judge the excitation by how long it lasts [s]; `told` are its other figures."""
    as_long = abs(duration - 10.0) < LASTS.value
    return CHIRP.of(case, f"{duration:.4g} s, {told}", judged(as_long))


def samples_agree(case: str, samples: int, step: float, told: str) -> Finding:
    """Judge the training data by their number; `step` is the time between them [s], `told` other figures."""
    ours = f"{samples} samples, {step:.3g} s apart; {told}"
    return SAMPLED.of(case, ours, judged(samples == SAMPLES.value))


def hyperparameters_agree(case: str, number: int, wrong: Sequence[str]) -> Finding:
    """Judge settings: how many there are, and the keys of those that are not the paper's."""
    ours = f"{number - len(wrong)} of them in `experiment=paper`" + "".join(f", not `{key}`" for key in wrong)
    return hyperparameters_stated(number).of(case, ours, judged(not wrong))


def learning_agrees(case: str, episode: Array, error: Array, opened: Array, below: float) -> Finding:
    """Judge the course of the reward error.

    Args:
        case: Plant and experiment.
        episode: `(n,)` numbers of the episodes.
        error: `(n,)` reward error per period of each; not finite where the replay ran away, which is not below.
        opened: Episodes in which the model was trusted.
        below: Error at which it becomes trusted.
    """
    trusted = f"trusted from episode {opened[0]:.0f}" if len(opened) else "never trusted"
    fallen = bool(error[-1] < FALL.value * error[0] and error[-1] < below)
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    first, last, most = (f"{one:.2g} per period" if np.isfinite(one) else AWAY for one in error[[0, -1, worst]])
    return FALLS.of(
        case,
        f"{first} in episode 1, {last} in episode {episode[-1]:.0f}, at worst "
        f"{most} in episode {episode[worst]:.0f}; trusted below {below:g} on held-out windows, {trusted}",
        judged(fallen, bool((error < below).all())),
    )


def first_model_agrees(case: str, errors: Mapping[str, float]) -> list[Finding]:
    """Judge the model of the excitation alone by the RMSE of each state [% of its range]."""
    rotors, beam = ({k: v for k, v in errors.items() if k.startswith("omega_") == turning} for turning in (True, False))
    good, all_good = max(rotors.values()) < CLOSE.value, max(errors.values()) < CLOSE.value
    return [
        ROTORS.of(case, _percent(rotors), judged(good)),
        BEAM.of(case, _percent(beam), judged(max(beam.values()) >= CLOSE.value, all_good)),
    ]


def last_model_agrees(case: str, statement: Statement, errors: Mapping[str, float]) -> Finding:
    """Judge the model at the end by the RMSE of each state [% of its range]."""
    return statement.of(case, _percent(errors), judged(max(errors.values()) < CLOSE.value))


def coefficients_agree(case: str, model: Coefficients, truth: Coefficients) -> Finding:
    """Judge identified coefficients, by equation and function, against published ones."""
    true = {(state, name): value for state, row in truth.items() for name, value in row.items()}
    ours = {(state, name): value for state, row in model.items() for name, value in row.items()}
    hit, false = [key for key in true if key in ours], [key for key in ours if key not in true]
    worst = 100 * max((abs(ours[key] / true[key] - 1) for key in hit), default=np.inf)
    small = max((abs(model[s][name]) / max(map(abs, model[s].values())) for s, name in false), default=0.0)
    return coefficients_stated(truth).of(
        case,
        f"{len(hit)} of them found, the worst {worst:.2g} % off; {len(false)} functions besides"
        + (f", the largest {small:.1g} of the largest in its equation" if false else ""),
        judged(len(hit) == len(true) and not false and worst < COEFFICIENT.value),
    )


def _percent(errors: Mapping[str, float]) -> str:
    return "RMSE in % of range: " + ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())
