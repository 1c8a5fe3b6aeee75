"""Trust in the model: replay a real episode through it and open or close the gate of planning.

Replayed in windows of one period, that is the paper's reward-error curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.systems import simulate

Bound = Annotated[float, math.inf]
"""A limit, infinite where there is none."""


@dataclass(frozen=True)
class ModelError:
    """How far the model strays from real steps that it was not fitted to.

    Attributes:
        reward_error: Mean absolute difference of the rewards per control period, in the task's unit.
        state_error: Root mean square difference of the states, each divided by its range.
        states: The model's states at the ends of the replayed steps, window by window, `(n, n_x)`.
    """

    reward_error: float
    state_error: float
    states: Tensor


@torch.no_grad()
def replay_error(
    model_env: ControlEnv, episode: TensorDictBase, starts: Tensor | None = None, length: int | None = None
) -> ModelError:
    """Replay a real episode, or windows of it, through the model with the same start, references and actions.

    Args:
        model_env: Environment around the world model.
        episode: Real rollout, `(T,)`, with `state`, `action`, `task_params` and their `next` entries.
        starts: First steps of the windows, `(n_windows,)`; one window from the first step if omitted.
        length: Length of a window [control periods]; all of the episode if omitted.

    Returns:
        The open-loop errors; infinite where the model's states are not finite.
    """
    starts = torch.zeros(1, dtype=torch.int64) if starts is None else starts
    x = episode["state"][starts].to(model_env.float_type)
    params = episode["task_params"][starts].to(x)
    u, x_real, reward_real = (episode[key].to(x) for key in ("action", ("next", "state"), ("next", "reward")))
    scale = torch.tensor(model_env.system.signature.x_scale, dtype=x.dtype)
    places = torch.arange(len(episode) if length is None else length).unsqueeze(-1) + starts
    u = u[places]
    samples, touched = simulate(model_env.system, x, u, model_env.dt, model_env.substeps, model_env.stops)
    following = samples[..., -1, :]
    before, t_next = torch.cat([x.unsqueeze(0), following[:-1]]), (places + 1).unsqueeze(-1).to(x) * model_env.dt
    reward = model_env.task.earned(before, u, following, params, t_next, touched)
    differences = (reward - reward_real[places].squeeze(-1)).abs() / model_env.task.unit
    squares = ((following - x_real[places]) / scale).square().mean(-1)
    errors = torch.stack([differences.mean(), squares.mean().sqrt()])
    reward_error, state_error = errors.nan_to_num(nan=torch.inf, posinf=torch.inf).tolist()
    return ModelError(reward_error, state_error, following.transpose(0, 1).flatten(0, 1))


class Gate:
    """Admit imagined data while the model is trusted, with hysteresis.

    The paper plans once the reward error "is zero". Departure: the gate opens when the reward error of held-out
    real windows, replayed through the model, falls to `open_below`, and closes when it rises above `close_above`.

    Args:
        open_below: Reward error per control period at which a closed gate opens.
        close_above: Reward error per control period above which an open gate closes.
        is_open: Whether the model of the excitation data is trusted before any episode has tested it.

    Raises:
        ValueError: Not 0 <= open_below <= close_above.
    """

    def __init__(self, open_below: Bound = 0.05, close_above: Bound = 0.1, is_open: bool = True) -> None:
        if not 0 <= open_below <= close_above:
            raise ValueError(
                f"the gate needs 0 <= open_below <= close_above, got {open_below} and {close_above}; mend gate"
            )
        self.open_below, self.close_above, self.is_open = open_below, close_above, is_open

    def judge(self, error: ModelError) -> bool:
        """Update the gate with the errors on held-out real steps, if they are known, and return whether it is open."""
        if math.isnan(error.reward_error):
            return self.is_open
        self.is_open = error.reward_error <= (self.close_above if self.is_open else self.open_below)
        return self.is_open
