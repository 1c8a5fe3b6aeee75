"""Sensors of a plant: which states are measured, how finely, how noisily, how late, and how often not at all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from dynasindy.safe_io import checked_class
from dynasindy.systems import Signature

LONGEST = 10
"""Longest delay [control periods]."""
Periods = Annotated[int, Field(ge=0, le=LONGEST)]


@checked_class
@dataclass(frozen=True, config={"allow_inf_nan": False, "extra": "forbid"})
class Channel:
    """One measured state.

    Attributes:
        resolution: Step between two values that the sensor can tell apart [unit of the state]; 0 is infinitely fine.
        noise: Standard deviation of white noise [unit of the state].

    Raises:
        ValueError: A number is negative or not finite.
    """

    resolution: Annotated[float, Field(ge=0)] = 0.0
    noise: Annotated[float, Field(ge=0)] = 0.0

    @property
    def variance(self) -> float:
        """Variance of the error: that of the noise, and that of rounding, which is uniform within a step."""
        return self.noise**2 + self.resolution**2 / 12


@checked_class
@dataclass(frozen=True, config={"extra": "forbid"})
class Sensors:
    """What lies between the real plant and all that learns from it or controls it.

    Attributes:
        channels: Measured states by name, each a `Channel` or its keys; a state that is not named is not measured.
        rates: State to the state that is its rate, e.g. `{"alpha_a": "Omega_a"}`: how rates are estimated before there
            is a model. Entries that name no state are ignored; None stands for no rates.
        delay: Control periods from a measurement to its arrival, known to the observer.
        lost: Probability that a sample, of all channels, is lost.
        actuator_delay: Control periods from a command to the actuator, known to nobody.
        disturbance: Estimate a constant push on each rate in `rates`, or if there is none on each measured state, and
            counteract it.

    Raises:
        ValueError: Nothing is measured, a channel is none, or a number is out of range.
    """

    channels: Mapping[str, Channel | Mapping[str, float]] | None
    rates: Mapping[str, str] | None = None
    delay: Periods = 0
    lost: Annotated[float, Field(ge=0, lt=1)] = 0.0
    actuator_delay: Periods = 0
    disturbance: bool = False

    def __post_init__(self) -> None:
        if not self.channels:
            raise ValueError(
                "sensors.channels is empty; name the measured states, such as {theta: {resolution: 0.0015}}, or give "
                "them as plant.sensors in the file of the system"
            )
        made = {name: each if isinstance(each, Channel) else Channel(**each) for name, each in self.channels.items()}
        object.__setattr__(self, "channels", made)

    def variance(self, signature: Signature) -> Tensor:
        """Return the variance of each state's measurement, `(n_x,)` float64, infinite where there is none.

        Raises:
            ValueError: A measured state does not exist.
        """
        values = torch.full((signature.n_x,), torch.inf, dtype=torch.float64)
        for name, channel in self._places(signature).items():
            values[name] = channel.variance
        return values

    def read(self, x: Tensor, signature: Signature, rng: torch.Generator) -> Tensor:
        """Measure states.

        Args:
            x: True states, `(*batch, n_x)`.
            signature: Their names.
            rng: Generator of noise and losses.

        Returns:
            What was measured, `(*batch, n_x)`, NaN where nothing was; infinite where the plant left all finite states.
        """
        noise = torch.randn(x.shape, generator=rng, dtype=x.dtype)
        lost = torch.rand(*x.shape[:-1], 1, generator=rng, dtype=x.dtype) < self.lost
        y = torch.full_like(x, torch.nan)
        for i, channel in self._places(signature).items():
            value = x[..., i] + channel.noise * noise[..., i]
            y[..., i] = (value / channel.resolution).round() * channel.resolution if channel.resolution else value
        return torch.where(x.isfinite(), y.masked_fill(lost, torch.nan), torch.inf)

    def noisier(self, std: Mapping[str, float]) -> Sensors:
        """Return the same sensors with more white noise on what they measure; what is not measured stays unmeasured.

        Args:
            std: Standard deviation of what is added, by name of a state [unit of the state]; none where not named.
        """
        own = {name: each for name, each in (self.channels or {}).items() if isinstance(each, Channel)}
        noise = {name: math.hypot(channel.noise, std.get(name, 0.0)) for name, channel in own.items()}
        return replace(self, channels={name: replace(own[name], noise=noise[name]) for name in own})

    def rate_indices(self, signature: Signature) -> dict[int, int]:
        """Return the index of a state to that of its rate."""
        names = signature.state_names
        return {names.index(a): names.index(b) for a, b in (self.rates or {}).items() if a in names and b in names}

    def _places(self, signature: Signature) -> dict[int, Channel]:
        given = [(name, each) for name, each in (self.channels or {}).items() if isinstance(each, Channel)]
        return {signature.state_index(name, "sensors.channels"): each for name, each in given}
