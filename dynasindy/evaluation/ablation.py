"""Settings compared over seeds, from the files that their runs wrote.

A run lies in `root/system/experiment/setting/.../seed_N`. Two tables are made of all finished ones: a row per
run (`ablation.csv`) and a row per episode (`ablation_curves.csv`), from which the figures are drawn.

Where all outputs are angles [rad], the worse axis is judged in rad. Outputs in other units cannot be compared so: there
it is the axis with the largest error as a share of its target range, in the column `steady_state_share`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field
from pydantic.dataclasses import dataclass

from dynasindy.evaluation.statistics import OVER_SEEDS, markdown, over_seeds, overrides
from dynasindy.limits import Positive
from dynasindy.safe_io import DamagedFileError, checked_class, read_json, read_rows, reading, write_text

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
    before, curves_before = read_tables(results)
    rows = _merged(before, pd.DataFrame([row for row, _ in runs]))
    with reading(results / TABLE):
        text = to_markdown(rows, level)
    _write(results / CURVES, _merged(curves_before, pd.concat([curve for _, curve in runs])))
    _write(results / TABLE, rows)
    write_text(results / "ablation.md", text)
    return rows


def read_tables(results: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return `ablation.csv` and `ablation_curves.csv`, without rows where there is no such file.

    Raises:
        DamagedFileError: One of them cannot be read; the message says how it can be made anew.
    """
    try:
        return read_ablation(results / TABLE), read_ablation(results / CURVES)
    except DamagedFileError as error:
        raise DamagedFileError(
            f"{error}. To make it again, move it to another place and give the same command: finished runs are not "
            "repeated, and their rows are written anew"
        ) from error


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
    """Write a table whole and at once."""
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
    """Return a figure over seeds; a run that never reached the level counts as infinite."""
    if values.name in (ERROR, SHARE) and values.isna().all():
        return ""  # it is measured by the other one
    return over_seeds((values * (100 if values.name == SHARE else 1)).fillna(math.inf).tolist(), 4, "never")


def _read_run(folder: Path, root: Path, level: Level) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the row of a run and its evaluated episodes."""
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
