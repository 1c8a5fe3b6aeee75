"""Small copies of finished runs, kept beside the results: what figures and tables need, and nothing of the machine.

Weights of policies stay behind. Tables over time are thinned to a row per `SPACING`, logs of episodes to `ROWS` rows,
and numbers to `DIGITS` digits.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

ROWS, DIGITS = 250, 5
SPACING = {"data": 0.1, "evaluation": 0.2}
"""Time between two rows of the tables in a folder of a run [s]; the excitation stays whole."""
PROGRESS = ("progress.csv", "gate.csv")
RECORDS = ("metrics.json", "model.json")


def to_save(folder: Path, name: str | None, seed: int, settings: Sequence[str]) -> dict[Path, str]:
    """Return run folders and the names of their copies.

    Args:
        folder: One run, or the folder of an ablation.
        name: Of the copy of one run; that of its folder by default.
        seed: Which runs of an ablation are meant; their copies are named by plant, experiment and setting.
        settings: Which settings of an ablation are meant.

    Raises:
        FileNotFoundError: There is no such run that ended.
    """
    if (folder / "config.yaml").is_file():
        return {folder: name or folder.name}
    ended = sorted(file.parent for file in folder.rglob(f"seed_{seed}/metrics.json"))
    found = {run: "_".join(run.relative_to(folder).parts[:-1]) for run in ended if run.parent.name in settings}
    if not found:
        raise FileNotFoundError(
            f"{folder} holds no finished run of seed {seed} in {list(settings)}; give a run folder, or runs/ablation"
        )
    return found


def keep_run(source: Path, target: Path, model: bool = True) -> list[Path]:
    """Copy what a report needs of a finished run.

    Args:
        source: Run folder, with `evaluation/` where `evaluate.py` was run.
        target: Folder of the copy; replaced as a whole.
        model: Keep what the model was fitted to and what it predicted, too.

    Returns:
        The files of the copy.

    Raises:
        FileNotFoundError: The run did not end.
    """
    if not (source / "metrics.json").is_file() or not (source / "config.yaml").is_file():
        raise FileNotFoundError(f"{source} is no finished run, it lacks config.yaml or metrics.json; let it end first")
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    (target / "config.yaml").write_text(without_machine((source / "config.yaml").read_text()))
    _write_json(target / "origin.json", origin_without_machine(source))
    for name in RECORDS:
        if (source / name).is_file():
            _write_json(target / name, json.loads((source / name).read_text()))
    for name in PROGRESS:
        if (source / name).is_file():
            _thin_log(source / name, target / name)
    response = source / "data" / "step_response.csv"
    spare = _spare(response)
    _thin_series(response, target / "data" / response.name, [name for name in spare if not name.startswith("u")])
    for file in sorted(source.glob("data/*.csv")) if model else ():
        if file != response:
            _thin_series(file, target / "data" / file.name)
    for file in sorted(source.glob("evaluation/*.csv")):
        if file.name != "step.csv":  # it is the step response
            _thin_series(file, target / "evaluation" / file.name, spare)
    for file in source.glob("evaluation/*.json"):
        _write_json(target / file.relative_to(source), json.loads(file.read_text()))
    return sorted(file for file in target.rglob("*") if file.is_file())


def origin_without_machine(folder: Path) -> dict[str, str]:
    """Return which command and commit made a run, without paths of the machine; "unknown" where it does not say."""
    file = folder / "origin.json"
    if not file.is_file():
        return {"command": "unknown", "commit": "unknown"}
    origin = json.loads(file.read_text())
    words = [word for word in origin["command"].split() if not re.search(r"=/|^(hydra\.run\.dir|folder)=", word)]
    return {**origin, "command": " ".join(words)}


def without_machine(settings: str) -> str:
    """Return a configuration without the lines that hold a path of the machine or the run's own folder."""
    lines = settings.splitlines(keepends=True)
    return "".join(line for line in lines if not re.match(r"(folder|results):|\s*[\w.]+: ['\"]?(/|~|\w:\\)", line))


def _spare(response: Path) -> list[str]:
    """Return the columns of a tracking table that no figure of a wave shows: inputs, and states without a reference."""
    names = [_name(heading) for heading in _read(response)[0]]
    kept = {name for name in names if name.startswith("reference_") or f"reference_{name}" in names}
    return [name for name in names if name not in kept | {"time"}]


def _name(heading: str) -> str:
    """Return the name in a heading such as `alpha_a [rad]`."""
    return heading.partition(" [")[0]


def _thin_log(source: Path, target: Path) -> None:
    """Copy a table with a row per episode: its first row, its last, and about `ROWS` evenly spaced ones."""
    header, *rows = _read(source)
    every = -(-len(rows) // ROWS)
    _write(target, header, [rows[place] for place in sorted({0, *range(len(rows) - 1, -1, -max(every, 1))})])


def _thin_series(source: Path, target: Path, drop: Sequence[str] = ()) -> None:
    """Copy a table over time without some columns, a row per `SPACING`."""
    header, *rows = _read(source)
    times = [float(row[0]) for row in rows[:2]]
    spacing = 0.0 if source.stem == "excitation" else SPACING[target.parent.name]
    every = max(1, round(spacing / (times[-1] - times[0]))) if len(rows) > 1 else 1
    columns = [k for k, heading in enumerate(header) if _name(heading) not in drop]
    _write(target, [header[k] for k in columns], [[row[k] for k in columns] for row in rows[::every]])


def _read(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


def _write(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([[_short(cell) for cell in row] for row in rows])


def _short(cell: str) -> str:
    if not cell or float(cell).is_integer():
        return cell
    return f"{float(cell):.{DIGITS}g}"


def _write_json(path: Path, record: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1) + "\n")
