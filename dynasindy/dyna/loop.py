"""Algorithm 1 of the paper: the Dyna-style SINDy-TD3 framework.

| name                | symbol          | unit            | Algorithm 1           |
| ------------------- | --------------- | --------------- | --------------------- |
| `env`               | real system     | -               | line 7                |
| `excitation`        | u(t)            | normalised      | line 3                |
| `world_model`       | f_SINDy(x, u)   | SI              | lines 4, 10           |
| `agent`             | pi_phi, Q_theta | -               | lines 5, 7, 9         |
| `replay`            | B               | -               | lines 5, 8, 10        |
| `planner.every`     | N               | episodes        | line 10               |
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.data.recording import transitions
from dynasindy.dyna.callback import Callback, Cost, Episode
from dynasindy.envs import ControlEnv
from dynasindy.excitation import Excitation
from dynasindy.planning import Gate, Planner, replay_error
from dynasindy.world_models import WorldModel


@dataclass
class Parts:
    """What Algorithm 1 works on.

    Args:
        plant: Real environment.
        env: The same, with the model's one-step prediction beside every step.
        model_env: The same environment around the world model.
        excitation: Input signal of the data collection.
        world_model: Model to fit.
        agent: TD3 agent.
        replay: Real and model storages.
        planner: Dyna's planning phase.
        gate: Trust in the model.
    """

    plant: ControlEnv
    env: EnvBase
    model_env: ControlEnv
    excitation: Excitation
    world_model: WorldModel
    agent: TD3
    replay: DynaReplay
    planner: Planner
    gate: Gate


@dataclass(frozen=True)
class Settings:
    """Lengths of the loop.

    Args:
        episodes: Real episodes after the excitation.
        updates_per_step: Gradient updates per real step (update-to-data ratio).
        recent_steps: Newest real steps that a refit reads; all if None.

    Raises:
        ValueError: A number is negative, or recent_steps is not positive.
    """

    episodes: int
    updates_per_step: float = 1.0
    recent_steps: int | None = None

    def __post_init__(self) -> None:
        if self.episodes < 0 or not self.updates_per_step >= 0 or (self.recent_steps or 1) < 1:
            raise ValueError(
                f"train needs episodes >= 0, updates_per_step >= 0 and recent_steps >= 1 or null, got {self}; "
                "mend train"
            )


def train(parts: Parts, settings: Settings, callback: Callback) -> TensorDictModuleBase:
    """Run Algorithm 1.

    Args:
        parts: What it works on; trained in place.
        settings: Its lengths.
        callback: Told of every fit and episode; logging, evaluation and progress hang on it.

    Returns:
        The trained policy.
    """
    env, agent, replay, planner = parts.env, parts.agent, parts.replay, parts.planner
    cost = Cost()
    # Data collection: excite the real system.
    excited = interact(env, parts.excitation, parts.excitation.n_steps)
    # Initialization: B <- D_real; the actor and the critics were drawn with the agent.
    replay.extend_real(excited)
    cost.real_steps += excited.numel()
    # Model learning: f_SINDy from D_real.
    callback.fitted(fit(parts, settings), excited, cost)
    # Departure: the first planning phase comes before the first episode, with the model of the excitation.
    cost.add(planner.plan())
    for number in range(1, settings.episodes + 1):
        # Real interaction.
        rollout = interact(env, agent.explore, parts.model_env.task.max_steps)
        replay.extend_real(rollout)
        cost.real_steps += rollout.numel()
        # Policy learning.
        for _ in range(round(settings.updates_per_step * rollout.numel()) if planner.learns_by_td3 else 0):
            agent.update(replay.sample())
            cost.updates += 1
        # Planning: after every N episodes, on the updated model if it is trusted.
        error = replay_error(parts.model_env, rollout)
        if planner.due(number):
            fit(parts, settings)
            cost.add(planner.plan()) if parts.gate.judge(error) else planner.distrust()
        callback.episode(Episode(number, rollout, error, parts.gate.is_open), cost)
    # Deployment.
    return agent.deployed


def interact(env: EnvBase, policy: TensorDictModuleBase, steps: int) -> TensorDict:
    """Run a policy, exploring, on the real system for at most one episode, `(T,)`."""
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        return env.rollout(steps, policy)


def fit(parts: Parts, settings: Settings) -> object:
    """Fit the world model to the recent real transitions and return its report."""
    rows = parts.replay.real[:]
    if settings.recent_steps is not None:
        rows = rows[-settings.recent_steps :]
    return parts.world_model.fit(transitions(rows, parts.model_env.log_dt))
