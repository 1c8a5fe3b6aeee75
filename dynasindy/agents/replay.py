"""Replay with separate storages for real and imagined transitions, mixed in an exact share.

TorchRL's `ReplayBufferEnsemble` mixes in expectation only and cannot sample while a member is empty; a Dyna
agent needs every batch to hold the share it was told, from the first batch before any planning.
"""

from collections.abc import Sequence
from typing import Annotated, Any

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, TensorDictRoundRobinWriter

from dynasindy.safe_io import checked
from dynasindy.systems import Diverged

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


EQUATIONS = "check the plant's equations there, simulate it in more env.substeps, or excite it less"
SUSPECTS: tuple[tuple[NestedKey, str, NestedKey, str], ...] = (
    ("state", "the initial state is", "step_count", "check the task's initial states"),
    ("observation", "the observation is", "state", "check the task's observation of this state"),
    ("action", "the policy's action is", "observation", "check the policy's weights and lower its learning rates"),
    (("next", "samples"), "the plant moves to", "state", EQUATIONS),
    (("next", "state"), "the plant ends at", "state", EQUATIONS),
    (("next", "reward"), "the reward is", ("next", "state"), "check the task's reward there"),
    (("next", "observation"), "the observation is", ("next", "state"), "check the plant and the task there"),
)
"""What may go wrong within a control period, in the order of cause and effect: the number, what it follows from."""


def require_finite_rollout(rows: TensorDictBase, where: str = "plant") -> None:
    """Refuse a rollout on the plant that holds a number that is not finite.

    Args:
        rows: Control periods `(n,)` in the order of time, with `step_count`.
        where: Place in the run, with which the message begins.

    Raises:
        Diverged: A number is not finite; the first one is told, with the state, the input and the period.
    """
    present, bad = set(rows.keys(include_nested=True, leaves_only=True)), dict[NestedKey, Tensor]()
    for key in (key for key, *_ in SUSPECTS if key in present):
        measured = key == ("next", "samples") and "measurement" in present  # NaN says that nothing was measured
        bad[key] = (rows.get(key).isinf() if measured else ~rows.get(key).isfinite()).flatten(1).any(-1)
    first = min((int(found.int().argmax()) for found in bad.values() if bool(found.any())), default=None)
    if first is None:
        return
    key, what, of, mend = next(suspect for suspect in SUSPECTS if suspect[0] in bad and bool(bad[suspect[0]][first]))
    row = rows[first]
    name = of if isinstance(of, str) else of[-1]
    told = f"{what} {_numbers(row[key])}, from {name} {_numbers(row[of])} under input {_numbers(row['action'])}"
    raise Diverged(f"{where}: in control period {int(row['step_count']) + 1} {told}; {mend}")


def _numbers(values: Tensor) -> str:
    """Return the last numbers along all but the last dimension, three digits each."""
    return "[" + ", ".join(f"{value:.3g}" for value in values.reshape(-1, values.shape[-1])[-1].tolist()) + "]"


Rows = Annotated[int, Field(ge=1)]


class _Writer(TensorDictRoundRobinWriter):
    """Writer of any number of rows, none among them: a model may diverge at once in every rollout."""

    def extend(self, data: TensorDictBase) -> Tensor:
        """Write rows `(n,)`."""
        return super().extend(data) if len(data) else torch.zeros(0, dtype=torch.int64)


