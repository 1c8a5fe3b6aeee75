"""What may differ between the model and the plant, imagined: parameters, disturbances, sensors, actuator."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.limits import Count
from dynasindy.sindy import SindyModel
from dynasindy.sindy.ensemble import bag
from dynasindy.systems import Altered, System
from dynasindy.systems.transitions import Transitions


@dataclass(frozen=True)
class Variation:
    """How far imagined plants stray from the model; by default inputs are late, and every other number is zero.

    Attributes:
        parameters: Half range of a factor on each rate of change and on each input, e.g. 0.1 for +-10 %.
        disturbance: Half range of a constant added to each rate of change, in ranges of the state per second.
        noise: Standard deviation of the measurement noise of each state [its unit]; none if empty.
        late: Most by which inputs reach the plant late, in control periods, up to 1, in one episode of two; true is 1.
        members: Fits to resampled blocks of the data, of which each imagined plant is one; the model itself if 0.

    Raises:
        ValueError: A number is negative or not finite, or `parameters` is not below 1.
    """

    parameters: float = 0.0
    disturbance: float = 0.0
    noise: Sequence[float] = ()
    late: float | bool = 1.0
    members: Count = 0

    def __post_init__(self) -> None:
        numbers = (self.parameters, self.disturbance, self.late, self.members, *self.noise)
        # Asked so that NaN, which compares false with everything, fails.
        if not all(0 <= number < math.inf for number in numbers) or self.parameters >= 1 or self.late > 1:
            raise ValueError(
                "a variation needs finite numbers, 0 <= parameters < 1, 0 <= late <= 1, disturbance, noise and members "
                f">= 0, got {self}; mend planning.variation"
            )

    @property
    def plants(self) -> bool:
        """Whether imagined plants differ from the model."""
        return self.parameters > 0 or self.disturbance > 0

    def delays(self, rows: int, rng: torch.Generator) -> Tensor | None:
        """Return the delays of so many episodes, `(rows, 1)` [control periods]; None if none is late.

        About one in two is late, and by as much as may be: what lies between is easier than the ends, and a policy that
        was planned with delays drawn evenly from between has less margin.
        """
        return self.late * (torch.rand(rows, 1, generator=rng) < 0.5).float() if self.late else None

    def ends(self, rows: int) -> Tensor | None:
        """Return delays to test a policy with, `(rows, 1)`: three episodes in time and three that are late, in turn."""
        return self.late * (torch.arange(rows) // 3 % 2).unsqueeze(-1).float() if self.late else None

    def deviations(self, n_x: int) -> Tensor | None:
        """Return the standard deviations of the measurement noise, `(n_x,)`, or None without noise.

        Raises:
            ValueError: There are neither no nor `n_x` deviations.
        """
        if not len(self.noise):
            return None
        if len(self.noise) != n_x:
            raise ValueError(
                f"planning.variation.noise has {len(self.noise)} deviations for {n_x} states; give one per state, or "
                "none"
            )
        return torch.tensor(list(self.noise), dtype=torch.float32)


class Members(System):
    """Several models of one plant, each for an equal share of the rows: no policy can exploit the errors of one.

    Args:
        models: Models with one signature; states and inputs are `(*batch, rows, n)`, each at least a row.
    """

    def __init__(self, models: Sequence[System]) -> None:
        super().__init__(models[0].signature, models[0].stops)
        self.models = list(models)

    @classmethod
    def of(cls, model: System, data: Transitions, number: int) -> Members:
        """Fit the model's library to blocks of its data, drawn with replacement.

        Raises:
            TypeError: The model is no sparse model.
        """
        if not isinstance(model, SindyModel):
            raise TypeError(f"{type(model).__name__} has no resampled fits; leave members at 0, disagreement null")
        models = [copy.deepcopy(model) for _ in range(number)]
        for member, coefficients in zip(models, bag(model, data, number).members):
            member.set_coefficients(coefficients)
        return cls(models)

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s]; None of a differential equation."""
        return self.models[0].step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, rows, n_x)`, of states `(*batch, rows, n_x)` under inputs `(*batch, rows, n_u)`."""
        shares = zip(x.tensor_split(len(self.models), -2), u.tensor_split(len(self.models), -2))
        return torch.cat([model(*share) for model, share in zip(self.models, shares)], -2)


class Varied(Altered):
    """A system in as many versions as there are rows: dx = (1 + g) f(x, (1 + h) u) + d.

    States whose rate is another state (angles) keep their equation.

    Args:
        system: Nominal vector field.
        variation: How far the versions stray.
        rows: Number of versions; states and inputs are `(*batch, rows, n)`.
    """

    def __init__(self, system: System, variation: Variation, rows: int) -> None:
        super().__init__(system)
        self.variation = variation
        n_x, n_u = system.signature.n_x, system.signature.n_u
        self.gain, self.drift, self.input_gain = torch.ones(rows, n_x), torch.zeros(rows, n_x), torch.ones(rows, n_u)
        self.moved = self._moved()

    def draw(self, new: Tensor, rng: torch.Generator) -> None:
        """Draw new versions for the rows marked in `new`, bool `(rows,)`."""
        scale = torch.tensor(self.system.signature.x_scale)
        for tensor, centre, reach in (
            (self.gain, 1.0, self.variation.parameters * self.moved),
            (self.input_gain, 1.0, torch.tensor(self.variation.parameters)),
            (self.drift, 0.0, self.variation.disturbance * self.moved * scale),
        ):
            fresh = centre + reach * (2 * torch.rand(tensor.shape, generator=rng) - 1)
            tensor[new] = fresh[new]

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, rows, n_x)`, of states `(*batch, rows, n_x)` under inputs `(*batch, rows, n_u)`."""
        dx: Tensor = self.system(x, u * self.input_gain)
        return torch.addcmul(self.drift, self.gain, dx)

    def _moved(self) -> Tensor:
        """Return 1 for states with dynamics of their own and 0 for those whose rate is another state, `(n_x,)`."""
        n_x, n_u = self.signature.n_x, self.signature.n_u
        x = torch.randn(16, n_x, generator=torch.Generator().manual_seed(0)) * torch.tensor(self.signature.x_scale)
        with torch.no_grad():
            dx = self.system(x, torch.zeros(16, n_u))
        copies = (dx.unsqueeze(-1) - x.unsqueeze(-2)).abs().amax(0).amin(-1) == 0
        return 1.0 - copies.float()
