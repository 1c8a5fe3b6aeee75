"""Replay of real and imagined transitions, mixed in an exact share.

TorchRL's `ReplayBufferEnsemble` mixes in expectation only and cannot sample while a member is empty; a Dyna
agent needs every batch to hold the share it was told, from the first batch before any planning. Rows are written once
an episode or a planning phase, and drawn thousands of times: they lie in the order of time, without a ring.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey

from dynasindy.agents.finite_checks import require_finite_rollout

LEARN_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "truncated"),
)
"""What the agent learns from."""

REAL_KEYS: tuple[NestedKey, ...] = (
    *LEARN_KEYS,
    "state",
    "step_count",
    ("next", "state"),
    ("next", "samples"),
    ("next", "at_stop"),
)
"""What is kept of the real plant: also what identification and planning read."""

MEASURED_KEYS: tuple[NestedKey, ...] = (*REAL_KEYS, "measurement", "task_params")
"""The same of a plant behind sensors, whose `measurement` and `samples` are NaN where nothing was measured."""


class DynaReplay:
    """Real and imagined transitions, sampled together.

    Attributes:
        real: real transitions `(n,)`, the oldest first.
        model: imagined transitions `(n,)`, the oldest first, with `LEARN_KEYS`.
        real_ratio: share of real transitions in every batch, or None for the share they have of all
            transitions (the single buffer of Algorithm 1).

    Args:
        capacity: most real rows, of which the oldest make place for new ones.
        batch_size: transitions per batch.
        real_ratio: see above; [0, 1] or None.
        seed: seed of the sampling.
        keys: keys of a real row, `LEARN_KEYS` among them.
        model_capacity: most imagined rows; `capacity` if not given.
        device: where all of them lie.

    Raises:
        ValueError: a size is not positive, or `real_ratio` is not allowed.
    """

    def __init__(
        self,
        capacity: int,
        batch_size: int,
        real_ratio: float | None = 0.5,
        seed: int = 0,
        keys: Sequence[NestedKey] = REAL_KEYS,
        model_capacity: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        model_capacity = capacity if model_capacity is None else model_capacity
        if min(capacity, batch_size, model_capacity) < 1:
            raise ValueError(
                f"Replay has capacity={capacity}, batch_size={batch_size}, model_capacity={model_capacity}; "
                "give positive numbers."
            )
        if batch_size > capacity:
            raise ValueError(
                f"Replay has batch_size={batch_size} and capacity={capacity}; give a batch that the storage holds."
            )
        if real_ratio is not None and not 0 <= real_ratio <= 1:
            raise ValueError(
                f"Replay has real_ratio={real_ratio}; give a share in [0, 1], or null for a single buffer."
            )
        self.batch_size, self.real_ratio = batch_size, real_ratio
        self.device = torch.device(device)
        # In the CPU's memory, so that a seed draws the same rows on every device.
        self.generator = torch.Generator().manual_seed(seed)
        self.capacity, self.model_capacity = capacity, model_capacity
        self.keys = keys
        self.real, self.model = self._stored({}), self._stored({})

    def extend_real(self, rollout: TensorDictBase) -> None:
        """Store the rows of a real rollout `(*batch, steps)`, of which only the keys of real rows are kept.

        Raises:
            Diverged: a number is not finite.
        """
        rows = rollout.select(*self.keys).reshape(-1)
        require_finite_rollout(rows)
        self.real = self._extended(self.real, rows, self.capacity)

    def extend_model(self, rows: TensorDictBase) -> None:
        """Store imagined rows `(n,)` with `LEARN_KEYS`."""
        self.model = self._extended(self.model, rows.select(*LEARN_KEYS), self.model_capacity)

    def keep(self, keys: Sequence[NestedKey]) -> None:
        """Keep other keys of real rows from now on; the rows so far are forgotten.

        Args:
            keys: Keys of a real row, `LEARN_KEYS` among them.
        """
        self.keys, self.real = keys, self._stored({})

    def rewrite_newest(self, rows: TensorDictBase) -> None:
        """Replace as many of the newest real rows as are given, `(n,)`, as by better estimates of their states."""
        self.real[len(self.real) - len(rows) :] = rows.select(*self.keys).to(self.device)

    def keep_imagined(self, newest: int) -> None:
        """Evict all imagined rows but the `newest`."""
        self.model = self.model[max(0, len(self.model) - newest) :]

    def counts(self) -> tuple[int, int]:
        """Return how many real and how many imagined transitions the next batch holds."""
        real, model = len(self.real), len(self.model)
        if not real or not model:
            return (self.batch_size, 0) if real else (0, self.batch_size)
        share = real / (real + model) if self.real_ratio is None else self.real_ratio
        k = round(share * self.batch_size)
        return k, self.batch_size - k

    def sample(self) -> TensorDict:
        """Draw a batch `(batch_size,)` with `LEARN_KEYS`, its first rows real, uniformly with replacement.

        Raises:
            RuntimeError: both storages are empty.
        """
        if not len(self.real) and not len(self.model):
            raise RuntimeError("Replay is empty; collect real transitions before sampling.")
        drawn = []
        for rows, k in zip((self.real, self.model), self.counts(), strict=True):
            if k:
                places = torch.randint(len(rows), (k,), generator=self.generator).to(self.device)
                drawn.append([rows.get(key).index_select(0, places) for key in LEARN_KEYS])
        columns = [torch.cat(pair) for pair in zip(*drawn)] if len(drawn) == 2 else drawn[0]
        observation, action, next_observation, reward, done, terminated, truncated = columns
        following = {"observation": next_observation, "reward": reward}
        following |= {"done": done, "terminated": terminated, "truncated": truncated}
        size = [self.batch_size]
        return TensorDict({"observation": observation, "action": action, "next": TensorDict(following, size)}, size)

    def state_dict(self) -> dict[str, Any]:
        """Return all rows, and the sampling's generator."""
        rows = {name: getattr(self, name).clone().cpu().to_dict() for name in ("real", "model")}
        return {"generator": self.generator.get_state(), **rows}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.generator.set_state(state["generator"])
        self.real, self.model = self._stored(state["real"]), self._stored(state["model"])

    def _stored(self, rows: dict[str, Any]) -> TensorDict:
        return TensorDict(rows, [len(rows["action"]) if rows else 0], device=self.device)

    def _extended(self, before: TensorDict, rows: TensorDictBase, most: int) -> TensorDict:
        """Return rows with others behind them, of too many the newest."""
        parts = [part for part in (before, rows.to(self.device)) if len(part)]
        whole: TensorDict = torch.cat(parts)[-most:] if parts else before
        return whole
