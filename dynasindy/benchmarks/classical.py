"""Tracking of LQI and of tuned PID on the twin rotors: what a learned policy is to be compared with.

Both know the plant itself: LQI its linearisation and equilibria, PID by tuning on it. The scenarios are those of
the paper: 64 steps (the same for a seed), a sine and a square wave, each from the origin with rotors stopped.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import torch

from dynasindy.agents.classical import LQI, PID, TrackingController, Tuning
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Scenario, evaluate, step_references
from dynasindy.systems import System, Tras, Xi
from dynasindy.tasks import Step, Tracking, Wave

LOW, HIGH = (-0.5, -0.5), (0.5, 0.4)  # targets that both plants can hold [rad]
TUNING_STEPS = ((0.4, 0.25), (-0.4, -0.4), (0.3, -0.3), (-0.2, 0.3))
PLANTS: dict[str, Callable[[], System]] = {"tras": Tras, "xi": Xi}
COLUMNS = ("rmse", "mean_abs_error", "steady_state_error")

Row = dict[str, str | float]


def main(argv: list[str]) -> None:
    """Run both controllers in all scenarios, print a table and write it as CSV."""
    parser = argparse.ArgumentParser(prog="benchmark.py classical", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=0.0, help="length of every run; 0 takes the scenario's own")
    parser.add_argument("--out", type=Path, default=Path("docs/results/classical.csv"), help="CSV file to write")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    rows = [row for plant in PLANTS for row in measure(plant, arguments.seconds)]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with arguments.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    for row in rows:
        print("".join(f"{value:>12.4f}" if isinstance(value, float) else f"{value:<11}" for value in row.values()))
    print(f"written to {arguments.out}")


def scenarios(seconds: float = 0.0) -> list[Scenario]:
    """Return the paper's scenarios, each of its own length or of `seconds`."""
    return [
        Scenario("step", Step([[0.4, 0.25]]), seconds=seconds or 20.0),
        Scenario("steps", step_references(LOW, HIGH), episodes=64, seconds=seconds or 20.0),
        Scenario("sine", Wave([0.35, 0.25], [0.015, 0.015]), seconds=seconds or 100.0),
        Scenario("square", Wave([0.4, -0.5], [0.01, 0.01], "square"), seconds=seconds or 200.0),
    ]


def measure(plant: str, seconds: float = 0.0) -> list[Row]:
    """Return a row per controller, scenario and axis."""
    system = PLANTS[plant]()
    env = ControlEnv(system, Tracking(system.signature, Step([list(HIGH)])))
    gains = Tuning().run(system, torch.tensor(TUNING_STEPS))
    controllers: dict[str, TrackingController] = {"LQI": LQI(system), "PID": PID(system.signature, gains)}
    print(f"{plant}: PID gains {gains}")
    rows: list[Row] = []
    for name, controller in controllers.items():
        for scenario in scenarios(seconds):
            metrics = evaluate(env, controller, scenario).metrics
            for axis, output in enumerate(("alpha_a", "alpha_p")):
                values = {f"{column} [rad]": metrics[column][:, axis].mean().item() for column in COLUMNS}
                rows.append({"plant": plant, "controller": name, "scenario": scenario.name, "axis": output, **values})
    return rows
