"""Every controller on the same plants: same limits, same sampling, same references, same data.

A file that exists is carried on: rows it holds are not measured again. The policies of finished runs are added by
`python scripts/add_runs.py RUN...`; docs/results/baselines.md is written anew from the file each time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import torch

from benchmarks import gradient
from benchmarks.gradient import PLANTS
from benchmarks.stopwatch import Timed
from dynasindy.agents.classical import MPC, Trial, tuned_lqi, tuned_pid
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.loop import train
from dynasindy.dyna.parts import Parts
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.rows import Row, append_rows, read_rows, write_rows
from dynasindy.evaluation.scenarios import Policy, Scenario, evaluate, step_references
from dynasindy.evaluation.statistics import interquartile_mean
from dynasindy.evaluation.table import markdown, over_seeds
from dynasindy.planning.integral import IntegralAction
from dynasindy.tasks import Wave
from dynasindy.viz.controllers import named

OUT = Path("docs/results/baselines.csv")
KEY = ("plant", "controller", "model", "seed")
COLUMNS = (*KEY, "real_seconds", "scenario", "metric", "azimuth", "pitch", "ms_per_action")
METRICS = ("rmse", "mean_abs_error", "steady_state_error", "control_variation")
HEADINGS = ("RMSE [rad]", "mean abs error [rad]", "steady-state error [rad]", "control variation [1/s]")
LEARNED = (named("gradient"), named("gradient_integral"))
RIVALS = ("LQI", "MPC")
GOALS = (("step", "steady_state_error"), ("sine", "rmse"), ("square", "rmse"))
TUNING_REFERENCES = 16
MARK = "## Tables"


def main(arguments: argparse.Namespace) -> None:
    """Measure controllers, models, plants and seeds, and append the rows of each as soon as they are there."""
    torch.set_num_threads(1)
    for key in cases(arguments):
        if not any(same(row, key) for row in read_rows(arguments.out)):
            plant, controller, model, seed = key
            env, policy, seconds = prepare(plant, controller, model == "true", seed)
            append(arguments.out, judge(env, policy, (*key, seconds), scenarios(plant, arguments.seconds)))
    write_tables(arguments.out)


def cases(arguments: argparse.Namespace) -> list[tuple[str, str, str, int]]:
    """Return what is to be measured; classical control of a known plant has nothing random, one seed is all."""
    found = []
    for plant in arguments.plants:
        for seed in arguments.seeds:
            for model in arguments.models:
                for controller in arguments.controllers:
                    if seed == arguments.seeds[0] or model == "identified" or controller in LEARNED:
                        found.append((plant, controller, model, seed))
    return found


def prepare(plant: str, controller: str, oracle: bool, seed: int) -> tuple[ControlEnv, Policy, float]:
    """Return the plant's environment, a controller and the seconds of plant time it took.

    Args:
        plant: Name of the plant.
        controller: Name of the controller.
        oracle: Whether the controller knows the plant; otherwise it knows the model of 10 s of excitation.
        seed: Seed of the excitation and of learning.
    """
    parts = _parts(plant, oracle, seed, controller in LEARNED)
    return parts.plant, CONTROLLERS[controller](parts, seed), parts.plant.dt * len(parts.replay.real)


@lru_cache(maxsize=1)
def _parts(plant: str, oracle: bool, seed: int, learned: bool) -> Parts:
    """Return a plant with its model identified, unless it is the plant, and with its policy planned if asked for."""
    case = replace(gradient.CASES["moving"], oracle=oracle)
    recipe = gradient.build_recipe(case, plant, seed, {} if learned else {"updates": 0})
    parts = recipe.build()
    if learned or not oracle:
        train(parts, recipe.train, Callback())
    return parts


def _lqi(parts: Parts, seed: int) -> Policy:
    return tuned_lqi(_trial(parts, seed), seed=seed)


def _pid(parts: Parts, seed: int) -> Policy:
    return tuned_pid(_trial(parts, seed), seed=seed)


def _mpc(parts: Parts, seed: int) -> Policy:
    return MPC(parts.world_model, dt=parts.plant.dt)


def _learned(parts: Parts, seed: int) -> Policy:
    return parts.agent.deployed


def _learned_integral(parts: Parts, seed: int) -> Policy:
    return IntegralAction(parts.agent.deployed, parts.plant)


CONTROLLERS: dict[str, Callable[[Parts, int], Policy]] = {
    LEARNED[0]: _learned,
    LEARNED[1]: _learned_integral,
    "LQI": _lqi,
    "MPC": _mpc,
    "PID": _pid,
}


def _trial(parts: Parts, seed: int) -> Trial:
    """Return what classical controllers are tuned on: the model, and references drawn as the learned policy's are."""
    generator = torch.Generator().manual_seed(1000 + seed)
    wanted = parts.plant.task.sample(torch.Size((TUNING_REFERENCES,)), generator)
    return Trial(parts.world_model, wanted, dt=parts.plant.dt)


def scenarios(plant: str, seconds: float = 0.0) -> list[Scenario]:
    """Return scenarios A, B and C of the paper, each of its own length or of `seconds`.

    Raises:
        ValueError: The plant has none of them.
    """
    if plant not in PLANTS:
        raise ValueError(f"plant {plant} is not compared here; choose of {', '.join(PLANTS)}")
    facts = PLANTS[plant]
    return [
        Scenario("step", step_references(facts.low, facts.high), 64, seconds or 20.0),
        Scenario("sine", Wave([0.35, 0.25], [0.015, 0.015]), 1, seconds or 100.0),
        Scenario("square", Wave([0.4, -0.5], [0.01, 0.01], "square"), 1, seconds or 200.0),
    ]


