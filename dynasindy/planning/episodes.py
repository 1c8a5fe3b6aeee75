"""Imagined episodes side by side, which a policy is planned on: where they begin, go on, and begin anew."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.planning.margin import Margin
from dynasindy.planning.variation import Members, Varied
from dynasindy.planning.window import Rows
from dynasindy.systems import System

if TYPE_CHECKING:
    from dynasindy.planning.gradient import GradientPlanning

DIVERGED = 100.0
"""Multiple of the largest value of each state on the plant beyond which an imagined episode has diverged."""


class Episodes:
    """Imagined episodes side by side, begun at staggered times and begun anew when they end.

    Attributes:
        diverged: Windows that have diverged so far.
        margin: How strong inputs may be, set by `vary`; None for that of the model.

    Args:
        planner: Whose episodes they are.
    """

    def __init__(self, planner: GradientPlanning) -> None:
        self.planner = planner
        self.margin: Margin | None = None
        self.rows = references(planner.env, planner.rollouts, planner.rng)
        self.rows.kept = True
        self.system: System = planner.env.system
        if planner.others:
            self.system = Members([self.system, *planner.others])
        if planner.variation.parameters:
            self.system = Varied(self.system, planner.variation.parameters, planner.rollouts)
            self.system.draw(torch.ones(planner.rollouts, dtype=torch.bool), planner.rng)
        self.diverged = 0
        self.length = planner.env.task.max_steps * planner.env.dt
        self.end = torch.rand(planner.rollouts, 1, generator=planner.rng) * self.length
        self.real_states = self.rows.x
        if planner.replay is not None and len(real := planner.replay.real):
            self.real_states = real[:]["state"].to(self.rows.x)
        largest = self.real_states.abs().amax(0)
        if planner.replay is None:  # where episodes begin says nothing of how far they go
            ranges = torch.tensor(planner.env.task.signature.x_scale).to(largest)
            largest = largest.maximum(ranges).where(largest > 0, largest)
        # A state that never moved says nothing of its range.
        self.rows.reach = torch.where(largest > 0, DIVERGED * largest, torch.inf)

    def vary(self, margin: Margin | None) -> None:
        """Let the inputs of every episode be late, and of a strength of their own, from now on.

        Args:
            margin: Draws the strengths; None leaves them those of the model.
        """
        planner, rows = self.planner, self.rows
        rows.late = planner.variation.delays(planner.rollouts, planner.rng)
        if margin is not None:
            self.margin = margin
            rows.strength = margin.draw(rows.params, planner.rng)

    def carry_on(self, x: Tensor, held: Tensor, alive: Tensor) -> None:
        """Go on from the end of a window; episodes that are over, or that diverged, begin anew."""
        planner, rows = self.planner, self.rows
        rows.t = rows.t + planner.pace.window * planner.env.dt
        lost = ~alive
        new = (rows.t >= self.end - 1e-6).squeeze(-1) | lost
        rows.x = torch.where(new.unsqueeze(-1), self._starts(x, lost), x)
        rows.held = torch.where(lost.unsqueeze(-1), torch.zeros_like(held), held)
        fresh = planner.env.task.sample(new.shape, planner.rng)
        rows.params = torch.where(new.reshape(-1, *[1] * (fresh.dim() - 1)), fresh, rows.params)
        rows.t = rows.t.masked_fill(new.unsqueeze(-1), 0.0)
        if self.margin is not None and rows.strength is not None:
            rows.strength = rows.strength.where(new, self.margin.draw(rows.params, planner.rng))
        if rows.late is not None and (delays := planner.variation.delays(len(new), planner.rng)) is not None:
            rows.late = delays.where(new.unsqueeze(-1), rows.late)
        self.end = self.end.masked_fill(new.unsqueeze(-1), self.length)
        if isinstance(self.system, Varied):
            self.system.draw(new, planner.rng)

    def _starts(self, x: Tensor, lost: Tensor) -> Tensor:
        """Draw where episodes begin: where the task does, at real states, or where the last one ended."""
        planner = self.planner
        chance = torch.rand(len(x), 1, generator=planner.rng)
        pick = torch.randint(len(self.real_states), (len(x),), generator=planner.rng)
        starts = planner.env.task.initial_state(lost.shape, planner.rng).to(x)
        starts = torch.where(chance < planner.real_starts, self.real_states[pick], starts)
        return torch.where((chance > 1 - planner.jumps) & ~lost.unsqueeze(-1), x, starts)


def references(env: ControlEnv, rows: int, rng: torch.Generator) -> Rows:
    """Return rows at the start of the task, with drawn references."""
    batch = torch.Size((rows,))
    x = env.task.initial_state(batch, rng).to(torch.float32)
    params = env.task.sample(batch, rng)
    return Rows(x, torch.zeros(rows, env.system.signature.n_u), params, torch.zeros(rows, 1))
