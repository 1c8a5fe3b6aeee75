"""The weights of a policy, read back from a run folder."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

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
    """Return the tensors of a file that unpacks to about as many bytes as are wanted, None if it is not one of weights.

    Raises:
        ValueError: It unpacks to more.
    """
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
    if not isinstance(saved, dict) or not all(isinstance(name, str) and _is_plain(w) for name, w in saved.items()):
        return None
    return saved


def _is_plain(weight: object) -> bool:
    return isinstance(weight, Tensor) and weight.layout == torch.strided and weight.device.type == "cpu"
