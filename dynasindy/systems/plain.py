"""Whether tensors are numbers in memory and nothing more, such that code outside torch may read them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import forward_ad


def plain(*tensors: Tensor) -> bool:
    """Return whether no derivative is asked of tensors, and no transform of `torch.func` is under way."""
    if torch._C._are_functorch_transforms_active():
        return False
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        return False
    # Outside of forward mode, to unpack them would cost several times what is asked here.
    return forward_ad._current_level < 0 or all(forward_ad.unpack_dual(tensor).tangent is None for tensor in tensors)