def judge(env: ControlEnv, policy: Policy, head: Sequence[Any], among: Iterable[Scenario]) -> list[Row]:
    """Return a row per scenario and metric.

    Args:
        env: Environment of the plant.
        policy: The controller.
        head: Values of the columns up to `real_seconds`.
        among: Scenarios; the computing time is that of those with one row.
    """
    single, rows = Timed(policy), []
    for scenario in among:
        result = evaluate(env, single if scenario.episodes == 1 else policy, scenario)
        for metric in METRICS:
            azimuth, pitch = (float(f"{value:.4g}") for value in result.metrics[metric].mean(0).tolist())
            rows.append((*head, scenario.name, metric, azimuth, pitch))
    milliseconds = float(f"{1e3 * single.seconds / single.calls:.3g}")
    return [dict(zip(COLUMNS, (*row, milliseconds), strict=True)) for row in rows]


def append(path: Path, rows: list[Row]) -> None:
    """Put rows into a file, in place of those of the same controller and seed, and print them."""
    key, old = tuple(rows[0][name] for name in KEY), read_rows(path)
    kept = [row for row in old if not same(row, key)]
    if len(kept) < len(old):
        write_rows(path, COLUMNS, [*kept, *rows])
    else:  # only appended to, so that two processes may share the file
        append_rows(path, COLUMNS, rows)
    figures = [f"{row['scenario']} {row['azimuth']} / {row['pitch']}" for row in rows if row["metric"] == METRICS[0]]
    print(f"{', '.join(map(str, key))}: RMSE {', '.join(figures)}, {rows[0]['ms_per_action']} ms", flush=True)


def same(row: Row, key: Sequence[Any]) -> bool:
    """Return whether a row belongs to a plant, controller, model and seed."""
    return [str(row[name]) for name in KEY] == [str(value) for value in key]


def write_tables(path: Path) -> None:
    """Write the tables of a CSV file into the page of the same name, after what stands above them there."""
    page = path.with_suffix(".md")
    above = page.read_text().partition(MARK)[0] if page.exists() else "# Controllers compared\n\n"
    page.write_text(f"{above}{MARK}\n\n" + "\n\n".join(tables(read_rows(path))) + "\n")


def tables(rows: Sequence[Row]) -> list[str]:
    """Return Markdown: the goals, then a table per plant and scenario, sorted by name."""
    parts = ["### Learned from 10 s of data, beside LQI and MPC on the model of the same data", goals(rows)]
    for plant in sorted({row["plant"] for row in rows}):
        for scenario in [name for name, _ in GOALS]:
            found = [row for row in rows if _matches(row, {"plant": plant, "scenario": scenario})]
            parts += [f"### `{plant}`, {scenario}", _table(found)]
    return parts


def goals(rows: Sequence[Row]) -> str:
    """Return a table of the figures by which a learned controller is to be at or ahead of LQI and MPC."""
    words = {"rmse": "RMSE", "steady_state_error": "steady-state error"}
    lines = []
    for plant in sorted({row["plant"] for row in rows}):
        for scenario, metric in GOALS:
            at = {"plant": plant, "model": "identified", "scenario": scenario, "metric": metric}
            for name, axis in product(LEARNED, ("azimuth", "pitch")):
                found = [_values(rows, {**at, "controller": other}, axis) for other in (name, *RIVALS)]
                if all(found):
                    mine, *theirs = (_middle(values) for values in found)
                    figures = [*map(_over_seeds, found), _verdict(mine, min(theirs))]
                    lines.append([plant, f"{words[metric]}, {scenario}", axis, name, *figures])
    return markdown(
        ("plant", "figure [rad]", "axis", "learned", "its", *RIVALS, "against the better of the two"), lines
    )


def _verdict(mine: float, best: float) -> str:
    word = "ahead" if mine < best else "level" if mine == best else "behind"
    return f"{word} by {abs(best - mine):.2g}"


def _table(rows: Sequence[Row]) -> str:
    header = ["controller", "model", "real data [s]", "seeds", *HEADINGS, "ms per action"]
    lines = []
    for controller, model in sorted({(row["controller"], row["model"]) for row in rows}):
        mine = {"controller": controller, "model": model}
        first = [row for row in rows if _matches(row, {**mine, "metric": METRICS[0]})]
        figures = [
            " / ".join(_over_seeds(_values(rows, {**mine, "metric": name}, axis)) for axis in ("azimuth", "pitch"))
            for name in METRICS
        ]
        seconds = sorted({round(float(row["real_seconds"])) for row in first})
        heavy = _middle([float(row["ms_per_action"]) for row in first])
        lines.append([controller, model, " to ".join(map(str, seconds)), str(len(first)), *figures, f"{heavy:.2g}"])
    return markdown(header, lines)


def _matches(row: Row, wanted: Row) -> bool:
    return all(row[name] == value for name, value in wanted.items())


def _values(rows: Sequence[Row], wanted: Row, axis: str) -> list[float]:
    return [float(row[axis]) for row in rows if _matches(row, wanted)]


def _middle(values: Sequence[float]) -> float:
    return interquartile_mean(torch.tensor(values, dtype=torch.float64)).item()


def _over_seeds(values: Sequence[float]) -> str:
    """Return the figure over seeds, a dash where there is none."""
    return over_seeds(values) if values else "-"
