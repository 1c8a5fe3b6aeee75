"""States of a run on disk, from which it goes on bit for bit as if it had not been stopped.

A checkpoint is one file: a line that names its length and digest, then the state as torch saves it. TorchRL's
`Checkpoint` writes several files without a digest and without waiting for the disk, so a power cut can leave one
that looks complete and is not.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from dynasindy.dyna.folder import load_tensors
from dynasindy.safe_io import remove_leftovers, replace_file

MARK = b"dynasindy checkpoint 1"
KEPT = 2
"""How many checkpoints stay: the newest, and one before it in case it is damaged."""
State = dict[str, Any]


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
            if (state := _read(path)) is not None:
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


def _read(path: Path) -> State | None:
    """Return the state in a file, or None if it is damaged; for an error of the disk nothing is begun anew."""
    with path.open("rb") as file:
        head, payload = file.readline(200), file.read()
    return load_tensors(payload) if head == _head(payload) else None


def _head(payload: bytes | memoryview) -> bytes:
    return b"%s %d %s\n" % (MARK, len(payload), hashlib.blake2b(payload, digest_size=20).hexdigest().encode())
