"""Plants of a stranger, all settings at their defaults: those of docs/examples, by the command of a new user."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, add_choices, add_output, add_seeds, commit, measure_seeds, run_command
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
    **{name: [f"system={name}"] for name in ("van_der_pol", "cart_pole", "quadrotor", "tanks", "swing_up")},
    "pendulum_v1": ["system=gymnasium", "env.id=Pendulum-v1", "train.episodes=0"],
    "pendulum_own": ["system=gymnasium", "env.id=Pendulum-v1", "task=own", "train.episodes=0"],
    **{name: [f"system={name}", "train.episodes=0"] for name in ("inverted_pendulum", "double_pendulum", "reacher")},
    "mountain_car": ["system=gymnasium", "env.id=MountainCarContinuous-v0", "train.episodes=0"],
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
    add_choices(parser, "--plants", tuple(PLANTS))
    add_seeds(parser, 5)
    add_output(parser, "plants")


def main(arguments: argparse.Namespace) -> None:
    """Train, and append a row per output."""
    measure_seeds(arguments, COLUMNS, measure)


def measure(plant: str, seed: int) -> list[Row]:
    """Run the command of a new user and return what its `metrics.json` holds.

    Raises:
        RuntimeError: The command left none.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "run"
        words = ["--config-dir", str(EXAMPLES / "conf"), *PLANTS[plant], f"seed={seed}", f"folder={place}"]
        spent, complaint = run_command("train", words, Path(folder), [EXAMPLES])
        file = place / "metrics.json"
        if not file.is_file():
            raise RuntimeError(f"train.py left no metrics.json for {plant}, seed {seed}: {complaint}")
        return rows_of(plant, seed, json.loads(file.read_text()), spent)


def rows_of(plant: str, seed: int, metrics: dict[str, Any], seconds: float) -> list[Row]:
    """Return a row per output, or one alone where nothing is tracked.

    Args:
        plant: Name of the plant.
        seed: Seed of the run.
        metrics: What `metrics.json` holds.
        seconds: CPU time of the command [s].
    """
    held, cost = metrics["held"], metrics["cost"]
    verdict = metrics["verdict"]["held"].partition(":")[0]
    return [
        {
            **{"plant": plant, "seed": seed, "verdict": verdict, "output": name},
            "error_percent": _percent(share) if name else "",
            "worst_percent": _percent(held["worst"][name]) if name else "",
            "plant_seconds": cost["plant_seconds"],
            "periods": cost["real_steps"],
            "cpu_seconds": round(seconds, 1),
            "commit": commit(),
            "own_return": "" if (own := metrics["evaluation"].get("own_return")) is None else round(own, 2),
        }
        for name, share in (held["share"] or {"": None}).items()
    ]


def _percent(share: float | None) -> float:
    return float("inf") if share is None else float(f"{100 * share:.3g}")
