"""Steps that repeat: on a GPU as captured graphs, which cost one launch each, elsewhere as they are."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import torch
import torch._dynamo
import torch._functorch.config

EAGER = "force_non_lazy_backward_lowering"
"""Setting of torch by which derivatives are compiled together with what they are of."""
KINDS = 64
"""Kinds of steps that torch compiles before it gives up."""
WARM_UP = 3
"""Calls before a step is captured, in which torch and its libraries take what they need of the GPU."""


def captured(step: Callable[[], None], device: torch.device, ready: Callable[[], object]) -> Callable[[], None]:
    """Return what repeats a step that reads and writes the same tensors each time.

    Args:
        step: The step; on a GPU it is called a few times here, and changes what it writes.
        device: Where its tensors lie.
        ready: Called before each of these calls, such that there is room for what the step writes.
    """
    if device.type != "cuda":
        return step
    side = torch.cuda.Stream(device)
    side.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(side):
        for _ in range(WARM_UP):
            ready()
            step()
        ready()
    torch.cuda.current_stream(device).wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def compiled(function: Callable[..., Any], device: torch.device) -> Callable[..., Any]:
    """Return what computes the same as a function of tensors; on a GPU torch compiles it when it is first called.

    Where torch cannot compile it, as without Triton, torch says so, and the function stays as it is.

    Args:
        function: Takes tensors, and may have derivatives.
        device: Where they lie.
    """
    if device.type != "cuda":
        return function
    # Each kind of step is another function to us, and the same one with other sizes to torch.
    torch._dynamo.config.recompile_limit = max(KINDS, torch._dynamo.config.recompile_limit)
    made = torch.compile(function, dynamic=False)
    # With derivatives compiled at once, nothing is left that could fail later; older versions of torch cannot do it.
    at_once = {name: True for name in (EAGER,) if hasattr(torch._functorch.config, name)}

    @wraps(function)
    def _called(*given: Any) -> Any:
        with torch._dynamo.config.patch(suppress_errors=True), torch._functorch.config.patch(at_once):
            return made(*given)

    return _called
