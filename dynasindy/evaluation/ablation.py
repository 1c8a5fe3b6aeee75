"""Settings compared over seeds, from the files that their runs wrote.

A run lies in `root/system/experiment/setting/.../seed_N`. Two tables are made of all finished ones: a row per
run (`ablation.csv`) and a row per episode (`ablation_curves.csv`), from which the figures are drawn.

Where all outputs are angles [rad], the worse axis is judged in rad. Outputs in other units cannot be compared so: there
it is the axis with the largest error as a share of its target range, in the column `steady_state_share`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynasindy import safe_io
from dynasindy.evaluation.statistics import OVER_SEEDS, markdown, over_seeds, overrides
from dynasindy.safe_io import DamagedFileError, read_cells, read_json, reading, write_text

Row = dict[str, str | float | None]
KEY = ("system", "experiment", "setting")
TEXT = (*KEY, "commit")
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


@dataclass(frozen=True)
class Level:
    """The level that a setting has to reach, fixed before the runs.

    Attributes:
        error: Mean absolute steady-state error over the references of the scenario, on every axis [rad].
        consecutive: Evaluations in a row that hold it; the last of them is when it counts as reached.
        share: The same error of a plant whose outputs are not all in rad, as a share of the target range.

    Raises:
        ValueError: `error`, `consecutive` or `share` is not positive.
    """

    error: float = 0.05
    consecutive: int = 3
    share: float = 0.05

    def __post_init__(self) -> None:
        if not self.error > 0 or self.consecutive < 1 or not self.share > 0:
            raise ValueError(
                f"level has error={self.error}, consecutive={self.consecutive}, share={self.share}; give an error > 0 "
                "rad and a count >= 1, and a share of the target range > 0"
            )

    def reached(self, errors: Sequence[float], shares: bool = False) -> int | None:
        """Return the place in `errors` at which the level is reached, or None.

        Args:
            errors: Error of the worse axis after each evaluation [rad].
            shares: Whether they are shares of the target range instead.
        """
        held, most = 0, self.share if shares else self.error
        for place, error in enumerate(errors):
            held = held + 1 if error <= most else 0
            if held == self.consecutive:
                return place
        return None


def gather(root: Path, results: Path, level: Level) -> list[Row]:
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
        return []
    before, curves_before = read_tables(results)
    rows = _merged(before, [row for row, _ in runs])
    with reading(results / TABLE):
        text = to_markdown(rows, level)
    write_ablation(results / CURVES, _merged(curves_before, [line for _, lines in runs for line in lines]))
    write_ablation(results / TABLE, rows)
    write_text(results / "ablation.md", text)
    return rows


def read_tables(results: Path) -> tuple[list[Row], list[Row]]:
    """Return the rows of `ablation.csv` and of `ablation_curves.csv`, none where there is no such file.

    Raises:
        DamagedFileError: One of them cannot be read; the message says how it can be made anew.
    """
    return _read_table(results / TABLE), _read_table(results / CURVES)


def _summarise_run(curve: Sequence[Mapping[str, float | None]], level: Level) -> Row:
    """Return what one run came to.

    Args:
        curve: Its evaluated episodes in order, as `progress.csv` has them; with `steady_state_share` where outputs are
            not all in rad.
        level: The required level.
    """
    last = curve[-1]
    shares = SHARE in last
    worst = [_number(line[SHARE]) or 0.0 if shares else _worst(line) for line in curve]
    place = level.reached(worst, shares)
    at = {} if place is None else curve[place]
    returns = [line["evaluated_return"] or 0.0 for line in curve]
    row: Row = {
        "episodes": last["episode"],
        "episodes_to_level": at.get("episode"),
        "real_steps_to_level": at.get("real_steps"),
        "plant_seconds_to_level": at.get("plant_seconds"),
        "updates_to_level": at.get("updates"),
        "imagined_to_level": at.get("imagined_transitions"),
        "return_at_level": at.get("evaluated_return"),
        "area_under_curve": sum(returns) / len(returns),
        "final_return": last["evaluated_return"],
        (SHARE if shares else ERROR): worst[-1],
    }
    prefix = f"evaluated_{ERROR}/"
    row |= {key.removeprefix("evaluated_"): value for key, value in last.items() if key.startswith(prefix)}
    return row | {key: last[key] for key in ("real_steps", "updates", "imagined_transitions", "wall_seconds")}


def to_markdown(rows: Iterable[Row], level: Level) -> str:
    """Return a table of the figures over seeds, a row per setting."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(_key(row), []).append(row)
    measures = [name for name in (ERROR, SHARE) if any(_given(row, name) for group in groups.values() for row in group)]
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
    for key, group in groups.items():
        reached = sum(row["episodes_to_level"] is not None for row in group)
        figures = [_cell(column, group) for column in columns]
        commits = " or ".join(sorted({str(row.get("commit") or "unknown") for row in group}))
        cells.append([*key, str(len(group)), _lengths(group), f"{reached}/{len(group)}", *figures, commits])
    head = (*KEY, "seeds", "episodes", "reached", *columns.values(), "commit")
    return "\n".join([*lines, markdown(head, cells)]) + "\n"


