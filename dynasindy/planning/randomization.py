"""Domain randomization: imagined plants whose inputs' delay and strength are not the model's.

A policy that is planned on one model alone may use all that inputs can do, and hold the model by a hair's breadth: the
plant, whose inputs are a few hundredths weaker, is lost then. A gain margin is what is asked of any controller:

| name   | symbol | equation                                                         |
| ------ | ------ | ---------------------------------------------------------------- |
| factor | k      | input that acts = u_e + k (u - u_e), k between 1 - share and 1 + share |
| rest   | u_e    | input that holds the reference in the model                      |

What holds a plant at rest stays as it is, so that no policy has to be wrong there for some of the factors. Where a
reference moves, u_e is what would hold it at that moment. Where an actuator reaches less than [-1, 1] to a side, as a
pump that cannot draw, no strength takes an input beyond that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.planning.regulator import Regulator, Weights
from dynasindy.sentences import setting
from dynasindy.systems import Stops, System
from dynasindy.systems.equilibria import Equilibria
from dynasindy.systems.machine import Machine
from dynasindy.tasks import Tracking


@dataclass(frozen=True)
class InputStrength:
    """How strong the inputs of imagined episodes are.

    Attributes:
        factor: Of the inputs' distance from rest, `(rows, n_u)`.
        rest: Inputs at rest, `(rows, n_u)`; where references move, those at the start of the episode.
        limits: Least and largest input that acts, `(2, n_u)`, infinite where there is none; None for none at all.
        along: Inputs at rest, `(rows, n_u)`, of task parameters `(rows, n_r, 5)` at times `(rows, 1)` [s], where
            references move; None where none does.
    """

    factor: Tensor
    rest: Tensor
    limits: Tensor | None = None
    along: Callable[[Tensor, Tensor], Tensor] | None = None

    def at(self, params: Tensor, t: Tensor) -> InputStrength:
        """Return the same about what holds references with parameters `(rows, n_r, 5)` at times `(rows, 1)` [s]."""
        return self if self.along is None else replace(self, rest=self.along(params, t))

    def acting(self, u: Tensor) -> Tensor:
        """Return the inputs that act when `u` is commanded, `(rows, n_u)`."""
        stronger = torch.lerp(self.rest, u, self.factor)
        return stronger if self.limits is None else stronger.clamp(self.limits[0], self.limits[1])

    def slope(self, acting: Tensor) -> Tensor:
        """Return the derivative of the inputs that acted by those commanded, each by its own, `(*batch, rows, n_u)`.

        Args:
            acting: What `acting` returned, `(*batch, rows, n_u)`.
        """
        if self.limits is None:
            return self.factor
        return self.factor * ((acting > self.limits[0]) & (acting < self.limits[1]))

    def where(self, new: Tensor, fresh: InputStrength) -> InputStrength:
        """Return the strengths with those of the rows that are new, bool `(rows,)`, taken from others."""
        mask = new.unsqueeze(-1)
        factor, rest = (
            torch.where(mask, theirs, mine) for theirs, mine in ((fresh.factor, self.factor), (fresh.rest, self.rest))
        )
        return replace(self, factor=factor, rest=rest, along=self.along or fresh.along)


class GainMargin:
    """Draws how strong inputs are.

    Args:
        regulator: Knows the inputs at rest.
        task: Gives the references of an episode.
        share: By how much inputs are weaker or stronger at most.
    """

    def __init__(self, regulator: Regulator, task: Tracking, share: float) -> None:
        self.regulator, self.task, self.share = regulator, task, share
        low, high = task.input_limits
        ends = torch.stack([low.where(low > -1, -torch.inf), high.where(high < 1, torch.inf)])
        self.limits = ends if bool(ends.isfinite().any()) else None

    @classmethod
    def of(cls, env: ControlEnv, rests: Equilibria | None, share: float) -> GainMargin | None:
        """Return the margin of a model; None where none is asked for, or nothing rests or is regulated."""
        if not share or rests is None or (regulator := Regulator.of(env, rests, Weights())) is None:
            return None
        assert isinstance(env.task, Tracking)
        return cls(regulator, env.task, share)

    def draw(self, params: Tensor, rng: torch.Generator) -> InputStrength:
        """Return strengths between the ends, each input's its own, for episodes with task parameters `(rows, ...)`."""
        rest = self._rest(params, torch.zeros(len(params), 1))
        factor = 1 + self.share * (2 * torch.rand(rest.shape, generator=rng) - 1)
        return InputStrength(factor, rest, self.limits, self._along(params))

    def ends(self, params: Tensor) -> InputStrength:
        """Return strengths to test a policy with: the weakest, that of the model, and the strongest, in turn."""
        rest = self._rest(params, torch.zeros(len(params), 1))
        turn = torch.arange(len(rest)).remainder(3).sub(1).unsqueeze(-1)
        return InputStrength((1 + self.share * turn).expand_as(rest), rest, self.limits, self._along(params))

    def _rest(self, params: Tensor, t: Tensor) -> Tensor:
        return self.regulator.rest(self.task.reference(params, t).float())[1]

    def _along(self, params: Tensor) -> Callable[[Tensor, Tensor], Tensor] | None:
        """Return what holds references that move at a time; None where all of them stay."""
        return self._rest if bool(params[..., 1].any()) else None  # amplitudes


