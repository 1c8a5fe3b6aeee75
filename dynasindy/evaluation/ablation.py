"""Settings compared over seeds, from the files that their runs wrote.

A run lies in `root/system/experiment/setting/.../seed_N`. Two tables are made of all finished ones: a row per
run (`ablation.csv`) and a row per episode (`ablation_curves.csv`), from which the figures are drawn.

Where all outputs are angles [rad], the worse axis is judged in rad. Outputs in other units cannot be compared so: there
it is the axis with the largest error as a share of its target range, in the column `steady_state_share`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from dynasindy.limits import Positive
from dynasindy.safe_io import checked_class, escape_markdown, read_json, read_rows, reading, write_text
from dynasindy.text import format_duration

KEY = ["system", "experiment", "setting"]
TEXT = {*KEY, "commit"}
ERROR, SHARE = "steady_state_error", "steady_state_share"
TABLE, CURVES = "ablation.csv", "ablation_curves.csv"
SUMMARY = {
    "episodes_to_level": "real episodes to the level",
    "plant_seconds_to_level": "plant time to the level [s]",
    "area_under_curve": "area under the curve",
    "final_return": "final return",
    ERROR: "steady-state error [rad]",
    SHARE: "steady-state error [% of the target range]",
    "wall_seconds": "wall time [s]",
}
"""Columns of the readable table, and their words."""


@checked_class
@dataclass(frozen=True, config={"extra": "forbid"})
class Level:
    """The level that a setting has to reach, fixed before the runs.

    Attributes:
        error: Mean absolute steady-state error over the references of the scenario, on every axis [rad].
        consecutive: Evaluations in a row that hold it; the last of them is when it counts as reached.
        share: The same error of a plant whose outputs are not all in rad, as a share of the target range.
    """

    error: Annotated[float, Field(gt=0)] = 0.05
    consecutive: Positive = 3
    share: Annotated[float, Field(gt=0)] = 0.05

    def reached(self, errors: Sequence[float], shares: bool = False) -> int | None:
        """Return the place in `errors` at which the level is reached, or None.

        Args:
            errors: Error of the worse axis after each evaluation [rad].
            shares: Whether they are shares of the target range instead.
        """
        held = pd.Series(errors).le(self.share if shares else self.error).rolling(self.consecutive).sum()
        reached = held.eq(self.consecutive)
        return int(reached.argmax()) if reached.any() else None


def gather(root: Path, results: Path, level: Level) -> pd.DataFrame:
    """Write `ablation.csv`, `ablation_curves.csv` and `ablation.md` from all finished runs; nothing if there is none.

    Rows of settings that have no run in `root` stay as they are in the tables.

    Args:
        root: Folder of the runs.
        results: Folder of the tables; made if missing.
        level: The required level.

    Returns:
        The rows of `ablation.csv`; none where no run in `root` has finished.

    Raises:
        DamagedFileError: A table that is there, or what a run wrote, cannot be read; all files stay as they are.
    """
    runs = [_read_run(file.parent, root, level) for file in sorted(root.rglob("metrics.json"))]
    if not runs:
        return pd.DataFrame()
    before, curves_before = (read_ablation(results / name) for name in (TABLE, CURVES))
    rows = _merged(before, pd.DataFrame([row for row, _ in runs]))
    with reading(results / TABLE):
        text = to_markdown(rows, level)
    _write(results / CURVES, _merged(curves_before, pd.concat([curve for _, curve in runs])))
    _write(results / TABLE, rows)
    write_text(results / "ablation.md", text)
    return rows


def read_ablation(path: Path, key: Sequence[str] = KEY) -> pd.DataFrame:
    """Read a table that has the columns of a key, numbers as numbers; no file is an empty table."""
    if not path.exists():
        return pd.DataFrame(columns=list(key))
    table = pd.DataFrame(read_rows(path))
    with reading(path):
        for column in (*key, *table):
            table[column] = table[column] if column in TEXT else table[column].replace("", "nan").astype(float)
        return table


def _write(path: Path, table: pd.DataFrame) -> None:
    write_text(path, table.to_csv(index=False, float_format="%.7g", lineterminator="\n"))


def worst_errors(curve: pd.DataFrame, ranges: Mapping[str, float] | None = None) -> pd.Series[float]:
    """Return the error of the worse axis of each evaluation [rad], or with ranges the largest share of a range."""
    errors = curve.filter(like=f"evaluated_{ERROR}/").dropna(axis=1, how="all")
    if ranges:
        errors = errors / [ranges.get(name.partition("/")[2], 0.0) or math.nan for name in errors]
    return errors.max(axis=1).fillna(math.inf)


def to_markdown(rows: pd.DataFrame, level: Level) -> str:
    """Return a table of the figures over seeds, a row per setting."""
    measures = [name for name in (ERROR, SHARE) if name in rows and rows[name].notna().any()]
    columns = {name: head for name, head in SUMMARY.items() if name in measures or name not in (ERROR, SHARE)}
    most = {ERROR: f"{level.error:g} rad", SHARE: f"{100 * level.share:g} % of its target range"}
    least = ", where the outputs are not all in rad ".join(most[name] for name in measures)
    lines = [
        f"Level: mean abs steady-state error of every axis at or under {least} in {level.consecutive} "
        "evaluations in a row.",
        OVER_SEEDS,
        "The excitation counts as real experience, and evaluations do not.",
        "Steady-state error: the worse axis after the last episode. Area: the mean evaluated return.",
        "",
    ]
    cells = []
    for key, group in rows.groupby(KEY, sort=False):
        reached = f"{group['episodes_to_level'].notna().sum()}/{len(group)}"
        # Areas and final figures of different lengths are not comparable.
        lengths = " or ".join(f"{length:.0f}" for length in sorted(group["episodes"].unique()))
        commits = " or ".join(sorted(set(group["commit"].fillna("").replace("", "unknown"))))
        figures = [_cell(group[column]) for column in columns]
        cells.append([*key, str(len(group)), lengths, reached, *figures, commits])
    head = (*KEY, "seeds", "episodes", "reached", *columns.values(), "commit")
    return "\n".join([*lines, markdown(head, cells)]) + "\n"


def _cell(values: pd.Series[float]) -> str:
    if values.name in (ERROR, SHARE) and values.isna().all():
        return ""  # it is measured by the other one
    return _over_seeds((values * (100 if values.name == SHARE else 1)).tolist(), 4, "never")


def _read_run(folder: Path, root: Path, level: Level) -> tuple[dict[str, Any], pd.DataFrame]:
    with reading(folder):
        metrics, origin = read_json(folder / "metrics.json"), folder / "origin.json"
        system, experiment, *words, _ = folder.relative_to(root).parts
        setting = ",".join([*words[:1], *(word for part in words[1:] for word in overrides(part))])
        place = {"system": system, "experiment": experiment, "setting": setting, "seed": int(metrics["seed"])}
        curve = read_ablation(folder / "progress.csv", ()).dropna(subset="evaluated_return")
        if not set(metrics.get("units", {}).values()) <= {"rad"}:
            curve[SHARE] = worst_errors(curve, {name: float(extent) for name, extent in metrics["ranges"].items()})
        commit = str(read_json(origin)["commit"]) if origin.is_file() else "unknown"
        last, measure = curve.iloc[-1], SHARE if SHARE in curve else ERROR
        worst = curve[SHARE] if SHARE in curve else worst_errors(curve)
        reached = level.reached(worst.tolist(), measure == SHARE)
        at = last * math.nan if reached is None else curve.iloc[reached]
        errors = [name for name in curve if name.startswith(f"evaluated_{ERROR}/")]
        spent = ("real_steps", "updates", "imagined_transitions", "wall_seconds")
        row = {
            **place,
            "episodes": last["episode"],
            "episodes_to_level": at["episode"],
            "real_steps_to_level": at["real_steps"],
            "plant_seconds_to_level": at["plant_seconds"],
            "updates_to_level": at["updates"],
            "imagined_to_level": at["imagined_transitions"],
            "return_at_level": at["evaluated_return"],
            "area_under_curve": curve["evaluated_return"].mean(),
            "final_return": last["evaluated_return"],
            measure: worst.iloc[-1],
            **{name.removeprefix("evaluated_"): last[name] for name in (*errors, *spent)},
            "commit": commit,
        }
        return row, pd.DataFrame({**place, **curve}, index=curve.index)


def _merged(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of settings that are not new, and the new ones, in the order of settings."""
    found = {*new[KEY].itertuples(index=False, name=None)}
    kept = old[[key not in found for key in old[KEY].itertuples(index=False, name=None)]]
    return pd.concat([part for part in (kept, new) if len(part)]).sort_values(KEY, kind="stable")


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
"""What the figures of `_over_seeds` are."""
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
    kinds, axes = dict[bool, list[dict[str, Any]]](), [0]
    for file in sorted(folder.rglob("metrics.json")):
        if (file.parent / "report.txt").is_file():  # a fit by identify.py, which flew nothing
            continue
        with reading(file):
            run = read_json(file)
            # What the folders that lead to the run are named after, all but its seed and number, says its setting.
            places = (re.sub(r"^\d+(_|$)", "", part) for part in file.parent.relative_to(folder).parts)
            words = [word for part in places for word in overrides(part) if not re.match(r"seed[=_]", word)]
            row = {"setting": f"`{' '.join(words) or 'default'}`", "seed": run.get("seed") or 0, "unit": ""}
            kinds.setdefault("prediction" in run, []).append(row)
            if "prediction" in run:  # planned from a log, where no plant was moved
                flights = [flight or {"share": {"": None}} for flight in run["prediction"]["flights"]]  # it ran away
                ends = [math.inf if end is None else end for flight in flights for end in flight["share"].values()]
                row["controlled, as predicted"] = bool(run["prediction"]["controlled"])
                row["error at the end, of the worst axis on the worst model [% of the target range]"] = 100 * max(ends)
                continue
            cost, found, units = run["cost"], run["evaluation"], [*run.get("units", {"": "rad"}).values()]
            errors, rmse = ([found[k] for k in found if k.startswith(f"{m}/")] for m in ("steady_state_error", "rmse"))
            axes.append(len(rmse))
            row |= {
                "unit": f" [{' / '.join(units if len(set(units)) > 1 else units[:1])}]",
                "real steps (plant time)": f"{cost['real_steps']} ({format_duration(cost['plant_seconds'])})",
                "return, untrained": run["untrained"]["return"],
                "return, trained": found["return"],
                "steady-state error, per axis": errors,
                "RMSE, per axis": rmse,
                "wall time of a run [s]": cost["wall_seconds"],
            }
    if not kinds:
        raise FileNotFoundError(f"{folder} holds no finished run; give the folder of a sweep, which it prints")
    text = [OVER_SEEDS, f"{ORDER} {AXES}" if max(axes) > 1 else ORDER]
    with reading(folder):  # whose runs may not have the same figures
        for runs in kinds.values():
            table = pd.DataFrame(runs)
            shared = table["unit"].nunique() == 1  # plants may differ in them
            # By their folders, the tenth job is before the ninth.
            groups = table.sort_values(["setting", "seed"], kind="stable").groupby("setting", sort=False)
            columns = [name for name in table if name not in ("setting", "seed", "unit")]
            of_axes = {name: table["unit"][0] if shared and name.endswith("per axis") else "" for name in columns}
            rows = [
                [str(key), str(len(of)), *(_figure(of, name, not shared) for name in columns)] for key, of in groups
            ]
            text += ["", markdown(["setting", "seeds", *(name + of_axes[name] for name in columns)], rows)]
    return "\n".join(text)


def _figure(runs: pd.DataFrame, name: str, with_unit: bool) -> str:
    """Return the cell of a setting: over seeds, where it has one for each axis with a slash between these."""
    values = runs[name].tolist()
    if isinstance(values[0], str):
        return values[0]
    if isinstance(values[0], bool):
        return f"{sum(values)} of {len(values)}"
    if not isinstance(values[0], list):
        return _over_seeds(values)
    cells = " / ".join(_over_seeds(axis) for axis in zip(*values, strict=True))
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


def _over_seeds(values: Sequence[float | None], digits: int = 3, infinite: str = "not finite") -> str:
    """Return the interquartile mean over seeds and the 95 % interval of its bootstrap, `middle [low, high]`.

    Fewer than three seeds give no interval: each stands for itself, `first, second`. What is no finite number counts as
    infinite, as to leave it out would flatter the setting.
    """
    scores = torch.tensor([math.nan if value is None else value for value in values], dtype=torch.float64)
    scores = scores.nan_to_num(HUGE, HUGE, HUGE)
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
