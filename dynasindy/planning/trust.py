"""Trust in the model: replay a real episode through it and open or close the gate of planning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.envs import ControlEnv


@dataclass(frozen=True)
class ModelError:
    """How far the model strays from a real episode that it was not fitted to.

    Args:
        reward_error: Mean absolute difference of the rewards per control period.
        state_error: Root mean square difference of the states, each divided by its range.
        states: The model's states, `(T, n_x)`, to compare with ("next", "state").
    """

    reward_error: float
    state_error: float
    states: Tensor


@torch.no_grad()
def replay_error(model_env: ControlEnv, episode: TensorDictBase) -> ModelError:
    """Replay a real episode through the model with the same start, references and actions.

    Args:
        model_env: Environment around the world model.
        episode: Real rollout, `(T,)`, with `state`, `action`, `task_params` and their `next` entries.

    Returns:
        The open-loop errors; infinite where the model's states are not finite.
    """
    x = episode["state"][0].to(model_env.float_type)
    params = episode["task_params"][0].to(x)
    states, rewards = [], []
    for k, u in enumerate(episode["action"].to(x)):
        samples, touched = model_env.advance(x, u)
        t_next = torch.full((1,), (k + 1) * model_env.dt, dtype=x.dtype)
        rewards.append(model_env.task.reward(x, samples[-1], params, t_next, touched))
        x = samples[-1]
        states.append(x)
    return _errors(model_env, torch.stack(states), torch.stack(rewards), episode)


@torch.no_grad()
def window_error(model_env: ControlEnv, episode: TensorDictBase, starts: Tensor, length: int) -> float:
    """Return how far the model strays within windows of a real episode, each replayed from its real first state.

    Args:
        model_env: Environment around the world model.
        episode: Real rollout, `(T,)`.
        starts: First steps of the windows, `(n_windows,)`.
        length: Length of a window [control periods].

    Returns:
        Root mean square difference of the states, each divided by its range; infinite if not finite.
    """
    x = episode["state"][starts].to(model_env.float_type)
    scale = torch.tensor(model_env.system.signature.x_scale, dtype=x.dtype)
    squares = []
    for k in range(length):
        x = model_env.advance(x, episode["action"][starts + k].to(x))[0][..., -1, :]
        squares.append(((x - episode["next", "state"][starts + k].to(x)) / scale).square().mean())
    return torch.stack(squares).mean().sqrt().nan_to_num(nan=torch.inf, posinf=torch.inf).item()


def _errors(model_env: ControlEnv, states: Tensor, rewards: Tensor, episode: TensorDictBase) -> ModelError:
    scale = torch.tensor(model_env.system.signature.x_scale, dtype=states.dtype)
    strayed = ((states - episode["next", "state"].to(states)) / scale).square().mean().sqrt()
    reward = (rewards - episode["next", "reward"].squeeze(-1).to(rewards)).abs().mean()
    errors = torch.stack([reward, strayed]).nan_to_num(nan=torch.inf, posinf=torch.inf)
    return ModelError(errors[0].item(), errors[1].item(), states)


class Gate:
    """Admit imagined data while the model is trusted, with hysteresis.

    The paper plans once the reward error "is zero". Departure: the gate opens when the reward error of a real
    episode, replayed through the model before the model has seen it, falls to `open_below`, and closes when it
    rises above `close_above`.

    The state error of the same episode must not exceed `state_error` either.

    Args:
        open_below: Reward error per control period at which a closed gate opens.
        close_above: Reward error per control period above which an open gate closes.
        is_open: Whether the model of the excitation data is trusted before any episode has tested it.
        state_error: State error [ranges of the states] above which the gate is closed.

    Raises:
        ValueError: Not 0 <= open_below <= close_above, or state_error is not positive.
    """

    def __init__(
        self,
        open_below: float = 0.1,
        close_above: float = 0.3,
        is_open: bool = True,
        state_error: float = math.inf,
    ) -> None:
        if not 0 <= open_below <= close_above or not state_error > 0:
            raise ValueError(
                f"the gate needs 0 <= open_below <= close_above and state_error > 0, got {open_below}, {close_above} "
                f"and {state_error}; mend gate"
            )
        self.open_below, self.close_above, self.state_error = open_below, close_above, state_error
        self.is_open = is_open

    def judge(self, error: ModelError) -> bool:
        """Update the gate with the errors of the newest real episode, and return whether it is open."""
        bound = self.close_above if self.is_open else self.open_below
        self.is_open = error.reward_error <= bound and error.state_error <= self.state_error
        return self.is_open
