"""Statistics over seeds, and Markdown tables of runs: interquartile means with bootstrap intervals."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

from dynasindy.safe_io import escape_markdown, read_json, reading
from dynasindy.text import format_duration


def interquartile_mean(values: Tensor) -> Tensor:
    """Return the mean of the middle half of the last dimension, `(*batch, n)` to `(*batch,)`.

    As in the source, `floor(n / 4)` values are dropped at each end: up to three values give their mean.
    """
    n = values.shape[-1]
    drop = n // 4
    return values.sort(dim=-1).values[..., drop : n - drop].mean(-1)


def bootstrap_interval(scores: Tensor, resamples: int = 2000, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Return the 95 % percentile bootstrap interval of the interquartile mean over seeds, each end `(*batch,)`.

    Args:
        scores: `(*batch, n_seeds)`, drawn with replacement.
        resamples: number of bootstrap resamples.
        seed: seed of the resampling, kept apart from torch's global generator.
    """
    n = scores.shape[-1]
    draws = torch.randint(n, (resamples, n), generator=torch.Generator().manual_seed(seed))
    estimates = interquartile_mean(scores[..., draws]).double()
    low, high = torch.quantile(estimates, torch.tensor([0.025, 0.975], dtype=torch.double), dim=-1)
    return low.to(scores), high.to(scores)


HUGE = 1e30  # stands for infinity in the bootstrap, which interpolates between resamples
FEWEST = 3
"""Seeds from which on an interval says something; fewer are shown one by one."""
OVER_SEEDS = (
    "Interquartile mean over seeds [95 % bootstrap interval]; where there are fewer than three seeds, the value of "
    "each."
)
"""What the figures of `over_seeds` are."""
ORDER, AXES = "Values of single seeds stand in the order of the seeds.", "A slash parts the axes."
"""How a cell with several values is read."""


def sweep_table(folder: Path) -> str:
    """Return a Markdown table of a sweep, a row per setting, over its seeds, below lines that say what its figures are.

    Args:
        folder: Folder of the sweep, whose runs are named `number_key-value__key-value` by Hydra; or of an ablation or a
            part of it, in which a run lies in `system/experiment/setting/key-value/seed_N`.

    Raises:
        FileNotFoundError: No run of the folder has ended, or it is one run.
        DamagedFileError: What a run wrote cannot be read.
    """
    if (folder / "metrics.json").is_file():
        raise FileNotFoundError(f"{folder} is one run, not a sweep of runs; give the folder above it")
    runs, axes = [], [0]
    for file in sorted(folder.rglob("metrics.json")):
        if (file.parent / "report.txt").is_file():  # a fit by identify.py, which flew nothing
            continue
        with reading(file):
            run = read_json(file)
            cost, found, units = run["cost"], run["evaluation"], [*run.get("units", {"": "rad"}).values()]
            errors, rmse = ([found[k] for k in found if k.startswith(f"{m}/")] for m in ("steady_state_error", "rmse"))
            axes.append(len(rmse))
            # What the folders that lead to the run are named after, all but its seed and number, says its setting.
            places = (re.sub(r"^\d+(_|$)", "", part) for part in file.parent.relative_to(folder).parts)
            words = [word for part in places for word in overrides(part) if not re.match(r"seed[=_]", word)]
            runs.append(
                {
                    "setting": f"`{' '.join(words) or 'default'}`",
                    "seed": run.get("seed") or 0,
                    "unit": f" [{' / '.join(units if len(set(units)) > 1 else units[:1])}]",
                    "real steps (plant time)": f"{cost['real_steps']} ({format_duration(cost['plant_seconds'])})",
                    "return, untrained": run["untrained"]["return"],
                    "return, trained": found["return"],
                    "steady-state error, per axis": errors,
                    "RMSE, per axis": rmse,
                    "wall time of a run [s]": cost["wall_seconds"],
                }
            )
    if not runs:
        raise FileNotFoundError(f"{folder} holds no finished run; give the folder of a sweep, which it prints")
    with reading(folder):  # whose runs may not have the same figures
        table = pd.DataFrame(runs)
        shared = table["unit"].nunique() == 1  # plants may differ in them
        # By their folders, the tenth job is before the ninth.
        groups = table.sort_values(["setting", "seed"], kind="stable").groupby("setting", sort=False)
        columns = [name for name in table if name not in ("setting", "seed", "unit")]
        of_axes = {name: table["unit"][0] if shared and name.endswith("per axis") else "" for name in columns}
        rows = [[str(key), str(len(of)), *(_figure(of, name, not shared) for name in columns)] for key, of in groups]
        text = markdown(["setting", "seeds", *(name + of_axes[name] for name in columns)], rows)
        return "\n".join([OVER_SEEDS, f"{ORDER} {AXES}" if max(axes) > 1 else ORDER, "", text])


def _figure(runs: pd.DataFrame, name: str, with_unit: bool) -> str:
    """Return the cell of a setting: over seeds, where it has one for each axis with a slash between these."""
    values = runs[name].tolist()
    if isinstance(values[0], str):
        return values[0]
    if not isinstance(values[0], list):
        return _finite(values)
    cells = " / ".join(_finite(axis) for axis in zip(*values, strict=True))
    return cells + (runs["unit"].iloc[0] if with_unit else "")


def overrides(name: str) -> list[str]:
    """Return what a folder was named after, `["key=value", ...]`: `key-value__key-value` or `key=value,key=value`."""
    words = [word for word in re.split(r"__|,", name) if word]
    # No key holds a dash, but a value may: 1e-3.
    return [word if "=" in word else word.replace("-", "=", 1) for word in words]


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, without a final line break; a cell ends and begins nothing but itself."""
    lines = (header, ["---"] * len(header), *rows)
    return "\n".join(
        "| " + " | ".join(escape_markdown(cell).replace("|", r"\|") for cell in cells) + " |" for cells in lines
    )


def over_seeds(values: Sequence[float], digits: int = 3, infinite: str = "inf") -> str:
    """Return the interquartile mean over seeds and the 95 % interval of its bootstrap, `middle [low, high]`.

    Fewer than three seeds give no interval: each stands for itself, `first, second`.

    Args:
        values: A number per seed; it may be infinite.
        digits: Significant digits.
        infinite: Word for infinity.
    """
    scores = torch.tensor(list(values), dtype=torch.float64).nan_to_num(posinf=HUGE)
    if len(scores) < FEWEST:
        return ", ".join(_short(score, digits, infinite) for score in scores.tolist())
    numbers = (interquartile_mean(scores), *bootstrap_interval(scores))
    middle, low, high = (_short(n.item(), digits, infinite) for n in numbers)
    return f"{middle} [{low}, {high}]"


def _short(value: float, digits: int, infinite: str) -> str:
    if value > 1e-3 * HUGE:
        return infinite
    # What rounds up to a power of ten would be written as 1e+03.
    return f"{value:.0f}" if abs(value) >= 10**digits - 0.5 else f"{value:.{digits}g}"


def _finite(values: Sequence[float | None]) -> str:
    """Return the figure over seeds, or how many runs have no number: leaving them out would flatter the setting."""
    found = [value for value in values if value is not None and math.isfinite(value)]
    missing = len(values) - len(found)
    return f"not finite in {missing} of {len(values)}" if missing else over_seeds(found)
