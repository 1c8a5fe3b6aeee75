"""What an actuator makes of commands: what is held from sample to sample acts later, slower, or not all the way.

| kind       | what it does with a command u, its output a                  | size                          |
| ---------- | ------------------------------------------------------------ | ----------------------------- |
| rate limit | a follows u, by no more than its size a second               | [unit of the input per second] |
| play       | a stands still until u is its size ahead, on either side     | [unit of the input]           |
| dead zone  | a is what u has beyond its size, on either side              | [unit of the input]           |
| lag        | a' = (u - a) / size                                          | [s]                           |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions

Kind = Literal["rate limit", "play", "dead zone", "lag"]
KINDS = get_args(Kind)
MET = 1e-3
"""Part of the range of its commands by which two outputs may differ that are one."""


@dataclass(frozen=True)
class Actuator:
    """Say what stands between a command and its effect.

    Attributes:
        place: which input.
        kind: what holds its effect back.
        size: by how much, see above.

    Raises:
        ValueError: the kind does not exist, or the size is not positive.
    """

    place: int
    kind: Kind
    size: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS or not 0 < self.size < math.inf:
            raise ValueError(
                f"an actuator got kind {self.kind!r} and size {self.size}; allowed are {', '.join(KINDS)} and a size "
                "above 0: correct them"
            )

    def acts(self, data: Transitions) -> tuple[Transitions, Tensor]:
        """Return a recording whose input is what acts, its mean over each interval, and where that is known.

        Where the actuator was when a segment began is not known. It is followed from both ends of the range of its
        commands, and is known once both ways have met, bool `(N,)`.

        Args:
            data: the recording, under zero-order hold.
        """
        commands, begins = data.u[:, self.place].tolist(), data.begins().tolist()
        ways = [self._from(start, commands, begins, data.dt) for start in (min(commands), max(commands))]
        low, high = torch.tensor(ways, dtype=data.u.dtype)
        inputs = data.u.clone()
        inputs[:, self.place] = (low + high) / 2
        return replace(data, u=inputs), (high - low).abs() <= MET * (max(commands) - min(commands))

    def _from(self, start: float, commands: Sequence[float], begins: Sequence[bool], dt: float) -> list[float]:
        """Return the mean output over each interval, if it is `start` where a segment begins."""
        acting, after = [], start
        for u, anew in zip(commands, begins, strict=True):
            mean, after = self._over(u, start if anew else after, dt)
            acting.append(mean)
        return acting

    def _over(self, u: float, a: float, dt: float) -> tuple[float, float]:
        """Return the mean of the output over an interval in which u is held, and its end."""
        gap = u - a
        if self.kind == "rate limit":
            busy = min(abs(gap) / self.size, dt)
            end = a + math.copysign(busy * self.size, gap)
            return ((a + end) / 2 * busy + end * (dt - busy)) / dt, end
        if self.kind == "lag":
            left = math.exp(-dt / self.size)
            return u - gap * (1 - left) * self.size / dt, u - gap * left
        if self.kind == "play":
            end = min(max(a, u - self.size), u + self.size)
        else:
            end = u - min(max(u, -self.size), self.size)
        return end, end
