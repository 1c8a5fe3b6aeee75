"""What the scripts of peers share: a controller that answers over standard input and output, a line of JSON each way.

Imported by scripts that run in environments of their own: numpy alone is there.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ANSWERS: list[TextIO] = []
"""Where answers go."""


def cpu_seconds() -> float:
    """Return the CPU time of this process and of those that it called [s]."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def settings() -> dict[str, Any]:
    """Return what the benchmark asks for; what a library prints goes to standard error from here on."""
    asked: dict[str, Any] = json.loads(sys.stdin.readline())
    sys.stdout.flush()
    answers = os.dup(1)
    os.dup2(2, 1)
    ANSWERS.append(os.fdopen(answers, "w"))
    return asked


def answer(**facts: Any) -> None:
    """Give the benchmark a line."""
    print(json.dumps(facts), file=ANSWERS[0], flush=True)


def field_of(source: str, calls: dict[str, Any]) -> Callable[[Any, Any], list[Any]]:
    """Return `field(x, u)` out of the text that dynasindy exports for CasADi, on any kind of number."""
    scope = dict(calls)
    exec("def field" + source.split("def field", 1)[1].split("\ndef ", 1)[0], scope)
    found: Callable[[Any, Any], list[Any]] = scope["field"]
    return found


def monomials(targets: Sequence[Any]) -> list[Any]:
    """Return 1, r_1, r_2, r_1^2, ... of two targets, up to the fifth degree: the basis of do-mpc's hint."""
    first, second = targets
    return [first**a * second ** (n - a) for n in range(6) for a in range(n, -1, -1)]


def control(act: Callable[[Array, Array, bool, int], Array]) -> None:
    """Answer states and targets of several flights with inputs, until the benchmark has enough.

    Args:
        act: Returns inputs for state, target, whether a flight begins, and its number.
    """
    for line in sys.stdin:
        asked = json.loads(line)
        start = time.process_time()
        rows = zip(np.array(asked["x"]), np.array(asked["r"]), strict=True)
        inputs = [np.asarray(act(x, r, asked["first"], k)).ravel().tolist() for k, (x, r) in enumerate(rows)]
        answer(u=inputs, cpu=time.process_time() - start)
