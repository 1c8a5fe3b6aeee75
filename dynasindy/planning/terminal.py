"""What lies beyond an imagined window, as TD3's critics value it (SHAC, Xu et al. 2022)."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor

from dynasindy.agents import TD3
from dynasindy.envs import ControlEnv
from dynasindy.planning.window import Rows, Window

BATCH = 256
"""Imagined transitions per update of the critics."""


class TerminalValue:
    """The agent's first critic at the end of each window; the critics learn from the windows themselves.

    Args:
        env: Imagined environment, whose reward is valued.
        agent: Agent whose critics and targets learn, with its own discount.
        updates: Updates of the critics per window.
        rng: Source of the choice of transitions.
    """

    def __init__(self, env: ControlEnv, agent: TD3, updates: int, rng: torch.Generator) -> None:
        self.env, self.agent, self.updates, self.rng = env, agent, updates, rng

    def learn(self, rows: Rows, window: Window) -> None:
        """Update the critics on transitions of a window that began at `rows`."""
        places = window.alive[1:].nonzero()
        for _ in range(self.updates if len(places) else 0):
            k, i = places[torch.randint(len(places), (BATCH,), generator=self.rng)].unbind(-1)
            self.agent.update_critics(self._transitions(rows, window, k, i))

    def slope(self, rows: Rows, window: Window) -> Tensor:
        """Return the derivative of the window's mean cost by its last states, `(rows, n_x)`.

        The cost is the negative mean reward of the window's periods, so the value counts as much as so many rewards.
        """
        x = window.states[-1].detach().requires_grad_()
        seen = self.env.task.observation(x, rows.params, window.times[-1])
        # Minus the mean over the rows of Q_1(o, pi(o)).
        loss, _ = self.agent.loss.actor_loss(TensorDict({"observation": seen}, [len(seen)]))
        (slope,) = torch.autograd.grad(loss, x)
        return slope / len(window.applied)

    def _transitions(self, rows: Rows, window: Window, k: Tensor, i: Tensor) -> TensorDict:
        """Return the transitions of periods `k` in rows `i`, `(batch,)` each."""
        task, params = self.env.task, rows.params[i]
        x, x_next = window.states[k, i], window.states[k + 1, i]
        now, later = (window.times.expand(-1, len(rows.x), 1)[j, i] for j in (k, k + 1))
        free = torch.zeros(len(k), dtype=torch.bool)
        following = {
            "observation": task.observation(x_next, params, later),
            "reward": task.earned(x, window.actions[k, i], x_next, params, later, free).float().unsqueeze(-1),
            "terminated": torch.zeros(len(k), 1, dtype=torch.bool),
        }
        seen = {"observation": task.observation(x, params, now), "action": window.actions[k, i]}
        return TensorDict({**seen, "next": TensorDict(following, [len(k)])}, [len(k)])
