"""Fitting the world model, and taking back a refit that predicts held-out real data worse than its forerunner."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import chain

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.dyna.experiment import Components, LoopSettings
from dynasindy.planning import ModelError, replay_error
from dynasindy.progress import report_progress
from dynasindy.systems import Diverged
from dynasindy.systems.transitions import Transitions

WINDOW = 20
"""Control periods of a held-out window: an imagined rollout."""
WORSE = 1.1
"""A refit is worse if its held-out error is larger by this factor: equally good models differ by less."""
NEGLIGIBLE = 1e-5
"""A held-out error that no plan can feel [ranges of the states]."""


@dataclass(frozen=True)
class Refit:
    """What came of a refit.

    Attributes:
        error_before: State error of the earlier model on the held-out windows, in ranges of the states; NaN if none.
        error_after: That of the refitted model.
        kept: Whether the refitted model stays.
        error: Held-out errors of the model that stays; of the earlier model on the whole episode if none is held out,
            and NaN where there is no whole period.
    """

    error_before: float
    error_after: float
    kept: bool
    error: ModelError


def _fit(parts: Components, held_out: Tensor | None = None) -> object:
    """Fit the world model to the real transitions, but those of the newest that are held out, and return its report."""
    report_progress("fit")
    rows = parts.replay.real_in_order()
    if held_out is not None:
        used = torch.ones(len(rows), dtype=torch.bool)
        used[-len(held_out) :] &= ~held_out[-len(rows) :]
        rows = rows[used]
    report = parts.world_model.fit(Transitions.from_periods(rows, parts.model_env.log_dt))
    model = parts.world_model
    for name, learnt in chain(model.named_parameters(), model.named_buffers()):
        if not bool(learnt.isfinite().all()):
            raise Diverged(
                f"model learning: the fit to {len(rows)} real steps left {name} that are not finite in "
                f"{type(model).__name__}; choose a smaller library, or check what the plant logged"
            )
    following = rows["next"]
    parts.plant.task.learn(rows["state"], rows["action"], following["state"], following["reward"].squeeze(-1))
    return report


def first_fit(parts: Components, newest: TensorDictBase) -> object:
    """Fit the world model to all real data, let the observer rely on it, and return its report.

    Args:
        parts: The model and the data.
        newest: What was seen in the excitation, or in the newest episode, `(T,)`.

    Raises:
        Diverged: What the model has learnt is not finite.
    """
    report = _fit(parts)
    _observe(parts, newest)
    return report


def refit(parts: Components, settings: LoopSettings, rollout: TensorDictBase) -> Refit:
    """Fit the world model anew, and go back to the earlier one if that predicts held-out windows better.

    Neither model has seen the windows, which lie in the newest episode; the next refit reads them.

    Args:
        parts: The model and the data, the episode among them.
        settings: Lengths of the loop.
        rollout: The newest real episode, `(T,)`.

    Raises:
        Diverged: The refit is not finite, and no window is held out that would tell the earlier model's error.
    """
    starts = _held_out_windows(rollout.numel(), WINDOW, settings.held_out)
    if not len(starts):
        # A period in which an environment ends at a stop is broken off, and no equation holds in it.
        broken = rollout.numel() < parts.plant.task.max_steps and bool(rollout["next", "at_stop"][-1].any())
        whole = rollout[: rollout.numel() - broken]
        unknown = ModelError(torch.nan, torch.nan, whole["state"])
        unseen = replay_error(parts.model_env, whole) if len(whole) else unknown
        first_fit(parts, rollout)
        return Refit(torch.nan, torch.nan, True, unseen)
    held_out = torch.zeros(rollout.numel(), dtype=torch.bool)
    held_out[(starts.unsqueeze(-1) + torch.arange(WINDOW)).flatten()] = True
    take_back = parts.world_model.kept()
    before, shown_for = replay_error(parts.model_env, rollout, starts, WINDOW), parts.world_model.delay
    try:
        _fit(parts, held_out)
        later = (parts.world_model.delay - shown_for) / parts.plant.dt
        after = replay_error(parts.model_env, _acting(rollout, later), starts, WINDOW)
        kept = after.state_error <= max(WORSE * before.state_error, NEGLIGIBLE)
    except Diverged:  # the worst of refits, and taken back like any other
        after, kept = replace(before, reward_error=torch.inf, state_error=torch.inf), False
    if not kept:
        take_back()
        if parts.plant.task.own:  # a reward is told by all data, whatever became of the model: the gate judges both
            before = replay_error(parts.model_env, rollout, starts, WINDOW)
    _observe(parts, rollout)
    return Refit(before.state_error, after.state_error, kept, after if kept else before)


def _acting(rollout: TensorDictBase, later: float) -> TensorDictBase:
    """Return a real episode with the inputs that acted, if so many periods later; the mean where one changes within."""
    if not later:
        return rollout
    whole = math.floor(later)
    places = torch.arange(rollout.numel()) - whole
    now, before = (
        torch.where((at >= 0).unsqueeze(-1), rollout["action"][at.clamp(0, rollout.numel() - 1)], 0.0)
        for at in (places, places - 1)
    )
    return rollout.copy().set("action", torch.lerp(now, before, later - whole))


def _observe(parts: Components, newest: TensorDictBase) -> None:
    """Adapt the observer, which a delay asks for, to the model on the newest real episode, and estimate that anew."""
    if parts.sensing is None and parts.world_model.delay:
        # The policy is now shown the state for the time at which its action arrives. Real rows stay, as measurements of
        # what was seen. Only the newest are estimated anew, so that of the others no reference has to be known.
        rows, params = parts.replay.real_in_order(), newest["task_params"]
        older = rows[: max(0, len(rows) - len(newest))].exclude("index")
        older["task_params"] = params[:1].expand(len(older), *params.shape[1:]).clone()
        parts.watch()
        for seen in filter(len, (older, newest.copy())):
            parts.replay.extend_real(seen.set("measurement", seen["state"]))
    if parts.sensing is None:
        return
    rows = parts.replay.real_in_order()
    newest = rows[int((rows["step_count"].squeeze(-1) == 0).nonzero().max()) :]
    estimates = parts.sensing.observer.learn(*parts.sensing.measured(newest))
    parts.replay.rewrite_newest(parts.sensing.reestimated(newest, estimates))


def _held_out_windows(steps: int, length: int, every: int) -> Tensor:
    """Return the first steps of the windows to hold out of an episode, `(n_windows,)`."""
    windows = range(every - 1, steps // length, every) if every else ()
    return torch.tensor([*windows], dtype=torch.int64) * length
