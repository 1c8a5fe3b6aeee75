"""Constants of a task as tensors."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

from dynasindy.systems.plain import plain


def constants(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Return numbers as a tensor that is kept: making one costs as much as a product. It is not to be changed."""
    if torch.compiler.is_compiling():  # into what is compiled, numbers are written, and nothing is copied to a GPU
        return torch.stack([torch.full((), value, dtype=dtype, device=device) for value in values])
    if not plain():  # a tensor that is made under a transform of torch.func belongs to that
        return torch.tensor(values, dtype=dtype, device=device)
    return _kept(values, dtype, device)


@cache
def _kept(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    with torch.inference_mode(False):  # what is made in it has no place in a graph later
        return torch.tensor(values, dtype=dtype, device=device)
