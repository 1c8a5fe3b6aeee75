"""The folder of a run: what it holds, whether the run has ended, and its policy's weights."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.limits import raise_if_memory

MADE = (
    *("metrics.json", "policy.pt", "model.json", "observer.json", "controller.json"),
    *("progress.csv", "gate.csv", "identification.txt", "error.txt"),
)
"""Files that a run makes besides its `config.yaml`."""
NEEDED = {"episodes", "cost", "evaluation", "untrained", "equations", "verdict"}
"""Keys of `metrics.json` that are read again."""


def result(folder: Path, episodes: int) -> dict[str, Any] | None:
    """Return what `metrics.json` holds if the run has ended and its files are sound, else None.

    Args:
        folder: Run folder.
        episodes: Real episodes that the settings ask for; a run that was ended earlier has not ended.
    """
    try:
        metrics = json.loads((folder / "metrics.json").read_text())
        json.loads((folder / "model.json").read_text())
        complete = metrics.keys() >= NEEDED and metrics["episodes"] == episodes
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise_if_memory(error)  # else a run that has ended would begin anew
        return None
    return metrics if complete and _read(folder / "policy.pt") is not None else None


def read_weights(file: Path, wanted: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the saved weights if they have the names and shapes of those wanted.

    Args:
        file: The `policy.pt` of a run.
        wanted: State of the policy that the run's configuration builds.

    Raises:
        ValueError: The file is damaged, or holds the weights of another network, or weights that are not finite.
    """
    saved = _read(file)
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


def _read(file: Path) -> dict[str, Tensor] | None:
    """Return the tensors of a file; None of another file."""
    try:
        saved = load_tensors(file.read_bytes())
    except OSError as error:
        raise_if_memory(error)
        return None
    plain = (
        isinstance(name, str) and isinstance(w, Tensor) and w.layout == torch.strided and w.device.type == "cpu"
        for name, w in (saved or {}).items()
    )
    return saved if all(plain) else None


def load_tensors(payload: bytes) -> dict[Any, Any] | None:
    """Return the mapping that torch has saved, with plain data alone and nothing that swells; None of anything else."""
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            swells = any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist())
        saved = None if swells else torch.load(io.BytesIO(payload), weights_only=True, map_location="cpu")
    except Exception as error:  # any: what a file of others makes the reader do ends here
        raise_if_memory(error)  # for which nothing is begun anew
        return None
    return saved if isinstance(saved, dict) else None
