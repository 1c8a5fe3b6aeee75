"""What may differ between the model and the plant, imagined: parameters and the delay of inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.systems import Altered, System


@dataclass(frozen=True)
class Variation:
    """How far imagined plants stray from the model; by default inputs are late, and nothing else differs.

    Attributes:
        parameters: Half range of a factor on each rate of change and on each input, e.g. 0.1 for +-10 %.
        late: Most by which inputs reach the plant late, in control periods, up to 1, in one episode of two; true is 1.

    Raises:
        ValueError: A number is out of range.
    """

    parameters: float = 0.0
    late: float | bool = 1.0

    def __post_init__(self) -> None:
        if not (0 <= self.parameters < 1 and 0 <= self.late <= 1):
            raise ValueError(
                f"a variation needs 0 <= parameters < 1 and 0 <= late <= 1, got {self}; mend planning.variation"
            )

    def delays(self, rows: int, rng: torch.Generator) -> Tensor | None:
        """Return the delays of so many episodes, `(rows, 1)` [control periods]; None if none is late.

        About one in two is late, and by as much as may be: what lies between is easier than the ends, and a policy that
        was planned with delays drawn evenly from between has less margin.
        """
        return self.late * (torch.rand(rows, 1, generator=rng) < 0.5).float() if self.late else None

    def ends(self, rows: int) -> Tensor | None:
        """Return delays to test a policy with, `(rows, 1)`: three episodes in time and three that are late, in turn."""
        return self.late * (torch.arange(rows) // 3 % 2).unsqueeze(-1).float() if self.late else None


class Members(System):
    """Several models of one plant, each for an equal share of the rows: no policy can exploit the errors of one.

    Args:
        models: Models with one signature; states and inputs are `(*batch, rows, n)`, each at least a row.
    """

    def __init__(self, models: Sequence[System]) -> None:
        super().__init__(models[0].signature, models[0].stops)
        self.models = list(models)

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s]; None of a differential equation."""
        return self.models[0].step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, rows, n_x)`, of states `(*batch, rows, n_x)` under inputs `(*batch, rows, n_u)`."""
        shares = zip(x.tensor_split(len(self.models), -2), u.tensor_split(len(self.models), -2))
        return torch.cat([model(*share) for model, share in zip(self.models, shares)], -2)


class Varied(Altered):
    """A system in as many versions as there are rows: dx = (1 + g) f(x, (1 + h) u).

    States whose rate is another state (angles) keep their equation.

    Args:
        system: Nominal vector field.
        parameters: Half range of g and h.
        rows: Number of versions; states and inputs are `(*batch, rows, n)`.
    """

    def __init__(self, system: System, parameters: float, rows: int) -> None:
        super().__init__(system)
        self.parameters = parameters
        n_x, n_u = system.signature.n_x, system.signature.n_u
        self.gain, self.input_gain = torch.ones(rows, n_x), torch.ones(rows, n_u)
        self.moved = self._moved()

    def draw(self, new: Tensor, rng: torch.Generator) -> None:
        """Draw new versions for the rows marked in `new`, bool `(rows,)`."""
        for tensor, reach in (
            (self.gain, self.parameters * self.moved),
            (self.input_gain, torch.tensor(self.parameters)),
        ):
            fresh = 1.0 + reach * (2 * torch.rand(tensor.shape, generator=rng) - 1)
            tensor[new] = fresh[new]

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, rows, n_x)`, of states `(*batch, rows, n_x)` under inputs `(*batch, rows, n_u)`."""
        dx: Tensor = self.system(x, u * self.input_gain)
        return self.gain * dx

    def _moved(self) -> Tensor:
        """Return 1 for states with dynamics of their own and 0 for those whose rate is another state, `(n_x,)`."""
        n_x, n_u = self.signature.n_x, self.signature.n_u
        x = torch.randn(16, n_x, generator=torch.Generator().manual_seed(0)) * torch.tensor(self.signature.x_scale)
        with torch.no_grad():
            dx = self.system(x, torch.zeros(16, n_u))
        copies = (dx.unsqueeze(-1) - x.unsqueeze(-2)).abs().amax(0).amin(-1) == 0
        return 1.0 - copies.float()
