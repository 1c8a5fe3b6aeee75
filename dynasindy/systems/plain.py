"""Whether tensors are numbers in memory and nothing more, such that code outside torch may read them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import forward_ad


def plain(*tensors: Tensor) -> bool:
    """Return whether no derivative is asked of tensors, and no transform of `torch.func` is under way."""
    if torch._C._are_functorch_transforms_active():
        return False
    graph = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    return not graph and all(forward_ad.unpack_dual(tensor).tangent is None for tensor in tensors)
