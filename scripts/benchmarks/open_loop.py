"""Simulations in open loop, over the whole of a log."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.sindy.delay import delay_inputs
from dynasindy.systems.base import System
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions


def simulated(model: System, x0: Tensor, data: Transitions, substeps: int) -> Tensor:
    """Return the states of an open-loop simulation, `(N + 1, n_x)`, under the inputs as they take effect.

    Args:
        model: What is simulated, with the delay of its inputs if it has one.
        x0: State at the beginning, `(n_x,)`.
        data: Recording whose inputs and sampling time are read.
        substeps: Runge-Kutta steps in a sample.
    """
    late = delay_inputs(data, float(getattr(model, "delay", 0.0)))
    states = [x0]
    with torch.no_grad():
        for u in late.u:
            x = states[-1]
            for _ in range(substeps):
                x = rk4(model, x, u, data.dt / substeps)
            states.append(x)
    return torch.stack(states)
