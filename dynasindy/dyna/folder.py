"""The folder of a run: who works in it, whose settings it holds, whether it has ended, and its policy's weights."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor

from dynasindy.limits import raise_if_memory
from dynasindy.safe_io import locked, remove_leftovers

FREE = ("folder:", "threads:", "device:", "results:", "resume:", "finish:", "plugins:")
"""Keys of a configuration, as its lines begin, that do not change a result."""
MADE = (
    *("metrics.json", "policy.pt", "model.json", "observer.json", "controller.json"),
    *("progress.csv", "gate.csv", "identification.txt", "error.txt"),
)
"""Files that a run makes besides its `config.yaml`."""
NEEDED = {"episodes", "cost", "evaluation", "untrained", "equations", "verdict", "checkpoint"}
"""Keys of `metrics.json` that are read again."""


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep a run folder to oneself.

    Args:
        folder: Run folder; made if missing.

    Raises:
        ValueError: Another process works in it.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder, wait=False))
        except BlockingIOError:
            raise ValueError(f"another process works in {folder}; wait for its end, or give another folder") from None
        yield


def check_settings(folder: Path, settings: str) -> None:
    """Make sure that a run folder is empty or holds a run of the same settings.

    Args:
        folder: Run folder.
        settings: The resolved configuration as `config.yaml` holds it; what does not change a result is ignored, and
            what is null, as it may be a setting that older runs had.

    Raises:
        ValueError: The folder holds a run of other settings, or other files.
    """
    config = folder / "config.yaml"
    if not config.is_file():
        others = [file.name for file in folder.iterdir() if not file.name.startswith(".") and file.name not in MADE]
        if others:
            raise ValueError(f"{folder} holds other files, such as {min(others)}; give a new folder")
        return
    ours, theirs = (
        [line for line in text.splitlines() if not line.startswith(FREE) and not line.endswith(": null")]
        for text in (settings, config.read_text())
    )
    if ours != theirs:
        differ = next((a or b for a, b in zip([*ours, ""], [*theirs, ""]) if a != b), "its length")
        raise ValueError(
            f"{folder} holds a run of other settings, such as '{differ.strip()}'; give another folder, or remove it"
        )


def result(folder: Path, episodes: int) -> dict[str, Any] | None:
    """Return what `metrics.json` holds if the run has ended and its files are sound, else None.

    Args:
        folder: Run folder.
        episodes: Real episodes that the settings ask for; a run that was ended earlier has not ended.
    """
    try:
        metrics = json.loads((folder / "metrics.json").read_text())
        json.loads((folder / "model.json").read_text())
        torch.load(folder / "policy.pt", weights_only=True)
        complete = metrics.keys() >= NEEDED and metrics["episodes"] == episodes
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError, EOFError, UnpicklingError) as error:
        raise_if_memory(error)  # else a run that has ended would begin anew
        return None
    return metrics if complete else None


def clear(folder: Path) -> None:
    """Remove what an earlier run of the same settings left, so that no result outlives its run."""
    for name in MADE:
        (folder / name).unlink(missing_ok=True)
    for place in (folder, folder / "data"):
        remove_leftovers(place)
    shutil.rmtree(folder / "scalars", ignore_errors=True)


OVERHEAD = 1_000_000
"""Bytes that a file may hold beside its weights: their names and places; a policy's has some 5000."""


def read_weights(file: Path, wanted: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the saved weights if they have the names and shapes of those wanted.

    Args:
        file: The `policy.pt` of a run.
        wanted: State of the policy that the run's configuration builds.

    Raises:
        ValueError: The file is damaged, or holds the weights of another network, or weights that are not finite.
    """
    saved = _read(file, sum(weight.nbytes for weight in wanted.values()))
    if saved is None:
        raise ValueError(f"{file} holds no weights of a policy; restore it, or train again")
    shapes = [{name: tuple(tensor.shape) for name, tensor in weights.items()} for weights in (saved, wanted)]
    if differ := sorted(name for name in {**saved, **wanted} if shapes[0].get(name) != shapes[1].get(name)):
        found, due = (shape.get(differ[0], "missing") for shape in shapes)
        raise ValueError(
            f"{file} does not fit the agent of its config.yaml: {differ[0]} is {found}, the agent's {due}; "
            "restore the pair, or train again"
        )
    if wrong := sorted(name for name, weight in saved.items() if not weight.isfinite().all()):
        raise ValueError(f"{file} holds weights that are not finite, such as {wrong[0]}; train again")
    return saved


def _read(file: Path, wanted: int) -> dict[str, Tensor] | None:
    """Return the tensors of a file that unpacks to about as many bytes as are wanted; None of another file."""
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size <= 8 * wanted + OVERHEAD:
            saved = torch.load(file, weights_only=True)
    except Exception:  # any: what a file of others makes the reader do ends here
        return None
    if size > 8 * wanted + OVERHEAD:
        raise ValueError(
            f"{file} unpacks to {size} bytes, the agent's weights are {wanted}; restore it, or train again"
        )
    if not isinstance(saved, dict) or not all(isinstance(name, str) for name in saved):
        return None
    plain = (isinstance(w, Tensor) and w.layout == torch.strided and w.device.type == "cpu" for w in saved.values())
    return saved if all(plain) else None