def errors_in_words(metrics: Mapping[str, Any]) -> str:
    """Return the steady-state error of each output of a run in its unit, `0.01 / 0.02 rad` or `0.2 rad / 1.5 m/s`.

    Args:
        metrics: What its `metrics.json` holds.
    """
    found, units = metrics["evaluation"], metrics["units"]
    errors = {name: found.get(f"{ERROR}/{name}") for name in units}
    words = {name: "not finite" if error is None else f"{error:.3g}" for name, error in errors.items()}
    if len(set(units.values())) == 1:
        return f"{' / '.join(words.values())} {next(iter(units.values()))}"
    return " / ".join(f"{word} {units[name]}" for name, word in words.items()) or "of no output"


def read_ablation(path: Path) -> list[Row]:
    """Read a table, numbers as numbers and empty cells as None; no file is an empty table."""
    if not path.exists():
        return []
    header, rows = read_cells(path)
    with reading(path):
        return [{key: _value(key, cell) for key, cell in zip(header, row)} for row in rows]


def write_ablation(path: Path, rows: Sequence[Row]) -> None:
    """Write a table whole, with the columns of all rows, and at once."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    cells = [{k: f"{v:.7g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows]
    safe_io.write_rows(path, columns, cells)


def _read_table(path: Path) -> list[Row]:
    try:
        with reading(path):
            rows = read_ablation(path)
            for row in rows:
                _key(row)  # what it lacks is told here
    except DamagedFileError as error:
        raise DamagedFileError(
            f"{error}. To make it again, move it to another place and give the same command: finished runs are not "
            "repeated, and their rows are written anew"
        ) from error
    return rows


def _read_run(folder: Path, root: Path, level: Level) -> tuple[Row, list[Row]]:
    """Return the row of a run and those of its evaluated episodes."""
    with reading(folder):
        place, curve = _place(folder, root), _curve(folder)
        if ranges := _ranges(folder):
            curve = [{**line, SHARE: _worst(line, ranges)} for line in curve]
        row = {**place, **_summarise_run(curve, level), "commit": _commit(folder)}
        return row, [{**place, **line} for line in curve]


def _place(folder: Path, root: Path) -> Row:
    system, experiment, *setting, _ = folder.relative_to(root).parts
    seed = read_json(folder / "metrics.json")["seed"]
    name = ",".join([*setting[:1], *(word for part in setting[1:] for word in overrides(part))])
    return {"system": system, "experiment": experiment, "setting": name, "seed": int(seed)}


def _commit(folder: Path) -> str:
    """Return the commit that made a run."""
    origin = folder / "origin.json"
    return str(read_json(origin)["commit"]) if origin.is_file() else "unknown"


def _curve(folder: Path) -> list[dict[str, float | None]]:
    """Return the evaluated rows of a run's `progress.csv`."""
    rows = [{key: _number(value) for key, value in row.items()} for row in read_ablation(folder / "progress.csv")]
    return [row for row in rows if row["evaluated_return"] is not None]


def _merged(old: Sequence[Row], new: Sequence[Row]) -> list[Row]:
    found = {_key(row) for row in new}
    kept = [row for row in old if _key(row) not in found]
    return sorted([*kept, *new], key=_key)


def _key(row: Row) -> tuple[str, ...]:
    return tuple(str(row[key]) for key in KEY)


def _ranges(folder: Path) -> dict[str, float]:
    """Return the target range of each output, in its unit; none where all outputs are in rad."""
    metrics = read_json(folder / "metrics.json")
    if set(metrics.get("units", {}).values()) <= {"rad"}:
        return {}
    if "ranges" in metrics:
        return {name: float(extent) for name, extent in metrics["ranges"].items()}
    # Older runs have the error at the end in its own unit and as a share of the range.
    shares, errors = metrics["held"]["share"], metrics["evaluation"]
    return {name: float(errors[f"{ERROR}/{name}"]) / share for name, share in shares.items() if share}


def _worst(line: Mapping[str, float | None], ranges: Mapping[str, float] | None = None) -> float:
    """Return the error of the worse axis [rad], or with ranges the largest share of a range."""
    prefix = f"evaluated_{ERROR}/"
    errors = {key.removeprefix(prefix): v for key, v in line.items() if key.startswith(prefix) and v is not None}
    shares = [error / (ranges.get(name, 0.0) or math.nan) if ranges else error for name, error in errors.items()]
    return max((math.inf if math.isnan(share) else share for share in shares), default=math.inf)


def _lengths(group: Iterable[Row]) -> str:
    """Return how many episodes the runs had: areas and final figures of different lengths are not comparable."""
    lengths = sorted({int(_number(row["episodes"]) or 0) for row in group})
    return " or ".join(map(str, lengths))


def _cell(column: str, group: Sequence[Row]) -> str:
    """Return the figure over seeds; a run that never reached the level counts as infinite."""
    if column in (ERROR, SHARE) and not any(_given(row, column) for row in group):
        return ""  # it is measured by the other one
    found = [math.inf if (n := _number(row.get(column))) is None else n for row in group]
    return over_seeds([100 * n if column == SHARE else n for n in found], 4, "never")


def _given(row: Row, column: str) -> bool:
    return row.get(column) is not None


def _number(value: str | float | None) -> float | None:
    return None if value is None else float(value)


def _value(key: str, cell: str) -> str | float | None:
    if key in TEXT:
        return cell
    return float(cell) if cell else None
