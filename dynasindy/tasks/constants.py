"""Constants of a task as tensors."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor


@cache
def constants(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Return numbers as a tensor that is kept: making one costs as much as a product. It is not to be changed."""
    return torch.tensor(values, dtype=dtype, device=device)
