"""What all excitations share: levels per input, clipping, and the face of a policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypedDict

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dynasindy.limits import check_memory

Levels = float | Sequence[float]
PERIODS = 200
"""Control periods of an experiment whose length is not given."""
DOUBLES = 10
"""Control periods in which an excitation that begins small doubles."""


class Common(TypedDict, total=False):
    """Settings that subclasses pass on, by name; see `Excitation`."""

    amplitude: Levels
    offset: Levels
    seed: int
    first: float


class Excitation(TensorDictModuleBase, ABC):
    """Give inputs over time: `offset + amplitude * wave(t)`, clipped to [-1, 1].

    As a policy it reads `step_count` and writes `action`; the input is held for one control period.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        amplitude: half range of each input, or one for all [normalised].
        offset: mean of each input, or one for all: the input that holds the plant where it is to be excited.
        seed: seed of what is random in the signal, if anything is.
        first: share of the amplitude with which the plant is moved at first, in (0, 1]; it doubles every ten control
            periods until it is whole. Less than 1 also says that nobody knows whether the plant stays by itself.

    Raises:
        ValueError: a time or the number of inputs is not positive.
        ValueError: amplitudes or offsets are not one per input, or an input would always be clipped.
        ValueError: `first` is not in (0, 1].
    """

    in_keys = ["step_count"]  # noqa: RUF012 - the base class of TensorDict sets these per class
    out_keys = ["action"]  # noqa: RUF012

    def __init__(
        self,
        n_u: int,
        duration: float | None = 10.0,
        dt: float = 0.05,
        amplitude: Levels = 0.3,
        offset: Levels = 0.0,
        seed: int = 0,
        first: float = 1.0,
    ) -> None:
        super().__init__()
        self.seed, duration = seed, PERIODS * dt if duration is None else duration
        if n_u < 1 or not duration > 0 or not dt > 0:
            raise ValueError(
                f"excitation got {n_u} inputs, duration {duration} s, dt {dt} s; "
                "allowed are positive numbers: correct them"
            )
        if duration < dt:
            raise ValueError(
                f"excitation.duration is {duration:g} s and env.dt {dt:g} s; allowed is a duration of one control "
                "period or more: lower env.dt, or excite for longer"
            )
        self.n_u, self.duration, self.dt = n_u, float(duration), float(dt)
        self._check_size(self.dt, 1)
        self.register_buffer("amplitude", _per_input(amplitude, n_u, "amplitude"))
        if not bool(self.amplitude.any()):
            raise ValueError(
                "excitation.amplitude is 0; allowed is a half range above 0 of an input: without nothing moves"
            )
        self.register_buffer("offset", _per_input(offset, n_u, "offset"))
        if bool((self.offset.abs() + self.amplitude.abs() > 1 + 1e-6).any()):
            raise ValueError(
                f"excitation.amplitude is {self.amplitude.tolist()} about excitation.offset {self.offset.tolist()}; "
                "allowed is what stays within [-1, 1]: lower the amplitude, or move the offset towards 0"
            )
        self.first = float(first)
        if not 0 < self.first <= 1:
            raise ValueError(
                f"excitation.first is {self.first:g}; allowed is a share of the amplitude above 0 and up to 1: give 1 "
                "for the whole of it from the start"
            )

    amplitude: Tensor
    offset: Tensor

    @property
    def n_steps(self) -> int:
        """Count the control periods of the experiment."""
        return max(1, round(self.duration / self.dt))

    @abstractmethod
    def wave(self, t: Tensor) -> Tensor:
        """Give the bare signal in [-1, 1] at times `(*batch,)` [s], as `(*batch, n_u)` float64."""

    def signal(self, t: Tensor) -> Tensor:
        """Give the inputs, `(*batch, n_u)` in [-1, 1], at times `(*batch,)` [s], float64."""
        return (self.offset + self.amplitude * self.wave(t.to(torch.float64))).clamp(-1.0, 1.0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action`, `(*batch, n_u)` float32, for `step_count`, `(*batch, 1)`."""
        t = tensordict.get("step_count").squeeze(-1).to(torch.float64) * self.dt
        return tensordict.set("action", self.signal(t).to(torch.float32))

    def growth(self, steps: Tensor) -> Tensor:
        """Give the share of its strength, in (0, 1], so many control periods after the plant began to be moved.

        Args:
            steps: Control periods, of any shape.
        """
        return (self.first * 2.0 ** (steps.double() / DOUBLES)).clamp_max(1.0)

    def _check_size(self, step: float, parts: int) -> None:
        """Refuse an experiment of more steps [s], each of so many parts, than fit into memory."""
        size = 64.0 * self.n_u * parts * self.duration / step
        check_memory(size, f"excitation.duration={self.duration:g} s in steps of {step:g} s, {parts} values each,")

    def samples(self, dt: float | None = None) -> Tensor:
        """Give the inputs of the whole experiment, `(N, n_u)` float64, sampled every `dt` [s] (default: `self.dt`)."""
        step = self.dt if dt is None else dt
        self._check_size(step, 1)
        return self.signal(torch.arange(round(self.duration / step), dtype=torch.float64) * step)


def _per_input(value: Levels, n_u: int, what: str) -> Tensor:
    """Give one number per input, `(n_u,)` float64."""
    values = torch.as_tensor(value if isinstance(value, float | int) else list(value), dtype=torch.float64).reshape(-1)
    if values.numel() not in (1, n_u):
        raise ValueError(
            f"excitation got {values.numel()} values of {what}; allowed is one, or one for each of {n_u} inputs: "
            "adjust the list"
        )
    if not bool(values.isfinite().all()):
        raise ValueError(f"excitation got {what} {values.tolist()}; allowed are finite numbers: correct them")
    return values.expand(n_u).clone()
