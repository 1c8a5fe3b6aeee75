"""A plant of the first order under held inputs, y' = A y + B u, its exact motion, and a library that holds it."""

import math

import numpy as np
import torch

from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B, Y0, DT = -2.0, 3.0, 0.3, 0.01
TWO = torch.tensor([[True], [True], [False], [False]])


def column(*values: float) -> torch.Tensor:
    """Coefficients of the only equation."""
    return torch.tensor(values, dtype=torch.float64).unsqueeze(-1)


def inputs(count: int) -> np.ndarray:
    """So many inputs, each held for ten samples."""
    return np.random.default_rng(7).uniform(-1, 1, count).repeat(10)


def motion(a: float, b: float, y0: float, u: np.ndarray, dt: float = DT) -> np.ndarray:
    """Exact states of y' = a y + b u under held inputs."""
    phi, y = math.exp(a * dt), [y0]
    for held in u:
        y.append(phi * y[-1] + b * (phi - 1) / a * held)
    return np.array(y)