@dataclass(frozen=True)
class Randomization:
    """How far imagined plants stray from the model; by default inputs are late, and nothing else differs.

    Attributes:
        input_delay: Most by which inputs reach the plant late, in control periods, up to 1, in one episode of two; true
            is 1.

    Raises:
        ValueError: The delay is out of range.
    """

    input_delay: float | bool = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.input_delay <= 1:
            raise ValueError(
                f"a randomization needs 0 <= input_delay <= 1, got {self}; mend {setting('planning.randomization')}"
            )

    def delays(self, rows: int, rng: torch.Generator) -> Tensor | None:
        """Return the delays of so many episodes, `(rows, 1)` [control periods]; None if none is late.

        About one in two is late, and by as much as may be: what lies between is easier than the ends, and a policy that
        was planned with delays drawn evenly from between has less margin.
        """
        return self.input_delay * (torch.rand(rows, 1, generator=rng) < 0.5).float() if self.input_delay else None

    def ends(self, rows: int) -> Tensor | None:
        """Return delays to test a policy with, `(rows, 1)`: three episodes in time and three that are late, in turn."""
        return self.input_delay * (torch.arange(rows) // 3 % 2).unsqueeze(-1).float() if self.input_delay else None


class ModelEnsemble(System):
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
        return torch.cat([model(*share) for model, share in zip(self.models, _shares(x, u, len(self.models)))], -2)

    def compiled(self, x: Tensor, u: Tensor) -> Machine | None:
        """Return machine code that moves each share of the rows by its model's; None where a model has none."""
        codes = [model.compiled(*share) for model, share in zip(self.models, _shares(x, u, len(self.models)))]
        found = [code for code in codes if code is not None]
        return _EnsembleCode(found) if len(found) == len(codes) else None


class _EnsembleCode(Machine):
    """The machine code of several models, each of which moves an equal share of the rows."""

    def __init__(self, codes: Sequence[Machine]) -> None:
        self.codes = codes

    def flight(
        self, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None
    ) -> tuple[Tensor, Tensor]:
        """Advance states over control periods that follow each other."""
        shares = zip(self.codes, _shares(x, u, len(self.codes)))
        samples, touched = zip(*(code.flight(*share, dt, substeps, stops) for code, share in shares), strict=True)
        return torch.cat(samples, -3), torch.cat(touched, -1)

    def sensitivities(self, x: Tensor, u: Tensor, dt: float, substeps: int) -> tuple[Tensor, Tensor]:
        """Return the derivatives of a period by state and input."""
        shares = zip(self.codes, _shares(x, u, len(self.codes)))
        a, b = zip(*(code.sensitivities(*share, dt, substeps) for code, share in shares), strict=True)
        return torch.cat(a, -3), torch.cat(b, -3)


def _shares(x: Tensor, u: Tensor, number: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Split states and inputs, `(*batch, rows, n)`, into so many equal shares of the rows."""
    return zip(x.tensor_split(number, -2), u.tensor_split(number, -2))
