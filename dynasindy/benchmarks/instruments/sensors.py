"""Data of the plant as sensors with noise would have measured it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase

from dynasindy.data import DynaReplay


class MeasuredReplay(DynaReplay):
    """Replay that keeps noisy states and samples of the real plant; what was rewarded and observed stays.

    Args:
        std: Standard deviation of white noise on each state [unit of the state].
        noise_seed: Seed of the noise.
        **settings: Those of `DynaReplay`.
    """

    def __init__(self, std: Sequence[float], noise_seed: int, **settings: Any) -> None:
        super().__init__(**settings)
        self.std = torch.tensor(list(std), dtype=torch.float64)
        self.rng = torch.Generator().manual_seed(noise_seed)

    def extend_real(self, rollout: TensorDictBase) -> None:
        """Store a real rollout `(steps,)` as measured; each period begins with the sample that ended the last."""
        rows = rollout.clone()
        samples = rows["next", "samples"]
        rows["next", "samples"] = samples + self.std * torch.randn(samples.shape, generator=self.rng).to(samples)
        rows["next", "state"] = rows["next", "samples"][..., -1, :]
        first = rows["state"][:1] + self.std * torch.randn(1, len(self.std), generator=self.rng)
        rows["state"] = torch.cat([first, rows["next", "state"][:-1]])
        super().extend_real(rows)
