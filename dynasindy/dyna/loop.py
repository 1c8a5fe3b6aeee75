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

import torch
from tensordict.nn import TensorDictModuleBase

from dynasindy.dyna.callback import Callback, Episode, Place
from dynasindy.dyna.excite import excite, explore
from dynasindy.dyna.experiment import Components, LoopSettings
from dynasindy.dyna.refit import first_fit, refit
from dynasindy.planning import replay_error
from dynasindy.progress import report_progress, track


def train(
    parts: Components, settings: LoopSettings, callback: Callback, place: Place | None = None
) -> TensorDictModuleBase:
    """Run Algorithm 1.

    Args:
        parts: What it works on; trained in place.
        settings: Its lengths.
        callback: Told of every fit and episode; logging, evaluation, progress and checkpoints hang on it.
        place: Where to go on, with the parts as they were there; the start if omitted. It moves with the run.

    Returns:
        The trained policy.
    """
    agent, replay, planner = parts.agent, parts.replay, parts.planner
    place = place or Place()
    if place.number == 0:
        # Data collection: excite the real system.
        excited = excite(parts)
        # Initialization: B <- D_real; the actor and the critics were drawn with the agent.
        replay.extend_real(excited)
        place.real_steps += excited.numel()
        # Model learning: f_SINDy from D_real.
        callback.fitted(first_fit(parts, excited), excited, place)
        place.number = 1
        callback.reached(place)
    if place.number == 1:
        # Departure: the first planning phase comes before the first episode, with the model of the excitation.
        place.add(planner.plan())
        place.number = 2
        callback.reached(place)
    for number in range(place.episodes + 1, settings.episodes + 1):
        # Real interaction.
        report_progress("real episode")
        rollout = explore(parts)
        replay.extend_real(rollout)
        place.real_steps += rollout.numel()
        # Policy learning.
        updates = round(settings.updates_per_step * rollout.numel()) if planner.learns_by_td3 else 0
        for _ in track("policy learning", range(updates), updates, "updates"):
            agent.update(replay.sample())
        agent.check()
        place.updates += updates
        # Planning: after every N episodes, on the updated model if it is trusted.
        error, refitted = replay_error(parts.model_env, rollout), None
        one_step = replay_error(parts.model_env, rollout, torch.arange(rollout.numel()), 1)
        if planner.due(number):
            refitted = refit(parts, settings, rollout)
            place.add(planner.plan()) if parts.gate.judge(refitted.error) else planner.distrust()
        callback.episode(Episode(number, rollout, error, one_step, parts.gate.is_open, refitted), place)
        place.number += 1
        callback.reached(place)
    # Deployment.
    return agent.deployed
