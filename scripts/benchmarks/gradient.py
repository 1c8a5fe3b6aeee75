"""Seconds of plant data to a controller: planning through the model's gradient, measured on the real plant.

Every row is one figure of one policy in one scenario.
A file that exists is carried on: rows it holds are not measured again.
Wall and CPU seconds are those from nothing to the policy (excitation, fits, planning, episodes), evaluation left out.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from benchmarks.common import add_choices, add_output, add_seeds, carry_on, cpu_seconds, detuned
from dynasindy.agents import TD3, DynaReplay
from dynasindy.control.controller import IntegralAction
from dynasindy.dyna.callback import Callback, Place
from dynasindy.dyna.experiment import Components, LoopSettings, Recipe
from dynasindy.dyna.loop import train
from dynasindy.envs import (
    Channel,
    ControlEnv,
    Multisine,
    RandomStep,
    Reference,
    Sensors,
    Tracking,
    TrackingReward,
    Wave,
)
from dynasindy.evaluation.disturbances import PerturbedPlant
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate, step_references
from dynasindy.planning import Gate, GradientPlanning
from dynasindy.safe_io import Row
from dynasindy.sindy import Oracle, Refinement, Regression, SindyModel
from dynasindy.systems import System, Tras, Trms33, Xi
from dynasindy.systems.tras import TrasConstants
from dynasindy.systems.twin_rotor import SIGNATURE

Pair = tuple[float, float]


@dataclass(frozen=True)
class Plant:
    """A plant and what has to be known to excite it and to ask something of it.

    Attributes:
        build: Makes the system.
        library: Candidate functions of its model.
        low: Lower ends of the targets that it can hold [rad].
        high: Upper ends [rad].
        amplitude: Half range of each input of the excitation.
        offset: Mean of each input.
    """

    build: Callable[[], System]
    library: str
    low: Pair = (-0.5, -0.5)
    high: Pair = (0.5, 0.4)
    amplitude: Pair = (0.5, 0.3)
    offset: Pair = (-0.1, 0.2)


PLANTS = {
    "xi": Plant(Xi, "paper_table"),
    "tras": Plant(Tras, "rotor"),
    "trms33": Plant(Trms33, "rotor_reaction", high=(0.5, 0.3), amplitude=(0.4, 0.25), offset=(0.2, 0.5)),
}
KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}
COUNT = 2 * math.pi / 4096  # rad
BENCH = Sensors(
    {
        **dict.fromkeys(("alpha_a", "alpha_p"), Channel(resolution=COUNT)),
        **dict.fromkeys(("omega_a", "omega_p"), Channel(noise=20.0)),  # rpm
    },
    KNOWN,
    disturbance=True,
)
NOISE = (5e-4, 5e-4, 5e-3, 5e-3, 20.0, 20.0)  # rad, rad, rad/s, rad/s, rpm, rpm
NOISY = Sensors({name: Channel(noise=std) for name, std in zip(SIGNATURE.state_names, NOISE)}, KNOWN)
GUST = {"Omega_a": 0.5, "Omega_p": 0.5}  # rad/s^2
COLUMNS = (
    *("case", "plant", "seed", "plant_seconds", "scenario", "metric", "azimuth", "pitch", "azimuth_worst"),
    *("pitch_worst", "return", "updates", "wall_seconds", "cpu_seconds", "commit"),
)


@dataclass(frozen=True)
class Case:
    """What is measured.

    Attributes:
        episodes: Real episodes after the excitation.
        oracle: Plan with the true plant as the model.
        moving: Train on moving references and evaluate on the paper's sine and square.
        sensors: What is measured of the plant, in the data and in flight; all states as they are if None.
        longest_delay: Longest delay of the inputs that the fit looks for [s]; None where the data are to tell, as in
            the commands.
        detuned: Evaluate on a plant with other parameters, in a gust.
        integral: Evaluate with integral action, too.
        input_delay: By how much inputs are late in one imagined episode of two [control periods].
        gain_range: By what share inputs of imagined episodes are weaker or stronger, at most; None for the default.
        updates: Gradient updates of the first planning phase; None for as many as suit the plant.
        hidden: Widths of the policy's hidden layers.
        plants: Plants that it is measured on.
    """

    episodes: int = 0
    oracle: bool = False
    moving: bool = False
    sensors: Sensors | None = None
    longest_delay: float | None = 0.0
    detuned: bool = False
    integral: bool = False
    input_delay: float = 1.0
    gain_range: float | None = None
    updates: int | None = None
    hidden: tuple[int, ...] = (128, 128)
    plants: tuple[str, ...] = ("xi", "tras")


CASES = {
    "step": Case(episodes=1),
    # Planned on the model as it is.
    "nominal": Case(episodes=1, input_delay=0.0, gain_range=0.0),
    "small": Case(hidden=(64, 64)),
    "oracle": Case(oracle=True),
    "moving": Case(moving=True, updates=400),
    "noise": Case(episodes=3, sensors=NOISY, integral=True),
    "bench": Case(sensors=BENCH, longest_delay=None),
    "bench_delay": Case(sensors=replace(BENCH, actuator_delay=1), longest_delay=None),
    "detuned": Case(detuned=True, integral=True, plants=("tras",)),
    "friction_alone": Case(integral=True, plants=("trms33",)),  # the excitation and nothing else
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--cases", tuple(CASES))
    add_choices(parser, "--plants", tuple(PLANTS))
    add_seeds(parser, 10)
    add_output(parser, "gradient")


def main(arguments: argparse.Namespace) -> None:
    """Measure cases, plants and seeds, and append a row per policy and scenario."""
    torch.set_num_threads(1)
    keys = [
        (case, plant, seed)
        for case in arguments.cases
        for seed in arguments.seeds
        for plant in CASES[case].plants
        if plant in arguments.plants
    ]
    carry_on(arguments.out, COLUMNS, ("case", "plant", "seed"), keys, measure)


def measure(name: str, plant: str, seed: int, **planning: Any) -> list[Row]:
    """Run one case and return its rows, one per phase and scenario.

    Args:
        name: Name of the case.
        plant: Name of the plant.
        seed: Seed of the run.
        **planning: Settings of `GradientPlanning` other than its defaults.
    """
    run = Judging(name, plant, seed, planning)
    train(run.parts, run.recipe.train, run)
    return run.rows


class Judging(Callback):
    """A run whose policy is judged after each planning phase; the time that this takes is left out.

    Args:
        name: Name of the case.
        plant: Name of the plant.
        seed: Seed of the run.
        planning: Settings of `GradientPlanning` other than its defaults.
    """

    def __init__(self, name: str, plant: str, seed: int, planning: dict[str, Any]) -> None:
        self.wall, self.cpu = -time.perf_counter(), -cpu_seconds()
        self.name, self.plant, self.seed = name, plant, seed
        self.recipe = build_recipe(CASES[name], plant, seed, planning)
        self.parts = self.recipe.build()
        self.rows: list[Row] = []

    def reached(self, place: Place) -> None:
        """Append a row per scenario."""
        if place.number < 2:
            return
        self.wall, self.cpu = self.wall + time.perf_counter(), self.cpu + cpu_seconds()
        costs = {"updates": place.updates, "wall_seconds": round(self.wall, 1), "cpu_seconds": round(self.cpu, 1)}
        seconds = self.parts.plant.dt * len(self.parts.replay.real)
        head = {"case": self.name, "plant": self.plant, "seed": self.seed, "plant_seconds": seconds}
        for scenario, metric, values in judge(CASES[self.name], self.plant, self.parts, self.seed):
            self.rows.append({**head, "scenario": scenario, "metric": metric, **values, **costs})
        self.wall, self.cpu = self.wall - time.perf_counter(), self.cpu - cpu_seconds()


class Mixture(Reference):
    """One of several references per row."""

    def __init__(self, references: Sequence[Reference]) -> None:
        self.references, self.n_r = references, references[0].n_r

    def sample(self, batch: torch.Size, generator: torch.Generator) -> torch.Tensor:
        """Draw a component and its parameters per row, `(*batch, n_r, 5)`."""
        draws, rows = torch.stack([each.sample(batch, generator) for each in self.references]), batch.numel()
        choice = torch.multinomial(torch.ones(len(draws)), rows, replacement=True, generator=generator)
        shape = draws.shape[1:]
        return draws.reshape(len(draws), rows, *shape[-2:])[choice, torch.arange(rows)].reshape(shape)


def build_recipe(case: Case, plant: str, seed: int, planning: dict[str, Any]) -> Recipe:
    """Return the experiment of a case."""
    facts = PLANTS[plant]
    system = facts.build()
    model = partial(Oracle, system=system) if case.oracle else partial(sparse_model, facts.library, case)
    references: Reference = RandomStep(facts.low, facts.high)
    if case.moving:
        references = Mixture([RandomStep((-0.55, -0.55), (0.55, 0.55)), *_waves(random=True)])
    reward = TrackingReward(error_shape="linear")
    return Recipe(
        system=system,
        task=partial(Tracking, reference=references, reward=reward, observe_rate=case.moving),
        env=partial(ControlEnv, dtype=torch.float64),
        excitation=partial(Multisine, amplitude=facts.amplitude, offset=facts.offset, seed=seed),
        world_model=model,
        agent=partial(TD3, hidden=case.hidden),
        replay=partial(DynaReplay, capacity=100_000, batch_size=256),
        planning=partial(
            GradientPlanning,
            **{"input_delay": case.input_delay, "gain_range": case.gain_range, "updates": case.updates, **planning},
        ),
        gate=Gate(open_below=torch.inf, close_above=torch.inf),
        train=LoopSettings(episodes=case.episodes, updates_per_step=0),
        sensors=case.sensors,
        seed=seed,
    )


def sparse_model(library: str, case: Case, signature: Any) -> SindyModel:
    """Return the world model of the main job, which fits noisy samples by whole trajectories."""
    return SindyModel(
        signature,
        library,
        Regression(method="bic", tolerance=1e-4),
        Refinement("integral" if case.sensors is None else "trajectory", longest_delay=case.longest_delay),
        known=KNOWN,
    )


def judge(case: Case, plant: str, parts: Components, seed: int) -> Iterable[tuple[str, str, Row]]:
    """Yield scenario, metric and numbers of the policy on the real plant."""
    facts = PLANTS[plant]
    steps = step_references(facts.low, facts.high, 64)
    if case.moving:
        for wave, seconds in zip(_waves(), (100.0, 200.0)):
            name = "square" if float(wave.params[0, 4]) else "sine"
            result = evaluate(parts.plant, parts.agent.deployed, Scenario(name, wave, 1, seconds))
            yield name, "rmse", _numbers(result, result.metrics["rmse"])
        return
    env, observer = parts.plant, parts.sensing and parts.sensing.observer
    if case.detuned:  # every constant of its own is off by up to 10 %
        env = env.with_system(Tras(constants=detuned(TrasConstants(), 0.1, 1000 + seed)))
    policies: dict[str, Policy] = {"": parts.agent.deployed}
    if case.integral:
        policies["_integral"] = IntegralAction(parts.agent.deployed, env)
    for suffix, policy in policies.items():
        if case.detuned:
            gust = Scenario("detuned_gust", steps, 64, 30.0, partial(PerturbedPlant, push=GUST), [(12.0, 15.0)])
            result = evaluate(env, policy, gust, observer)
            late = (result.trajectory["reference"] - result.outputs).abs()[:, result.time >= 20.0].amax(1)
            yield f"detuned_gust{suffix}", "max_abs_error_5s_after_gust", _numbers(result, late)
        else:
            result = evaluate(env, policy, Scenario("step", steps, 64), observer)
            yield f"step{suffix}", "mean_abs_error_last_5s", _numbers(result, result.metrics["steady_state_error"])


def _waves(random: bool = False) -> list[Wave]:
    """Return the paper's sine B and square C, or faster and larger random ones to train on."""
    if random:
        wide = (0.55, 0.55)
        return [Wave(wide, (0.05, 0.05), shape, random=True) for shape in ("sine", "square")]
    return [Wave((0.35, 0.25), (0.015, 0.015)), Wave((0.4, -0.5), (0.01, 0.01), "square")]


def _numbers(result: Evaluation, errors: torch.Tensor) -> Row:
    """Return mean and worst of errors `(episodes, 2)` and the mean return."""
    mean, worst = errors.mean(0).tolist(), errors.amax(0).tolist()
    names = ("azimuth", "pitch", "azimuth_worst", "pitch_worst")
    numbers: Row = {name: round(value, 5) for name, value in zip(names, (*mean, *worst))}
    return {**numbers, "return": round(float(result.returns.mean()), 3)}
