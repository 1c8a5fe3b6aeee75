"""A sweep in one table: interquartile means over seeds, from the `metrics.json` of its runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from dynasindy.evaluation.statistics import bootstrap_interval, interquartile_mean


def sweep_table(folder: Path) -> str:
    """Return a Markdown table of a sweep, a row per setting, over its seeds.

    Args:
        folder: Folder of the sweep, whose runs are named `number_key=value,...` by Hydra.

    Raises:
        FileNotFoundError: No run of the folder has ended.
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for file in sorted(folder.glob("*/metrics.json")):
        _, _, overrides = file.parent.name.partition("_")
        setting = " ".join(word for word in overrides.split(",") if not word.startswith("seed="))
        groups.setdefault(setting, []).append(json.loads(file.read_text()))
    if not groups:
        raise FileNotFoundError(f"{folder} holds no finished run; give the folder of a sweep, e.g. runs/DATE_TIME")
    lines = [
        "| setting | seeds | real steps (plant time) | return, untrained | return, trained "
        "| steady-state error, per axis [rad] | RMSE, per axis [rad] | wall time [s] |",
        "| --- " * 8 + "|",
    ]
    return "\n".join(lines + [_row(setting, runs) for setting, runs in sorted(groups.items())])


def _row(setting: str, runs: Sequence[dict[str, Any]]) -> str:
    cost = runs[0]["cost"]
    cells = [
        f"`{setting or 'default'}`",
        str(len(runs)),
        f"{cost['real_steps']} ({cost['plant_seconds']:.0f} s)",
        _interval([run["untrained"]["return"] for run in runs]),
        _interval([run["evaluation"]["return"] for run in runs]),
        _axes(runs, "steady_state_error"),
        _axes(runs, "rmse"),
        _interval([run["cost"]["wall_seconds"] for run in runs]),
    ]
    return "| " + " | ".join(cells) + " |"


def _axes(runs: Sequence[dict[str, Any]], metric: str) -> str:
    names = [key for key in runs[0]["evaluation"] if key.startswith(f"{metric}/")]
    return " / ".join(_interval([run["evaluation"][name] for run in runs]) for name in names)


def _interval(values: Sequence[float | None]) -> str:
    """Return the interquartile mean and the 95 % interval of its bootstrap, or how many runs have no number."""
    # Leaving failed runs out would flatter the setting.
    if missing := values.count(None):
        return f"not finite in {missing} of {len(values)}"
    scores = torch.tensor(values, dtype=torch.float64)
    low, high = bootstrap_interval(scores.unsqueeze(-1))
    return f"{interquartile_mean(scores).item():.3g} [{low.item():.3g}, {high.item():.3g}]"
