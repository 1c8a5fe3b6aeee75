"""Small copies of finished runs, kept beside the results: what figures and tables need, and nothing of the machine.

Weights of policies stay behind. Tables over time are thinned to a row per `SPACING`, logs of episodes to `ROWS` rows,
and numbers to `DIGITS` digits.
"""

from __future__ import annotations

import os
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
COPIED = re.compile(
    r"(config\.yaml|origin\.json|metrics\.json|model\.json|progress\.csv|gate\.csv|data/[^/]+\.csv|evaluation/[^/]+\.(csv|json))"
)
"""Files of a copy, from its folder."""


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
        ValueError: The run holds links, is a copy itself or lies in the target or around it; its commit is not known or
            lacks changes; or the target is no copy that `keep_run` wrote.
    """
    if not (source / "metrics.json").is_file() or not (source / "config.yaml").is_file():
        raise FileNotFoundError(f"{source} is no finished run, it lacks config.yaml or metrics.json; let it end first")
    here, there = source.resolve(), target.resolve()
    if here == there or here in there.parents or there in here.parents:
        raise ValueError(f"{source} and its copy {target} would lie in each other; give a run outside the saved ones")
    if _is_copy(source):
        raise ValueError(f"{source} is a saved copy already, from which nothing is left out; give the run itself")
    if links := [path for path in sorted(source.rglob("*")) if path.is_symlink()]:
        raise ValueError(f"{links[0]} is a link, and may lead anywhere; put the file itself there, or remove it")
    if (target.exists() or target.is_symlink()) and not _is_copy(target):
        raise ValueError(f"{target} is there and is no saved copy of a run; move it away, or give another name=NAME")
    origin = _origin_without_machine(source)
    made_at = [str(origin[key]) for key in ("commit", "resumed_at_commit") if key in origin]
    commit = next((c for c in made_at if c in ("", "unknown") or c.endswith("-dirty")), None)
    if not any_commit and commit is not None:
        if commit.endswith("-dirty"):
            why, instead = f"at commit '{commit}'", "commit, run it once more, and save that, or give any_commit=true"
        else:
            why, instead = "by code whose commit is unknown, as that of an installed package", "give any_commit=true"
        raise ValueError(f"{source} was made {why}, so that nobody can make it again exactly; {instead}")


def _is_copy(folder: Path) -> bool:
    """Return whether a folder holds a saved copy of a run and nothing else, so that nothing is lost with it."""
    if folder.is_symlink() or not all((folder / name).is_file() for name in ("config.yaml", "origin.json")):
        return False
    found = [path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()]
    if any(path.is_symlink() or not COPIED.fullmatch(path.relative_to(folder).as_posix()) for path in found):
        return False
    settings = read_text(folder / "config.yaml")  # that of a run holds its folder, which a copy leaves out
    return settings == _without_machine(settings)


def keep_run(source: Path, target: Path, model: bool = True, any_commit: bool = False) -> list[Path]:
    """Copy what a report needs of a finished run: aside first, then in place of an older copy.

    Args:
        source: Run folder, with `evaluation/` where `evaluate.py` was run.
        target: Folder of the copy; an older copy there is replaced as a whole, anything else is left alone.
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
    try:
        copy = aside / "new"
        _copy(source, copy, model)
        try:
            if target.exists():
                os.rename(target, aside / "old")
            os.rename(copy, target)
        except BaseException:  # a signal too: what is aside is removed below
            if (aside / "old").exists() and not target.exists():
                os.rename(aside / "old", target)
            raise
    finally:
        shutil.rmtree(aside)
    return sorted(file for file in target.rglob("*") if file.is_file())


def _copy(source: Path, target: Path, model: bool) -> None:
    """Write the copy of a run into a new folder."""
    target.mkdir()
    write_text(target / "config.yaml", _without_machine(read_text(source / "config.yaml")))
    write_json(target / "origin.json", _origin_without_machine(source), indent=1, finite=False)
    for name in RECORDS:
        if (source / name).is_file():
            write_json(target / name, read_json(source / name), indent=1, finite=False)
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
        write_json(target / file.relative_to(source), read_json(file), indent=1, finite=False)


def _origin_without_machine(folder: Path) -> dict[str, str]:
    """Return which command and commit made a run, without paths of the machine; "unknown" where it does not say.

    Raises:
        DamagedFileError: It says something else.
    """
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


def _spare(response: Path) -> list[str]:
    """Return the columns of a tracking table that no figure of a wave shows: inputs, and states without a reference."""
    names = [_name(heading) for heading in read_cells(response)[0]]
    kept = {name for name in names if name.startswith("reference_") or f"reference_{name}" in names}
    return [name for name in names if name not in kept | {"time"}]


def _name(heading: str) -> str:
    """Return the name in a heading such as `alpha_a [rad]`."""
    return heading.partition(" [")[0]


def _thin_log(source: Path, target: Path) -> None:
    """Copy a table with a row per episode: its first row, its last, and about `ROWS` evenly spaced ones."""
    header, rows = read_cells(source)
    every = -(-len(rows) // ROWS)
    with reading(source):
        thinned = [rows[place] for place in sorted({0, *range(len(rows) - 1, -1, -max(every, 1))})]
        write_cells(target, header, [[_short(cell) for cell in row] for row in thinned])


def _thin_series(source: Path, target: Path, drop: Sequence[str] = ()) -> None:
    """Copy a table over time without some columns, a row per `SPACING`."""
    header, rows = read_cells(source)
    spacing = 0.0 if source.stem == "excitation" else SPACING[target.parent.name]
    with reading(source):
        times = [float(row[0]) for row in rows[:2]]
        every = max(1, round(spacing / (times[-1] - times[0]))) if len(rows) > 1 else 1
        columns = [k for k, heading in enumerate(header) if _name(heading) not in drop]
        thinned = [[_short(row[k]) for k in columns] for row in rows[::every]]
        write_cells(target, [header[k] for k in columns], thinned)


def _short(cell: str) -> str:
    if not cell or float(cell).is_integer():
        return cell
    return f"{float(cell):.{DIGITS}g}"
