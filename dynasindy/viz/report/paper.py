"""What the paper states: its claims, what its figures show, its two tables, and the numbers that decide a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from dynasindy.evaluation.ablation import Level
from dynasindy.viz.report.document import Statement

AXES = {"alpha_a": "azimuth", "alpha_p": "pitch"}
EPISODES = 2500
"""Episodes after which the paper draws its controllers with a model."""


class Threshold(NamedTuple):
    """A number that decides a verdict, its unit, and what it decides."""

    value: float
    unit: str
    words: str


FALL = Threshold(
    0.1,
    "of the first error",
    "The last reward error is less than this, and below `gate.open_below`; or it is below that in every episode.",
)
CLOSE = Threshold(5.0, "% of the state's range", "A state is predicted well if its RMSE is less.")
COEFFICIENT = Threshold(1.0, "%", "A coefficient is found if its error is less; no other function may be in the model.")
EARLY = Threshold(0.25, "of the evaluations", "The first part, over which early rewards are averaged.")
SOON = Threshold(
    180,
    "real episodes",
    "Where 800 rollouts are at the level no sooner than 400, but both are within these, there is no difference.",
)
LEVEL = Threshold(Level().error, "rad", "The required steady-state error of policies with planning.")
FINE = Threshold(0.01, "rad", "Where 400 and 800 rollouts have at most this, and 800 not less, there is no difference.")
FOLLOWS = Threshold(0.1, "of the amplitude", "A wave is followed if the RMSE, a level held if its last error, is less.")
TRANSIENT = Threshold(10.0, "s", "Left out at the start of a sine.")
SETTLED = Threshold(5.0, "s", "The end of each level of a square wave, at which its error is taken.")
THRESHOLDS = [value for value in globals().values() if isinstance(value, Threshold)]

MODEL = "A model identified from seconds of excitation, refitted as episodes come, predicts the plant."
SOONER = "Planning on the model lets the policy learn from fewer real episodes."
EXACT = "With planning the policy holds a reference more exactly than without."
WAVES = "With the model, sines and square waves are followed."
CLAIMS = (MODEL, SOONER, EXACT, WAVES)

FALLS = (Statement("the reward error of the model is high at first and falls to almost none", MODEL),)
BEFORE = (Statement("the rotor speeds are predicted well", MODEL),)
AFTER = (
    Statement("all six states are predicted closely", MODEL),
    Statement("so they are when the chirp is applied again", MODEL),
)
REWARDS = (
    Statement("planning has the greater rewards early", SOONER),
    Statement("planning reaches the required level sooner", SOONER),
    Statement(f"800 rollouts converge sooner than 400, there in about {SOON.value:g} episodes", SOONER),
)


def _on_each_axis(*statements: Statement) -> tuple[Statement, ...]:
    return tuple(one._replace(words=f"{axis}: {one.words}") for axis in AXES.values() for one in statements)


STEPS = _on_each_axis(
    Statement("without planning it settles further from the reference than with it", EXACT),
    Statement("800 rollouts have the smallest steady-state error", EXACT),
)
SINE = _on_each_axis(
    Statement(f"with the model the sine is followed (RMSE under {100 * FOLLOWS.value:g} % of it)", WAVES)
)
SQUARE = _on_each_axis(Statement("with the model each level is held with little steady-state error", WAVES))

HYPERPARAMETERS: tuple[tuple[str, str, float, str], ...] = (
    ("Sampling Time [s]", "t_s", 0.05, "env.dt"),
    ("Maximum Steps per episode", "-", 400, "task.max_steps"),
    ("Critic Learning Rate", "alpha", 1e-4, "agent.critic_lr"),
    ("Actor Learning Rate", "alpha", 1e-4, "agent.actor_lr"),
    ("Discount Factor", "gamma", 0.995, "agent.gamma"),
    ("Buffer Size", "D", 2e6, "replay.capacity"),
    ("Batch Size", "K", 512, "replay.batch_size"),
    ("Noise", "sigma", 0.15, "agent.exploration_noise"),
    ("Noise Decay Rate", "-", 1e-3, "agent.noise_decay"),
    ("Target Smooth Factor", "tau", 0.005, "agent.tau"),
    ("Target Update Frequency", "-", 10, "agent.target_update_interval"),
)
"""Rows of the paper's table "Agent Training Hyperparameters": words, symbol, value, our key."""

XI: Mapping[str, Mapping[str, float]] = {
    "alpha_a": {"Omega_a": 1.0},
    "alpha_p": {"Omega_p": 1.0},
    "Omega_a": {
        "Omega_a": -10.0573,
        "omega_a cos(alpha_p)": 9.8316e-4,
        "u_p cos(alpha_p)": -0.7025,
        "cos(alpha_p)": 0.9479,
    },
    "Omega_p": {
        "1": 0.5961,
        "Omega_p": -0.414,
        "omega_p": 0.0013,
        "u_a": 0.1303,
        "Omega_a^2 sin(alpha_p)": -16.3547,
        "sin(alpha_p)": -3.54373,
        "cos(alpha_p)": -1.7473,
    },
    "omega_a": {"1": 262.7, "omega_a": -5.2281, "u_a": 3.7e4},
    "omega_p": {"1": -8.54, "omega_p": -1.4193, "u_p": 6.1e3},
}
"""Non-zero coefficients of the paper's table "SINDY model Xi matrix", by equation and function."""
TABLE_2 = (Statement(f"{sum(map(len, XI.values()))} coefficients are not zero", MODEL),)