class DynaReplay:
    """Real and imagined transitions, sampled together.

    Attributes:
        real: buffer of real transitions, with `keys`.
        model: buffer of imagined transitions, with `LEARN_KEYS`; a transform appended to it may turn what is
            written (start states) into what is stored; `model.empty()` evicts all.
        real_ratio: share of real transitions in every batch, or None for the share they have of all
            transitions (the single buffer of Algorithm 1).

    Args:
        capacity: rows of the real storage.
        batch_size: transitions per batch.
        real_ratio: see above; [0, 1] or None.
        seed: seed of the sampling.
        keys: keys of a real row, `LEARN_KEYS` among them.
        model_capacity: rows of the model storage, a ring in which new rows replace the oldest;
            `capacity` if not given.
        device: device of the storages.

    Raises:
        ValueError: a size is not positive, or `real_ratio` is not allowed.
    """

    @checked
    def __init__(
        self,
        capacity: Rows,
        batch_size: Rows,
        real_ratio: Annotated[float, Field(ge=0, le=1)] | None = 0.5,
        seed: int = 0,
        keys: Sequence[NestedKey] = REAL_KEYS,
        model_capacity: Rows | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if batch_size > capacity:
            raise ValueError(f"replay.batch_size is {batch_size}; give a batch that replay.capacity={capacity} holds")
        self.batch_size, self.real_ratio = batch_size, real_ratio
        self.device = torch.device(device)
        # In the CPU's memory, so that a seed draws the same rows on every device.
        self.generator = torch.Generator().manual_seed(seed)
        self.real, self.keys = self._buffer(capacity), tuple(keys)
        self.model = self._buffer(model_capacity or capacity)

    def extend_real(self, rollout: TensorDictBase) -> None:
        """Store the rows of a real rollout `(*batch, steps)`, of which only the storage's keys are kept.

        Raises:
            Diverged: a number is not finite.
        """
        rows = rollout.select(*self.keys).reshape(-1)
        require_finite_rollout(rows)
        self.real.extend(rows)

    def real_in_order(self) -> TensorDict:
        """Return a copy of the real rows, `(n,)`, the oldest first, in the CPU's memory."""
        return _in_order(self.real).cpu()

    def keep(self, keys: Sequence[NestedKey]) -> None:
        """Keep other keys of real rows from now on; the rows so far are forgotten.

        Args:
            keys: Keys of a real row, `LEARN_KEYS` among them.
        """
        self.real, self.keys = self._buffer(self.real.storage.max_size), tuple(keys)

    def rewrite_newest(self, rows: TensorDictBase) -> None:
        """Replace the newest real rows, as by better estimates of their states.

        Args:
            rows: As many rows as are to be replaced, `(n,)`, in the order of time.
        """
        places = (self.real.writer._cursor - len(rows) + torch.arange(len(rows))) % self.real.storage.max_size
        self.real.storage.set(places, rows, set_cursor=False)

    def keep_imagined(self, newest: int) -> None:
        """Evict all imagined rows but the `newest`."""
        if newest >= len(self.model):
            return
        rows = _in_order(self.model)[len(self.model) - newest :] if newest else None
        self.model.empty()
        if rows is not None:
            self.model.writer.extend(rows.exclude("index"))  # past the transform, which would imagine anew

    def counts(self) -> tuple[int, int]:
        """Return how many real and how many imagined transitions the next batch holds."""
        real, model = len(self.real), len(self.model)
        if not real or not model:
            return (self.batch_size, 0) if real else (0, self.batch_size)
        share = real / (real + model) if self.real_ratio is None else self.real_ratio
        k = round(share * self.batch_size)
        return k, self.batch_size - k

    def sample(self) -> TensorDict:
        """Draw a batch `(batch_size,)` with `LEARN_KEYS`, its first rows real, uniformly with replacement."""
        drawn = []
        for buffer, k in zip((self.real, self.model), self.counts(), strict=True):
            if k:
                places = torch.randint(len(buffer), (k,), generator=self.generator).to(self.device)
                stored = buffer.storage._storage
                drawn.append([stored.get(key).index_select(0, places) for key in LEARN_KEYS])
        columns = [torch.cat(pair) for pair in zip(*drawn)] if len(drawn) == 2 else drawn[0]
        observation, action, next_observation, reward, done, terminated, truncated = columns
        following = {"observation": next_observation, "reward": reward}
        following |= {"done": done, "terminated": terminated, "truncated": truncated}
        size = [self.batch_size]
        return TensorDict({"observation": observation, "action": action, "next": TensorDict(following, size)}, size)

    def state_dict(self) -> dict[str, Any]:
        """Return the written rows of both storages, and the sampling's generator."""
        buffers = {"real": self.real, "model": self.model}
        state: dict[str, Any] = {"generator": self.generator.get_state()}
        for name, buffer in buffers.items():
            rows = buffer[:].clone().cpu().to_dict() if len(buffer) else {}
            state[name] = {"rows": rows, "writer": buffer.writer.state_dict()}
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.generator.set_state(state["generator"])
        for name, buffer in (("real", self.real), ("model", self.model)):
            buffer.empty()
            if rows := state[name]["rows"]:
                stored = TensorDict(rows, batch_size=[len(rows["action"])]).to(self.device)
                buffer.storage.set(range(len(stored)), stored)
            buffer.writer.load_state_dict(state[name]["writer"])

    def _buffer(self, capacity: int) -> TensorDictReplayBuffer:
        return TensorDictReplayBuffer(
            storage=LazyTensorStorage(capacity, device=self.device),
            writer=_Writer(),
            batch_size=self.batch_size,
            generator=self.generator,
        )


def _in_order(buffer: TensorDictReplayBuffer) -> TensorDict:
    """Return a copy of the rows of a ring, the oldest first."""
    rows: TensorDict = buffer.storage.get(slice(0, len(buffer)))
    cursor = buffer.writer._cursor % len(buffer)
    begun: TensorDict = torch.cat([rows[cursor:], rows[:cursor]])
    return begun
