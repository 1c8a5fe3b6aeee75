"""Small copies of finished runs, kept beside the results: what figures and tables need, and nothing of the machine.

Weights of policies stay behind. Tables over time are thinned to a row per `SPACING`, logs of episodes to `ROWS` rows,
and numbers to `DIGITS` digits.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from dynasindy.safe_io import (
    DamagedFileError,
    file_name,
    read_cells,
    read_json,
    read_text,
    reading,
    write_cells,
    write_json,
    write_text,
)

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
        ValueError: A name is more than one plain component of a path, or two runs have it.
    """
    if (folder / "config.yaml").is_file():
        return {folder: file_name(folder.resolve().name if name is None else name, "name")}
    ended = sorted(file.parent for file in folder.rglob(f"seed_{seed}/metrics.json"))
    found = {run: "_".join(run.relative_to(folder).parts[:-1]) for run in ended if run.parent.name in settings}
    if not found:
        raise FileNotFoundError(
            f"{folder} holds no finished run of seed {seed} in {list(settings)}; give a run folder, or runs/ablation"
        )
    if len(set(found.values())) < len(found):
        twice = next(name for name in found.values() if list(found.values()).count(name) > 1)
        raise ValueError(f"two runs in {folder} would be saved as {twice}; save one of them by save=RUN name=NAME")
    return {run: file_name(name, "folder") for run, name in found.items()}


def check_copy(source: Path, target: Path, any_commit: bool = False) -> None:
    """Refuse a copy that would be of no use, or would stand where something else is.

    Args:
        source: Run folder.
        target: Folder of the copy.
        any_commit: Whether a run may be saved whose code was not committed.

    Raises:
        FileNotFoundError: The run did not end.
        ValueError: The run holds links; its commit is not known or lacks changes; or there is something in the place of
            the copy.
    """
    if not (source / "metrics.json").is_file() or not (source / "config.yaml").is_file():
        raise FileNotFoundError(f"{source} is no finished run, it lacks config.yaml or metrics.json; let it end first")
    if links := [path for path in sorted(source.rglob("*")) if path.is_symlink()]:
        raise ValueError(f"{links[0]} is a link, and may lead anywhere; put the file itself there, or remove it")
    if target.exists() or target.is_symlink():
        raise ValueError(f"{target}, where the copy would go, is there; move it away, or give another name=NAME")
    if source.resolve() in target.resolve().parents:
        raise ValueError(f"the copy {target} would lie in its run {source}; give another folder by results=")
    origin = _origin_without_machine(source)
    made_at = [str(origin[key]) for key in ("commit", "resumed_at_commit") if key in origin]
    commit = next((c for c in made_at if c in ("", "unknown") or c.endswith("-dirty")), None)
    if not any_commit and commit is not None:
        raise ValueError(
            f"{source} was made at commit '{commit}', so that nobody can make it again exactly; commit, run it once "
            "more, and save that, or give any_commit=true"
        )


def keep_run(source: Path, target: Path, model: bool = True, any_commit: bool = False) -> list[Path]:
    """Copy what a report needs of a finished run.

    Args:
        source: Run folder, with `evaluation/` where `evaluate.py` was run.
        target: Folder of the copy.
        model: Keep what the model was fitted to and what it predicted, too.
        any_commit: Save a run too whose code was not committed.

    Returns:
        The files of the copy.

    Raises:
        FileNotFoundError: The run did not end.
        ValueError: A file of the run is damaged, or `check_copy` refuses.
    """
    check_copy(source, target, any_commit)
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:  # a copy that fails leaves nothing
        _copy(source, aside / "new", model)
        (aside / "new").rename(target)
    finally:
        shutil.rmtree(aside)
    return sorted(file for file in target.rglob("*") if file.is_file())


def _copy(source: Path, target: Path, model: bool) -> None:
    """Write the copy of a run into a new folder."""
    write_text(target / "config.yaml", _without_machine(read_text(source / "config.yaml")))
    write_json(target / "origin.json", _origin_without_machine(source), indent=1, finite=False)
    for file in (*(source / name for name in RECORDS), *source.glob("evaluation/*.json")):
        if file.is_file():
            write_json(target / file.relative_to(source), read_json(file), indent=1, finite=False)
    for name in PROGRESS:
        if (source / name).is_file():
            _thin(source / name, target / name, 0.0)
    tables = sorted(source.glob("data/*.csv" if model else "data/step_response.csv"))
    for file in (*tables, *sorted(source.glob("evaluation/*.csv"))):
        if file.relative_to(source).as_posix() != "evaluation/step.csv":  # it is the step response
            spacing = 0.0 if file.stem == "excitation" else SPACING[file.parent.name]
            _thin(file, target / file.relative_to(source), spacing)


def _origin_without_machine(folder: Path) -> dict[str, str]:
    """Return which command and commit made a run, without paths of the machine; "unknown" where it does not say."""
    file = folder / "origin.json"
    if not file.is_file():
        return {"command": "unknown", "commit": "unknown"}
    with reading(file):
        origin = read_json(file)
        words = [word for word in origin["command"].split() if not re.search(r"=/|^(hydra\.run\.dir|folder)=", word)]
        if not isinstance(origin["commit"], str):
            raise DamagedFileError(f"{file} is damaged (its commit is no text); restore it, or make it again")
        return {**origin, "command": " ".join(words)}


def _without_machine(settings: str) -> str:
    """Return a configuration without the lines that hold a path of the machine or the run's own folder."""
    lines = settings.splitlines(keepends=True)
    return "".join(line for line in lines if not re.match(r"(folder|results):|\s*[\w.]+: ['\"]?(/|~|\w:\\)", line))


def _thin(source: Path, target: Path, spacing: float) -> None:
    """Copy a table: a row per spacing [s] of one over time, and of one over episodes about `ROWS`, the ends among them.

    A spacing of 0 keeps all rows of a table over time.
    """
    header, rows = read_cells(source)
    with reading(source):
        if target.name in PROGRESS:
            every = max(1, -(-len(rows) // ROWS))
            rows = [rows[place] for place in sorted({0, *range(len(rows) - 1, -1, -every)})]
        elif len(rows) > 1:
            rows = rows[:: max(1, round(spacing / (float(rows[1][0]) - float(rows[0][0]))))]
        write_cells(target, header, [[_short(cell) for cell in row] for row in rows])


def _short(cell: str) -> str:
    if not cell or float(cell).is_integer():
        return cell
    return f"{float(cell):.{DIGITS}g}"
