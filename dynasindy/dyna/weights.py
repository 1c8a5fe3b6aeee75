"""The weights of a policy, read back from a run folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import Tensor


def read_weights(file: Path, wanted: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the saved weights if they have the names and shapes of those wanted.

    Args:
        file: The `policy.pt` of a run.
        wanted: State of the policy that the run's configuration builds.

    Raises:
        ValueError: The file is damaged, or holds the weights of another network.
    """
    try:
        saved = torch.load(file, weights_only=True)
    except (UnpicklingError, RuntimeError, EOFError):
        saved = None
    if not isinstance(saved, dict):
        raise ValueError(f"{file} holds no weights of a policy; restore it, or train again")
    shapes = [{name: tuple(tensor.shape) for name, tensor in weights.items()} for weights in (saved, wanted)]
    if differ := sorted(name for name in {**saved, **wanted} if shapes[0].get(name) != shapes[1].get(name)):
        found, due = (shape.get(differ[0], "missing") for shape in shapes)
        raise ValueError(
            f"{file} does not fit the agent of its config.yaml: {differ[0]} is {found}, the agent's {due}; "
            "restore the pair, or train again"
        )
    return saved
