"""The first number of a rollout on the plant that is not finite, and what it came from."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from dynasindy.systems import Diverged

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


def is_finite_rollout(rollout: TensorDictBase) -> bool:
    """Return whether all that may go wrong in a rollout of any batch is finite."""
    return not any(bool(bad.any()) for bad in _non_finite(rollout).values())


def _non_finite(rows: TensorDictBase) -> dict[NestedKey, Tensor]:
    """Return which numbers of each key are not finite; of what sensors measure, NaN says that nothing was measured."""
    present, found = set(rows.keys(include_nested=True, leaves_only=True)), dict[NestedKey, Tensor]()
    for key in (key for key, *_ in SUSPECTS if key in present):
        measured = key == ("next", "samples") and "measurement" in present
        found[key] = rows.get(key).isinf() if measured else ~rows.get(key).isfinite()
    return found


def require_finite_rollout(rows: TensorDictBase, where: str = "plant") -> None:
    """Refuse a rollout on the plant that holds a number that is not finite.

    Args:
        rows: Control periods `(n,)` in the order of time, with `step_count`.
        where: Place in the run, with which the message begins.

    Raises:
        Diverged: A number is not finite; the first one is told, with the state, the input and the period.
    """
    bad = {key: found.flatten(1).any(-1) for key, found in _non_finite(rows).items()}
    first = min((int(found.int().argmax()) for found in bad.values() if bool(found.any())), default=None)
    if first is None:
        return
    key, what, of, mend = next(suspect for suspect in SUSPECTS if suspect[0] in bad and bool(bad[suspect[0]][first]))
    row = rows[first]
    told = f"{what} {_numbers(row[key])}, from {_name(of)} {_numbers(row[of])} under input {_numbers(row['action'])}"
    raise Diverged(f"{where}: in control period {int(row['step_count']) + 1} {told}; {mend}")


def _numbers(values: Tensor) -> str:
    """Return the last numbers along all but the last dimension, three digits each."""
    return "[" + ", ".join(f"{value:.3g}" for value in values.reshape(-1, values.shape[-1])[-1].tolist()) + "]"


def _name(key: NestedKey) -> str:
    return key if isinstance(key, str) else key[-1]
