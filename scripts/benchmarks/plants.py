"""Plants of a stranger, all settings at their defaults: those of docs/examples, by the command of a new user."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from benchmarks.common import ROOT, add_choices, add_output, add_seeds, measure_plants, run_command
from dynasindy.safe_io import Row

EXAMPLES = ROOT / "docs" / "examples"
UNTUNED = (
    *("maglev", "reactor", "ball_on_beam", "furuta", "arm", "four_tanks"),
    *("ship", "springs", "room", "balancer", "boost", "bioreactor"),
)
"""Plants of docs/examples that no setting was tuned on."""
MEASURED = ("furuta", "balancer", "cart_pole", "ball_on_beam", "quadrotor")
"""Unstable plants of docs/examples whose files say what a bench measures: places and angles in steps, no rates."""
PLANTS = {
    **{
        name: [f"system={name}"]
        for name in ("van_der_pol", "cart_pole", "quadrotor", "tanks", "swing_up", "furuta_swing_up")
    },
    "pendulum_v1": ["system=gymnasium", "env.id=Pendulum-v1", "train.episodes=0"],
    "pendulum_own": ["system=gymnasium", "env.id=Pendulum-v1", "task=own", "train.episodes=0"],
    **{name: [f"system={name}", "train.episodes=0"] for name in ("inverted_pendulum", "double_pendulum", "reacher")},
    "mountain_car": ["system=gymnasium", "env.id=MountainCarContinuous-v0", "train.episodes=0"],
    **{name: [f"system={name}"] for name in ("dm_pendulum", "dm_cartpole", "dm_swing_up")},
    **{name: [f"system={name}"] for name in UNTUNED},
    **{f"{name}_bench": [f"system={name}", "sensors=bench"] for name in MEASURED},
}
"""Plants, and the words that choose them: those of docs/examples, and environments of Gymnasium."""
COLUMNS = (
    *("plant", "seed", "verdict", "output", "error_percent", "worst_percent"),
    *("plant_seconds", "periods", "cpu_seconds", "commit", "own_return"),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", PLANTS)
    add_seeds(parser, 5)
    add_output(parser, "plants")


def main(arguments: argparse.Namespace) -> None:
    """Train, and append a row per output."""
    measure_plants(arguments, COLUMNS, measure)


def measure(plant: str, seed: int) -> list[Row]:
    """Run the command of a new user and return a row per output, or one alone where nothing is tracked."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run" / "metrics.json"
        words = ["--config-dir", str(EXAMPLES / "conf"), *PLANTS[plant], f"seed={seed}", f"folder={file.parent}"]
        spent = run_command("train", words, Path(folder), file, [EXAMPLES])
        metrics = json.loads(file.read_text())
    word = {True: "CONTROLLED", False: "NOT CONTROLLED", None: "NOT JUDGED"}[metrics["verdict"]["controlled"]]
    held, cost, own = metrics["held"], metrics["cost"], metrics["evaluation"].get("own_return")
    return [
        {
            **{"plant": plant, "seed": seed, "verdict": word, "output": name},
            "error_percent": _percent(share) if name else "",
            "worst_percent": _percent(held["worst"][name]) if name else "",
            **{"plant_seconds": cost["plant_seconds"], "periods": cost["real_steps"], "cpu_seconds": round(spent, 1)},
            "own_return": "" if own is None else round(own, 2),
        }
        for name, share in (held["share"] or {"": None}).items()
    ]


def _percent(share: float | None) -> float:
    return float("inf") if share is None else float(f"{100 * share:.3g}")
