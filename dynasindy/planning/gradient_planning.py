"""Planning through the model's gradient: the policy learns by back-propagation through imagined rollouts.

The model is a smooth closed-form function, so the derivative of the imagined return by the policy's parameters is
exact (analytic policy gradient; SVG(inf), Heess et al. 2015). Episodes are imagined side by side and carried on from
window to window; the gradient reaches back to the start of each window.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Annotated, Any

import torch
from pydantic import Field
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from dynasindy.agents import TD3, Actor, DynaReplay
from dynasindy.agents.networks import MLP
from dynasindy.envs import ControlEnv, Tracking
from dynasindy.envs.references import Step
from dynasindy.envs.task import FENCE_WIDTH
from dynasindy.limits import Count, Positive, check_memory
from dynasindy.planning.imagined_replay import Planned, Planner
from dynasindy.planning.imitation import Imitation, hold, imagined_rewards, improve
from dynasindy.planning.margins import MarginCost
from dynasindy.planning.plan_settings import LONGEST, UNTOLD, PlanSettings, choose_plan_settings, find_task_equilibria
from dynasindy.planning.rollout import InputStrength, Network, Rows, Window, backward, imagine
from dynasindy.progress import report_progress
from dynasindy.safe_io import checked
from dynasindy.sentences import setting
from dynasindy.systems import Diverged, System

REAL_STARTS, JUMPS = 0.25, 0.25
"""Shares of imagined episodes that begin at real states, and where the last one ended, so that the reference jumps; the
rest begin as the task does."""
DIVERGED = 100.0
"""Multiple of the largest value of each state on the plant beyond which an imagined episode has diverged."""


class _Episodes:
    """Imagined episodes of a planner in a model, begun at staggered times and begun anew when they end."""

    def __init__(self, planner: GradientPlanning, model: System | None = None, number: int | None = None) -> None:
        self.planner, self.env = planner, planner.env if model is None else planner.env.with_system(model)
        self.number = number or planner.rollouts
        self.rows = replace(Rows.draw(planner.env, self.number, planner.rng), kept=True)
        self.diverged = 0
        self.length = planner.env.task.max_steps * planner.env.dt
        self.end = torch.rand(self.number, 1, generator=planner.rng) * self.length
        self.real_states = self.rows.x
        if planner.replay is not None and len(real := planner.replay.real):
            self.real_states = real[:]["state"].to(self.rows.x)
        largest = self.real_states.abs().amax(0)
        if planner.replay is None:  # where episodes begin says nothing of how far they go
            ranges = torch.tensor(planner.env.task.signature.x_scale).to(largest)
            largest = largest.maximum(ranges).where(largest > 0, largest)
        # A state that never moved says nothing of its range.
        self.rows.reach = torch.where(largest > 0, DIVERGED * largest, torch.inf)

    def vary(self, strength: InputStrength | None) -> None:
        """Let the inputs of every episode be late, and of a strength of their own, from now on."""
        planner, rows = self.planner, self.rows
        rows.late = None if planner.held_out.late is None else self._draw_delays()
        rows.strength = None if strength is None else strength.draw(self.number, planner.rng)

    def carry_on(self, window: Window) -> None:
        """Go on from the end of a window; episodes that are over, or that diverged, begin anew."""
        planner, rows, x, held = self.planner, self.rows, window.states[-1], window.actions[-1]
        rows.t = rows.t + planner.pace.window * planner.env.dt
        lost = ~window.alive[-1]
        self.diverged += int(lost.sum())
        new = (rows.t >= self.end - 1e-6).squeeze(-1) | lost
        rows.x = torch.where(new.unsqueeze(-1), self._starts(x, lost), x)
        rows.held = torch.where(lost.unsqueeze(-1), torch.zeros_like(held), held)
        fresh = planner.env.task.sample(new.shape, planner.rng)
        rows.params = torch.where(new.reshape(-1, *[1] * (fresh.dim() - 1)), fresh, rows.params)
        rows.t = rows.t.masked_fill(new.unsqueeze(-1), 0.0)
        if (before := rows.strength) is not None:
            drawn = before.draw(len(new), planner.rng)
            rows.strength = replace(before, factor=drawn.factor.where(new.unsqueeze(-1), before.factor))
        if rows.late is not None:
            rows.late = self._draw_delays().where(new.unsqueeze(-1), rows.late)
        self.end = self.end.masked_fill(new.unsqueeze(-1), self.length)

    def _draw_delays(self) -> Tensor:
        """Draw by how much inputs are late, `(rows, 1)` [control periods]: about one in two, by as much as may be."""
        # What lies between is easier: a policy that is planned with delays drawn evenly has less margin.
        return self.planner.input_delay * (torch.rand(self.number, 1, generator=self.planner.rng) < 0.5).float()

    def _starts(self, x: Tensor, lost: Tensor) -> Tensor:
        """Draw where episodes begin: where the task does, at real states, or where the last one ended."""
        planner = self.planner
        chance = torch.rand(len(x), 1, generator=planner.rng)
        pick = torch.randint(len(self.real_states), (len(x),), generator=planner.rng)
        starts = planner.env.task.initial_state(lost.shape, planner.rng).to(x)
        starts = torch.where(chance < REAL_STARTS, self.real_states[pick], starts)
        return torch.where((chance > 1 - JUMPS) & ~lost.unsqueeze(-1), x, starts)


GIVEN_UP, SHORTER = 0.02, 0.1
"""Fall of the imagined score, or one by the best score's own size if that is more, by which a policy has lost a plant
that has to be held, and the factor on the learning rate then; an error of the whole range costs 4 a period."""
ACCEPTABLE_ERROR, LARGEST_ERROR = 0.005, 10.0
"""Error at the end of imagined episodes up to which a policy is good enough, half of what verdicts ask for, and the
largest one that is told [target ranges]."""
GAIN, LEAST, ROUNDS, FALL = 0.05, 2, 6, 0.3
"""Share of its score that a further round of updates must gain for another one to follow, after how many that is asked,
how many there are at most, and the factor on the learning rate from each to the next."""
SELECT_EVERY = 20
"""Updates from one look at the margins about all equilibria to the next."""
LARGEST_GRADIENT = 0.3
"""Bound of each gradient's norm."""
FENCE = 40.0
"""Cost of leaving the plant's bounds, at which real episodes end and imagined ones do not [per range and period]; an
error of a whole target range costs 4."""


