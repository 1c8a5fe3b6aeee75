"""What stands in the words of several findings: figures beside their thresholds, errors of outputs, targets."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import NamedTuple

import torch

from dynasindy.checking.check import Check
from dynasindy.checking.findings import Thresholds

MORE = 12
"""Digits that a figure gets more at most to tell it from its threshold."""


def least(value: float, limit: float, digits: int, kind: str = "f", of_limit: int = 6) -> tuple[str, str]:
    """Return a figure and the least that it may be, with as many more digits as the text takes to say which is less.

    Args:
        value: The figure.
        limit: Its threshold.
        digits: Digits of the figure, as the format counts them.
        kind: Letter of the format of the figure, `f` or `g`.
        of_limit: Digits of the threshold that count.
    """
    return _apart(value, limit, digits, kind, of_limit, operator.lt)


def most(value: float, limit: float, digits: int, kind: str = "f", of_limit: int = 6) -> tuple[str, str]:
    """Return a figure and the most that it may be, as `least` does."""
    return _apart(value, limit, digits, kind, of_limit, operator.gt)


def _apart(
    value: float, limit: float, digits: int, kind: str, of_limit: int, weak: Callable[[float, float], bool]
) -> tuple[str, str]:
    for more in range(MORE):
        pair = f"{value:.{digits + more}{kind}}", f"{limit:.{of_limit + more}g}"
        if weak(float(pair[0]), float(pair[1])) == weak(value, limit):
            break
    return pair


class Error(NamedTuple):
    """The largest error of an output.

    Attributes:
        share: In typical sizes of the output.
        word: In words, with its unit.
        output: Number of the output.
        allowed: What it may be, in its unit and as a share of its typical size.
    """

    share: float
    word: str
    output: int
    allowed: str


def error(found: Check, errors: torch.Tensor, limits: Thresholds) -> Error:
    """Return the largest of steady errors `(rows, n_r)`, counted in typical sizes, beside what it may be."""
    signature, outputs = found.loop.signature, found.loop.task.outputs
    ranged = (errors / sizes(found)).amax(0)
    i = int(ranged.argmax())
    value, size, unit = float(errors[:, i].amax()), signature.x_scale[outputs[i]], signature.state_units[outputs[i]]
    shown, bound = most(value, limits.error * size, 3, "g", 3)
    word = "no bound" if value == math.inf else f"{shown} {unit}"
    allowed = f"{bound} {unit}, {100 * limits.error:g} % of {size:.3g} {unit}, the typical size of {name_of(found, i)}"
    return Error(float(ranged[i]), word, i, allowed)


def below(found: Check, error: float, output: int) -> str:
    """Say that no measurement can show an error [typical sizes] of an output which its sensor does not resolve."""
    signature, state = found.loop.signature, found.loop.task.outputs[output]
    finest = float(found.resolution[state])
    if error * signature.x_scale[state] >= finest:
        return ""
    return f" (the sensor cannot show it, which resolves {finest:.3g} {signature.state_units[state]})"


def sizes(found: Check) -> torch.Tensor:
    """Return the typical sizes of the outputs, `(n_r,)`."""
    scale = found.loop.signature.x_scale
    return torch.tensor([scale[i] for i in found.loop.task.outputs], dtype=torch.float64)


def name_of(found: Check, output: int) -> str:
    """Return the name of an output."""
    return found.loop.signature.state_names[found.loop.task.outputs[output]]


def place(found: Check, k: int) -> str:
    """Return the numbers of a target in brackets."""
    return "(" + ", ".join(f"{value:.3g}" for value in found.targets[k].tolist()) + ")"
