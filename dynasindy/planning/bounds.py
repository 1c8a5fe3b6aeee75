"""Where a model is believed: imagined rollouts are cut at the first transition that lies elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.data.recording import transitions
from dynasindy.envs import ControlEnv
from dynasindy.planning.variation import Members

Mask = Callable[[TensorDictBase], Tensor]
"""Tells of imagined rollouts `(batch, horizon)` which transitions are believed, bool `(batch, horizon)`."""
NEAR = 2000
"""Real transitions that the distance to the data is measured to."""
MEMBERS = 5
"""Models that have to agree."""


class Within:
    """Believe what ends within a limit.

    Args:
        limit: Largest absolute value of each state, `(n_x,)`.
    """

    def __init__(self, limit: Tensor) -> None:
        self.limit = limit

    def __call__(self, rollout: TensorDictBase) -> Tensor:
        """Return which transitions are believed, bool `(batch, horizon)`."""
        states = rollout["next", "state"]
        return (states.abs() <= self.limit.to(states)).all(-1)


class Near:
    """Believe what begins near real states and actions.

    Args:
        states: Real states, `(n, n_x)`.
        actions: The actions taken there, `(n, n_u)`.
        distance: Largest Euclidean distance to the nearest, each column divided by its largest absolute value.
    """

    def __init__(self, states: Tensor, actions: Tensor, distance: float) -> None:
        real = torch.cat([states.float(), actions.float()], -1)
        self.scale = real.abs().amax(0).clamp_min(1e-9)
        self.real = real / self.scale
        self.distance = distance

    def __call__(self, rollout: TensorDictBase) -> Tensor:
        """Return which transitions are believed, bool `(batch, horizon)`."""
        points = torch.cat([rollout["state"].float(), rollout["action"].float()], -1) / self.scale
        apart = torch.cdist(points.flatten(0, -2), self.real).amin(-1)
        return (apart <= self.distance).reshape(points.shape[:-1])


class Agreeing:
    """Believe what models of an ensemble agree on.

    Args:
        models: Models fitted to resampled data.
        dt: Control period [s].
        disagreement: Largest standard deviation over the models of the change of a state in a control period
            [ranges of the state].
    """

    def __init__(self, models: Members, dt: float, disagreement: float) -> None:
        self.models, self.disagreement = models.models, disagreement
        self.factor = dt / torch.tensor(models.signature.x_scale)

    def __call__(self, rollout: TensorDictBase) -> Tensor:
        """Return which transitions are believed, bool `(batch, horizon)`."""
        x, u = rollout["state"], rollout["action"]
        changes = torch.stack([model(x, u.to(x)) for model in self.models]) * self.factor.to(x)
        return changes.std(0).amax(-1) <= self.disagreement


@dataclass(frozen=True)
class Bounds:
    """Where the model is believed.

    Attributes:
        reach: Multiple of the largest value of each state on the plant, beyond which nothing is believed.
        distance: Largest distance of state and action, in their ranges, to the nearest real transition (of at most
            2000 drawn); any if None.
        disagreement: Largest standard deviation, over five fits to resampled data, of the change of a state in a
            control period [ranges of the state]; any if None.

    Raises:
        ValueError: A number is not positive.
    """

    reach: float = 1.5
    distance: float | None = None
    disagreement: float | None = None

    def __post_init__(self) -> None:
        if not all(value is None or value > 0 for value in (self.reach, self.distance, self.disagreement)):
            raise ValueError(f"bounds of the model must be positive or null, got {self}; mend planning.bounds")

    def masks(self, env: ControlEnv, real: TensorDictBase, generator: torch.Generator) -> list[Mask]:
        """Return the masks that real data give.

        Args:
            env: Imagined environment.
            real: All real control periods in the order of time, `(n,)`.
            generator: Source of the choice of real transitions.
        """
        masks: list[Mask] = [Within(self.reach * real["next", "state"].abs().amax(0))]
        if self.distance is not None:
            rows = torch.randint(len(real), (NEAR,), generator=generator)
            masks.append(Near(real["state"][rows], real["action"][rows], self.distance))
        if self.disagreement is not None:
            members = Members.of(env.system, transitions(real, env.log_dt), MEMBERS)
            masks.append(Agreeing(members, env.dt, self.disagreement))
        return masks
