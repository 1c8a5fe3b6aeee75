"""Whether two things of different runs are the same by value."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import torch
from torch import Tensor

PLAIN = (str, bytes, int, float, complex, bool, type(None), type, torch.dtype, torch.device)
FUNCTIONS = (FunctionType, BuiltinFunctionType, MethodType)
LEFT_OUT = ("_machines", "_plan")
"""Attributes that follow from others: machine code, and in which order a library is computed."""


def alike(thing: object) -> Hashable:
    """Return what is equal for two things of the same class and the same values, all the way down.

    Functions and whatever holds no attributes are equal to themselves alone.

    Args:
        thing: Such as a plant or a task.
    """
    return _alike(thing, ())


def _alike(thing: Any, above: tuple[int, ...]) -> Hashable:
    if isinstance(thing, torch.Generator):
        return "generator"  # each run has its own
    if isinstance(thing, PLAIN):
        return type(thing).__name__, thing
    if isinstance(thing, Tensor):
        return tuple(thing.shape), str(thing.dtype), tuple(thing.detach().cpu().flatten().tolist())
    if id(thing) in above:
        return "above", above.index(id(thing))
    above = (*above, id(thing))
    if isinstance(thing, Mapping):
        return tuple((_alike(key, above), _alike(value, above)) for key, value in thing.items())
    if isinstance(thing, Sequence):
        return type(thing).__name__, *(_alike(value, above) for value in thing)
    if isinstance(thing, AbstractSet):
        return frozenset(_alike(value, above) for value in thing)
    if isinstance(thing, partial):
        return _alike((thing.func, thing.args, thing.keywords), above)
    if isinstance(thing, FUNCTIONS) or not hasattr(thing, "__dict__"):
        return id(thing)
    values = {name: value for name, value in vars(thing).items() if name not in LEFT_OUT}
    return type(thing).__module__, type(thing).__qualname__, _alike(values, above)
