"""How much a controller bears: margins and worst cases of default plans beside those made for the model alone.

Each controller is trained by `train.py` and checked by `check.py` as a user calls them; what it earns and how far it
ends from its targets is measured on the plant itself.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common import add_choices, add_output, add_seeds, commit, measure_seeds, run_command
from benchmarks.plants import EXAMPLES
from dynasindy.safe_io import Row

PLANTS = ("tras", "xi", "tanks", "four_tanks", "springs", "reactor", "ship", "van_der_pol")
"""Plants of the package, and some of docs/examples."""
PLANNING = ("nominal", "gradient")
COLUMNS = (
    *("plant", "planning", "seed", "verdict", "return", "error_percent", "worst_percent"),
    *("gain", "phase_deg", "delay_s", "disk", "targets", "unstable_targets", "draws", "unstable_draws", "weak"),
    *("cpu_seconds", "commit"),
)
"""Columns of the file: errors are those of the worst output, in % of its range; margins the least of all inputs."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", PLANTS)
    add_seeds(parser, 3)
    add_output(parser, "margins")


def main(arguments: argparse.Namespace) -> None:
    """Train and check, and append a row per kind of planning."""
    measure_seeds(arguments, COLUMNS, measure)


def measure(plant: str, seed: int) -> list[Row]:
    """Train and check a controller with each kind of planning.

    Raises:
        RuntimeError: A command left no result.
    """
    return [_one(plant, planning, seed) for planning in PLANNING]


def _one(plant: str, planning: str, seed: int) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        words = ["--config-dir", str(EXAMPLES / "conf"), f"system={plant}", f"planning={planning}", f"seed={seed}"]
        spent, said = run_command("train", [*words, f"folder={run}"], Path(folder), [EXAMPLES])
        said += run_command("check", [f"run={run}"], Path(folder), [EXAMPLES])[1]
        if not (run / "check" / "check.json").is_file():
            raise RuntimeError(f"no check.json is left of {plant}, planning={planning}, seed {seed}: {said}")
        metrics, found = (json.loads((run / name).read_text()) for name in ("metrics.json", "check/check.json"))
    head = {"plant": plant, "planning": planning, "seed": seed}
    return {**head, **row_of(metrics, found), "cpu_seconds": round(spent, 1), "commit": commit()}


def row_of(metrics: dict[str, Any], found: dict[str, Any]) -> Row:
    """Return what a run and its check found.

    Args:
        metrics: What `metrics.json` holds.
        found: What `check/check.json` holds.
    """
    inputs, held = metrics["check"]["margins"].values(), metrics["held"]
    gain, phase, delay, disk = (
        min((each[name] for each in inputs), default=math.nan) for name in ("gain", "phase", "delay", "disk")
    )
    radii = [one["spectral_radius"] for one in found["changes"] if one["change"].startswith("draw ")]
    return {
        "verdict": metrics["verdict"]["held"].partition(":")[0],
        "return": round(metrics["evaluation"]["return"], 2),
        "error_percent": _percent(held["share"]),
        "worst_percent": _percent(held["worst"]),
        **{"gain": round(gain, 2), "phase_deg": round(phase, 1), "delay_s": round(delay, 4), "disk": round(disk, 2)},
        "targets": len(found["targets"]),
        "unstable_targets": sum(not target["stable"] for target in found["targets"]),
        "draws": len(radii),
        "unstable_draws": sum(radius is None or radius >= 1 for radius in radii),  # None: it rests nowhere
        "weak": len(metrics["check"]["weak"]),
    }


def _percent(shares: dict[str, float | None]) -> float:
    return max(math.inf if share is None else float(f"{100 * share:.3g}") for share in shares.values())