class GradientPlanning(Planner):
    """Improve the agent's actor by its analytic gradient in the model.

    Args:
        env: Imagined environment, `real.with_system(world_model)`.
        agent: Agent whose actor learns, or an actor alone.
        replay: Storages; imagined episodes may begin at real states. None where there are none.
        updates: Gradient updates of the first planning phase; where None, a phase goes on in rounds while imagined
            errors at the end of episodes are large and fall. This, `window`, `lr`, `patience`, `substeps`,
            `warm_start` and `gain_range` follow the plant where they are None, see `dynasindy.planning.plan_settings`.
        more_updates: Gradient updates of each later phase, which goes on from the policy as it is.
        rollouts: Imagined episodes side by side.
        window: Control periods that a gradient reaches back.
        lr: Learning rate of the first phase at its start, 0.3 of it in later ones; it falls along a half cosine to 1 %.
        width: Error at which the imagined cost turns from quadratic to linear [target ranges]; None plans on the
            task's own reward, as does a task without references.
        warm_start: Whether the policy begins as a linear-quadratic regulator of the model, where that earns more.
        gain_range: By what share inputs are weaker or stronger than in the model, at most, in imagined episodes, see
            `dynasindy.planning.rollout`; None for 0.3. Where ways from afar are imitated, as in the model.
        substeps: Runge-Kutta steps per imagined control period.
        check_every: Updates between two tests on held-out imagined references; the best policy is kept.
        patience: Tests in a row without improvement after which a phase ends early; where None, the more the more
            updates are given.
        searches: Most searches for ways that earn more than the policy's, after the updates of a phase, where the task
            tracks no reference.
        input_delay: By how much inputs are late in one imagined episode of two, in control periods, up to 1. Where
            ways from afar are imitated, or the task tracks no reference, they never are.
        others: Other models of the same plant, each of which moves as many imagined episodes as the model.
        every: Episodes between two planning phases.
        seed: Seed of references, starts and variations.

    Attributes:
        centre: Mean observation at the equilibria of the model, about which the policy learns; None without any.

    Raises:
        ValueError: A number is out of range, `warm_start` is asked for and the task tracks no reference, or the
            rollouts do not fit into memory.
    """

    learns_by_td3 = False  # critics know nothing of the imagined windows and would pull the actor away
    # Departure: the paper's reward is quadratic with a bonus; its slope vanishes near zero and the bonus has none.
    # The imagined cost has the task's weights, is linear beyond `width`, and has no bonus; without a width it is the
    # task's own.

    @checked
    def __init__(
        self,
        env: ControlEnv,
        agent: TD3 | Actor,
        replay: DynaReplay | None = None,
        *,
        updates: Count | None = None,
        more_updates: Count = 80,
        rollouts: Positive = 128,
        window: Positive | None = None,
        lr: Annotated[float, Field(gt=0)] | None = None,
        width: Annotated[float, Field(gt=0)] | None = 0.02,
        substeps: Positive | None = None,
        check_every: Positive = 50,
        patience: Positive | None = None,
        warm_start: bool | None = None,
        gain_range: Annotated[float, Field(ge=0, lt=1)] | None = None,
        searches: Count = 16,
        input_delay: Annotated[float, Field(ge=0, le=1)] = 1.0,
        others: Sequence[System] = (),
        every: Positive = 1,
        seed: int = 0,
    ) -> None:
        super().__init__(every)
        given = {"window": window, "lr": lr, "updates": updates, "patience": patience, "substeps": substeps}
        given |= {"warm_start": warm_start, "gain_range": gain_range}
        self.given: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        signature, window = env.system.signature, window or UNTOLD
        check_memory(
            8.0 * rollouts * window * signature.n_x * (signature.n_x + signature.n_u + 4),
            f"{setting('planning.rollouts')}={rollouts} of {setting('planning.window')}={window} periods",
        )
        self.agent, self.replay, self.network = agent, replay, _network(agent.policy)
        if not next(self.network.parameters()).is_cpu:
            self.network = copy.deepcopy(self.network).cpu()  # where machine code moves the model
        self.more_updates, self.searches = more_updates, searches
        self.rollouts = rollouts
        self.check_every = check_every
        self.input_delay, self.others = input_delay, list(others)
        self.rng = torch.Generator().manual_seed(seed)
        task = env.task
        if warm_start and not isinstance(task, Tracking):
            raise ValueError(
                f"task {type(task).__name__} has no targets to hold the plant at; leave out "
                f"{setting('planning.warm_start')}"
            )
        if width is not None and isinstance(task, Tracking):  # a cost whose slope does not vanish near zero
            reward, task = task.reward_function, task.fenced(FENCE)
            task.reward_function = replace(reward, error_shape="linear", width=width, bonus=0.0)
        self.env = ControlEnv(env.system, task, env.dt, substeps or 1)
        self.env.stops = env.stops
        self.held_out = Rows.draw(self.env, 64, torch.Generator().manual_seed(seed + 1))
        self.finest, self.phase = env.substeps, 0
        self.pace = replace(PlanSettings(), **self.given)
        self.margin_cost: MarginCost | None = None
        self.centre: Tensor | None = None

    def plan(self) -> Planned:
        """Improve the actor with the model as it is now.

        Raises:
            Diverged: The phase trained nothing, or no policy of it has a finite return; the actor is as it was.
        """
        first, self.phase = self.phase == 0, self.phase + 1
        if not (self.given.get("updates", 1) if first else self.more_updates):
            return Planned()
        report_progress("planning")
        if (actor := _network(self.agent.policy)) is not self.network:
            self.network.load_state_dict(actor.state_dict())
        rests, was_afar = find_task_equilibria(self.env), self.pace.afar
        suited = choose_plan_settings(self.env, rests, self.finest)
        # Steps of a longer phase stay long for longer, and so do tests that are no better.
        patience = suited.patience * max(1, self.given.get("updates", 0) // max(1, suited.updates))
        window = max(suited.window, min(self.pace.window, suited.longest))  # a longer one stays
        self.pace = pace = replace(suited, **{"patience": patience, "window": window, **self.given})
        self.env.substeps = pace.substeps
        updates, lr = (pace.updates, pace.lr) if first else (self.more_updates, 0.3 * pace.lr)
        self.centre, untouched = None, copy.deepcopy(self.network.state_dict())
        if rests is not None and len(rests) and isinstance(self.network, MLP):
            params = Step(rests.targets.tolist()).sample(torch.Size((len(rests),)), self.rng)
            with torch.no_grad():
                self.centre = self.env.task.observation(rests.x.float(), params, torch.zeros(len(rests), 1)).mean(0)
                if first:  # the kinks of an untrained policy lie about zero, wherever it is to act
                    weight, bias = self.network.layers()[0]
                    bias.sub_(weight @ self.centre)
        episodes = self._begin_episodes()
        rows = self.held_out
        rows.reach, rows.strength, rows.late, self.margin_cost = episodes[0].rows.reach, None, None, None
        if rests is not None and self.input_delay:  # three episodes in time and three that are late, in turn
            rows.late = self.input_delay * (torch.arange(len(rows.x)) // 3 % 2).unsqueeze(-1).float()
        begun, held = Imitation(-math.inf), False
        if rests is not None and pace.warm_start:
            begun, held = hold(self, rests, keep=not first), True
        if begun.afar:
            updates, lr = pace.updates, pace.lr  # a way from afar is new, in a later phase too
        if begun.afar or was_afar:
            self.pace = pace = replace(pace, window=self.given.get("window", LONGEST), afar=True, longest=0)
        best = begun.score
        # A way from afar is timed for the inputs of the model; weaker or later ones would take another way.
        if pace.afar:
            rows.late = None
            best = begun.score if begun.afar else self.test()
        elif rests is not None:
            strength = InputStrength.of(self.env, rests, pace.gain_range)
            for each in episodes:
                each.vary(strength)
            if strength is not None:
                self.margin_cost = MarginCost(self.env, rests)
                rows.strength = strength.ends(len(rows.x))
                # A policy of an earlier phase is given up for a better one only.
                best = self.test() if best > -math.inf or not first else best
        try:
            parts = [begun, self._descend(episodes, best, updates, lr, held)]
        except Diverged:
            self.network.load_state_dict(untouched)
            raise
        gain, longest = parts[-1].score - best, 0 if "window" in self.given else pace.longest
        for k in range(0 if "updates" in self.given else ROUNDS):
            if rests is None:
                break
            leaving = self._leaving_share()
            if not leaving and (self.steady_state_error() or 0.0) <= ACCEPTABLE_ERROR:
                break
            lr = pace.lr * FALL ** (k + 1)
            # The law of the model, where that is better than what the gradient has found and nobody rules it out.
            if not held and self.given.get("warm_start", True):
                parts.append(hold(self, rests))
                held, before = True, self.test()
            else:
                before = parts[-1].score
                # Of a motion that is slower than the window most is behind it, of which the gradient tells nothing.
                if gain <= GAIN * abs(before) and self.pace.window < longest:
                    episodes, lr = self._lengthen_window(longest, episodes), pace.lr
            # As long as those of the first phase: what it has not reached, the few updates of a later one do not.
            # Targets come before margins, and so do bounds, which weaker inputs may not be able to keep.
            self.margin_cost = None
            if leaving:
                weights, varied = copy.deepcopy(self.network.state_dict()), (rows.strength, rows.late)
                rows.strength = rows.late = None
                for each in episodes:
                    each.vary(None)
                before = self.test()
            try:
                parts.append(self._descend(episodes, before, pace.updates, lr, held))
            except Diverged:  # the policy is that of the rounds before
                break
            gain = parts[-1].score - before
            if leaving and self._leaving_share() >= leaving:  # no policy keeps them
                self.network.load_state_dict(weights)
                rows.strength, rows.late = varied
                break
            if k >= LEAST and gain <= GAIN * abs(before) and self.pace.window >= longest:
                break
        if rests is None and self.searches:  # there is no rest that ways could have been searched to
            parts.append(improve(self))
        for policy in (self.agent.policy, self.agent.deployed):  # of an agent on a GPU, or a running average
            if (network := _network(policy)) is not self.network:
                network.load_state_dict(self.network.state_dict())
        self.imagined_error = None if rests is None else self.steady_state_error()
        return Planned(sum(part.imagined for part in parts), sum(part.updates for part in parts))

    def _begin_episodes(self) -> list[_Episodes]:
        """Begin the imagined episodes, fewer where a window was made longer, so that an update costs no more."""
        usual = not self.pace.longest or "window" in self.given
        number = self.rollouts if usual else max(1, self.rollouts * LONGEST // max(LONGEST, self.pace.window))
        # Each moves an equal share, so that no policy can exploit the errors of one.
        models = [None, *self.others][:number]
        shares = torch.arange(number).tensor_split(len(models))
        return [_Episodes(self, model, len(share)) for model, share in zip(models, shares, strict=True)]

    def _lengthen_window(self, window: int, episodes: Sequence[_Episodes]) -> list[_Episodes]:
        """Plan over a longer window from now on, and return the episodes for it, begun anew, as varied as before."""
        strength, self.pace = episodes[0].rows.strength, replace(self.pace, window=window)
        longer = self._begin_episodes()
        for each in longer:
            each.vary(strength)
        return longer

    def settings(self) -> dict[str, Any]:
        """Return the settings of the latest phase and why they are so."""
        return asdict(self.pace) if self.phase else {}

    def state_dict(self) -> dict[str, Any]:
        """Return the phases so far and the generator; episodes and optimiser begin anew in each phase."""
        return {
            "phase": self.phase,
            "pace": asdict(self.pace),
            "imagined_error": self.imagined_error,
            "generator": self.rng.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.phase, self.pace = state["phase"], PlanSettings(**state["pace"])
        self.imagined_error = state.get("imagined_error")  # not in older states
        self.rng.set_state(state["generator"])

    def test(self, network: Network | None = None) -> float:
        """Return the policy's mean reward per control period over held-out imagined references, its inputs limited."""
        rows, task = self.held_out, self.env.task
        whole = imagine(self.env, self._limited(network or self.network), rows, task.max_steps)
        return imagined_rewards(self.env, whole).mean().item()

    def steady_state_error(self) -> float | None:
        """Return the mean error in the last quarter of held-out imagined episodes, of the worst output [target ranges].

        Inputs act as in the model, and references that move are left out; None where all do.
        """
        env, task = self.env, self.env.task
        assert isinstance(task, Tracking)
        rows, last = replace(self.held_out, strength=None, late=None, kept=False), task.max_steps // 4
        params, times = rows.params, env.dt * torch.arange(task.max_steps - last, task.max_steps + 1)
        reference = task.reference(params, times.reshape(-1, 1, 1).expand(-1, len(params), 1))
        rests = (reference == reference[-1]).all(-1).all(0)
        if not bool(rests.any()):
            return None
        whole = imagine(env, self._limited(self.network), rows, task.max_steps)
        error = (whole.states[-last - 1 :][..., task.outputs] - reference).abs() / task.boxes()
        error = error.where(whole.alive[-1, :, None], torch.inf)
        return min(float(error[:, rests].mean((0, 1)).amax()), LARGEST_ERROR)

    def _leaving_share(self) -> float:
        """Return the share of held-out imagined episodes that leave the plant's bounds by more than a little.

        Real episodes end there. Inputs act as in the model.
        """
        task = self.env.task
        assert isinstance(task, Tracking)
        rows = replace(self.held_out, strength=None, late=None, kept=False)
        whole = imagine(self.env, self._limited(self.network), rows, task.max_steps)
        (low, high), size = task.bounds.to(whole.states), whole.states.new_tensor(task.signature.x_scale)
        beyond = (torch.maximum(whole.states - high, low - whole.states) > FENCE_WIDTH * size).any(-1)
        return float((beyond | ~whole.alive).any(0).double().mean()) if bool(task.bounds.isfinite().any()) else 0.0

    def _limited(self, network: Network) -> Network:
        task = self.env.task
        return (lambda observation: task.limit(network(observation))) if task.limited else network

    def _descend(self, episodes: Sequence[_Episodes], best: float, updates: int, lr: float, held: bool) -> Imitation:
        """Follow the gradient, leave the best policy that was tested, and return its score and what it cost."""
        # `best` is the score of the policy as it is, -inf if it was not tested; `held` says that it holds the plant.
        optimizer, rate = _optimizer(self.network, lr), lr
        best_weights, failures, done, made = copy.deepcopy(self.network.state_dict()), 0, 0, 0
        least = self._lack()
        for done in range(1, updates + 1):
            report_progress("planning", done, updates, "updates", f"score {best:.3g}" if math.isfinite(best) else "")
            # Ten steps of warm-up, then half a cosine down to 1 %.
            fall = 0.01 + 0.99 * (0.5 * (1 + math.cos(math.pi * (done - 1) / updates)))
            optimizer.param_groups[0]["lr"] = rate * (min(1.0, done / 10) * fall)
            if done > 1 and done % SELECT_EVERY == 1:
                self._lack()
            made += self._update(episodes, optimizer)
            if done % self.check_every == 0 or done == updates:
                # Without a step so far the rest of the phase would bring none either.
                score = self.test() if made else -math.inf
                lack = self._lack()
                better = score - lack > best - least
                failures = 0 if better else failures + 1
                if better:
                    best, least, best_weights = score, lack, copy.deepcopy(self.network.state_dict())
                elif held and best - score > max(abs(best), GIVEN_UP):
                    # Steps so long that episodes are no longer held: go on from the best policy in shorter ones.
                    rate, failures = SHORTER * rate, 0
                    self.network.load_state_dict(best_weights)
                    optimizer = _optimizer(self.network, rate)
                if failures >= self.pace.patience or not made:
                    break
        self.network.load_state_dict(best_weights)
        windows = done * sum(each.number for each in episodes)
        if best == -math.inf or not (made or held or self.pace.afar):
            lost = sum(each.diverged for each in episodes)
            mend = (
                f"check the task's reward and shorten {setting('planning.window')}, or lower {setting('planning.lr')}"
            )
            if lost == windows:
                mend = (
                    f"the model explodes: add what its findings say it lacks to {setting('plant.library')}, "
                    f"excite longer or with less noise, or shorten {setting('planning.window')}"
                )
            raise Diverged(
                f"planning by gradient: {made} of {done} updates had a finite gradient, {lost} of {windows} imagined "
                f"windows diverged, and no policy has a finite return, so the actor is left as it was; {mend}"
            )
        return Imitation(best, windows * self.pace.window, made)

    def _lack(self) -> float:
        """Return what the policy lacks of its margins, of which later updates follow the gradient."""
        return 0.0 if self.margin_cost is None else self.margin_cost.select(self.network)

    def _update(self, episodes: Sequence[_Episodes], optimizer: torch.optim.Adam) -> bool:
        """Take a gradient step, and return whether it was one: an explosion in the model is no direction."""
        optimizer.zero_grad()
        alive = False
        for each in episodes:
            window = imagine(each.env, self.network, each.rows, self.pace.window)
            backward(each.env, self.network, each.rows, window)
            alive |= bool(window.alive[-1].any())
            each.carry_on(window)
        if self.margin_cost is not None:
            self.margin_cost.add_gradient(self.network)
        # The sum of the models' gradients; for Adam, which takes no account of their size, it is their mean.
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT * len(episodes))
        finite = bool(norm.isfinite())
        if finite:
            self._step(optimizer)
        return finite and alive

    @torch.no_grad()
    def _step(self, optimizer: torch.optim.Adam) -> None:
        """Take the step of a policy that reads observations less the centre."""
        # The weight of a state whose mean is large beside its motion would act as one more bias, at far longer steps.
        if self.centre is None:
            optimizer.step()
            return
        assert isinstance(self.network, MLP)
        weight, bias = self.network.layers()[0]
        if weight.grad is not None and bias.grad is not None:
            weight.grad.addr_(bias.grad, self.centre, alpha=-1)
        bias.add_(weight @ self.centre)
        optimizer.step()
        bias.sub_(weight @ self.centre)


def _optimizer(network: nn.Module, lr: float) -> torch.optim.Adam:
    return torch.optim.Adam(network.parameters(), lr=lr, betas=(0.9, 0.99), fused=True)


def _network(policy: nn.Module) -> nn.Module:
    """Return the bare network of an actor; tensors need no tensordict."""
    assert isinstance(policy, TensorDictModule)
    network = policy.module
    assert isinstance(network, nn.Module)
    return network
