"""The smallest errors that coefficients can have, whatever the method."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.sindy.library import Library
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import Estimate, Flow, linearise_windows
from dynasindy.sindy.windows import Windows
from dynasindy.systems.transitions import Transitions


def cramer_rao(library: Library, truth: Tensor, clean: Transitions, sigma: Tensor) -> Tensor:
    """Return the smallest standard error of each true term, the start state unknown, `(P,)`.

    Args:
        library: candidate functions.
        truth: the true coefficients, `(n_features, n_x)`.
        clean: the recording without noise.
        sigma: standard deviation of the white noise of each state, `(n_x,)`.
    """
    windows, parameters = Windows.of(clean, 50), Parameters.where(truth != 0)
    model = linearise_windows(Flow.of(Estimate(library, truth, windows.first.clone()), parameters, windows), sigma)
    n = len(model.scale)
    inverse = torch.linalg.inv(model.triangle[:n, :n])
    return (inverse.square().sum(-1).sqrt() / model.scale)[n - len(parameters) :]
