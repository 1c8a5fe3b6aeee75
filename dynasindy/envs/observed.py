"""Which entries of an observation are the state of a plant, and which angles follow from a sine and a cosine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor


class Observed:
    """The state of a plant in the observations of a Gymnasium environment.

    An angle is told by its sine and its cosine up to whole turns. An episode begins in (-pi, pi], and from then on the
    angle is the one that is nearest to that of the period before, so that an arm that turns on does not jump.

    Args:
        names: Names of the observation's entries, in their order.
        states: Names of the states; each is an entry or an angle. Entries that are no state are not read.
        angles: Angle to the names of its sine and its cosine.

    Raises:
        ValueError: A name is double, a state is neither an entry nor an angle, or an angle is no state, is an entry
            itself, or has no two entries.
    """

    def __init__(
        self, names: Sequence[str], states: Sequence[str], angles: Mapping[str, Sequence[str]] | None = None
    ) -> None:
        angles, told = angles or {}, f"the observation's entries are {', '.join(names)}"
        if double := [name for k, name in enumerate(names) if name in names[:k]]:
            raise ValueError(f"plant.observed has {double[0]} twice; give each entry of the observation its own name")
        for angle, parts in angles.items():
            if angle in names or angle not in states or len(parts) != 2 or not {*parts} <= {*names}:
                raise ValueError(
                    f"plant.angles has {angle}: [{', '.join(parts)}]; name a state that is no entry itself, with its "
                    f"sine and its cosine: {told}"
                )
        if absent := [name for name in states if name not in names and name not in angles]:
            raise ValueError(
                f"plant.states has {absent[0]}, which is neither observed nor an angle; {told}: name it in "
                "plant.angles, with its sine and its cosine, or mend plant.observed"
            )
        self.width, self.is_angle = len(names), torch.tensor([name in angles for name in states])
        pairs = [angles.get(name, (name, name)) for name in states]
        self.sine, self.cosine = ([names.index(pair[k]) for pair in pairs] for k in (0, 1))
        self.plain = not angles and list(names) == list(states)

    def state(self, observation: Tensor, before: Tensor | None = None) -> Tensor:
        """Return the state, `(*batch, n_x)`, of observations `(*batch, n)`.

        Args:
            observation: What the environment shows.
            before: State a period earlier, `(*batch, n_x)`; None at the start of an episode.
        """
        if self.plain:
            return observation
        x = observation[..., self.sine]
        angle = torch.atan2(x, observation[..., self.cosine])
        if before is not None:
            angle = before + torch.remainder(angle - before + math.pi, 2 * math.pi) - math.pi
        return torch.where(self.is_angle, angle, x)

    def ends(self, ends: Tensor) -> Tensor:
        """Return the ends of the states, `(2, n_x)`, of those of the entries, `(2, n)`; an angle has none."""
        free = torch.tensor([[-math.inf], [math.inf]], dtype=ends.dtype)
        return torch.where(self.is_angle, free, ends[:, self.sine])
