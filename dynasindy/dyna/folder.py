"""The folder of a run: what it holds, whether the run has ended, its policy's weights, and checkpoints.

From a checkpoint a run goes on bit for bit as if it had not been stopped. It is one file: a line that names its length
and digest, then the state as torch saves it. TorchRL's `Checkpoint` writes several files without a digest and without
waiting for the disk, so a power cut can leave one that looks complete and is not.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.limits import raise_if_memory
from dynasindy.safe_io import remove_leftovers, replace_file

MADE = (
    *("metrics.json", "policy.pt", "model.json", "observer.json", "controller.json"),
    *("progress.csv", "gate.csv", "identification.txt", "error.txt"),
)
"""Files that a run makes besides its `config.yaml`."""
NEEDED = {"episodes", "cost", "evaluation", "untrained", "equations", "verdict"}
"""Keys of `metrics.json` that are read again."""
MARK = b"dynasindy checkpoint 1"
KEPT = 2
"""How many checkpoints stay: the newest, and one before it in case it is damaged."""
State = dict[str, Any]


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
        saved = _load_tensors(file.read_bytes())
    except OSError as error:
        raise_if_memory(error)
        return None
    plain = (
        isinstance(name, str) and isinstance(w, Tensor) and w.layout == torch.strided and w.device.type == "cpu"
        for name, w in (saved or {}).items()
    )
    return saved if all(plain) else None


def _load_tensors(payload: bytes) -> dict[Any, Any] | None:
    """Return the mapping that torch has saved, with plain data alone and nothing that swells; None of anything else."""
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            swells = any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist())
        saved = None if swells else torch.load(io.BytesIO(payload), weights_only=True, map_location="cpu")
    except Exception as error:  # any: what a file of others makes the reader do ends here
        raise_if_memory(error)  # for which nothing is begun anew
        return None
    return saved if isinstance(saved, dict) else None


class Checkpoints:
    """The newest states of a run, in a folder.

    Args:
        folder: Folder of the files; made when the first is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def save(self, number: int, state: Mapping[str, Any]) -> Path:
        """Write a state as `NUMBER.pt`, whole or not at all, and then remove all but the newest.

        Args:
            number: Its place in the order of states.
            state: Tensors, numbers, text, and lists and dictionaries of them.

        Raises:
            OSError: The file cannot be written; the earlier ones stay.
        """
        buffer = io.BytesIO()
        torch.save(dict(state), buffer)
        path = self.folder / f"{number:06d}.pt"
        with replace_file(path) as file:
            file.write(_head(buffer.getbuffer()))
            file.write(buffer.getbuffer())
        for old in self._files()[:-KEPT]:
            old.unlink(missing_ok=True)
        return path

    def newest(self) -> State | None:
        """Return the newest state whose file is sound, or None."""
        for path in reversed(self._files()):
            if (state := _sound_state(path)) is not None:
                return state
        return None

    def remove(self) -> None:
        """Remove all checkpoints, as of a run that has ended."""
        remove_leftovers(self.folder)
        for path in self._files():
            path.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("[0-9]*.pt"))


def _sound_state(path: Path) -> State | None:
    """Return the state in a file, or None if it is damaged; for an error of the disk nothing is begun anew."""
    with path.open("rb") as file:
        head, payload = file.readline(200), file.read()
    return _load_tensors(payload) if head == _head(payload) else None


def _head(payload: bytes | memoryview) -> bytes:
    return b"%s %d %s\n" % (MARK, len(payload), hashlib.blake2b(payload, digest_size=20).hexdigest().encode())
