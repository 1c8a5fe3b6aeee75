"""Swing-ups by agents without a model: Stable-Baselines3's SAC and TD3, judged as the library's own runs are."""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from tensordict import TensorDictBase
from torch import Tensor

from benchmarks.common import add_choices, add_output, add_seeds, commit
from benchmarks.plants import EXAMPLES
from dynasindy.dyna.excite import within
from dynasindy.envs import ControlEnv, Foreign, GymnasiumEnv
from dynasindy.envs.gym import Array, GymControl
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.evaluation.tracking_criteria import LOST, WITHIN, judge_tracking
from dynasindy.safe_io import Row, append_rows, read_rows, write_rows
from dynasindy.tasks import RandomStep, Tracking, TrackingReward

Settings = dict[str, Any]
Targets = dict[str, tuple[float, float]]


class BoundedEpisodes(GymControl):
    """A plant whose episodes also end where a state leaves the task's bounds, as the library's own do."""

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        observation, reward, terminated, truncated, info = super().step(action)
        assert isinstance(self.env.task, Tracking)
        inside = bool(within(torch.from_numpy(info["state"]), *self.env.task.bounds))
        return observation, reward, terminated, truncated or not inside, info


@dataclass(frozen=True)
class SwingUp:
    """What an agent learns on, and how it is judged.

    Attributes:
        steps: Real steps after which a run ends.
        judge: Makes the environment of the evaluations, for a seed.
        learn: Makes that of an agent; None wraps the one of the evaluations.
        angle: Angle from upright [rad], `(...)`, of states `(..., n_x)`; None where nothing stands.
        within: Mean absolute error at the end that is asked for [target ranges].
        settings: Settings of an agent, by its name.
    """

    steps: int
    judge: Callable[[int], ControlEnv]
    learn: Callable[[], gymnasium.Env[Any, Any]] | None = None
    angle: Callable[[Tensor], Tensor] | None = None
    within: float = WITHIN
    settings: dict[str, Settings] = field(default_factory=dict)


def cart_pole(seed: int) -> ControlEnv:
    """Return the plant and the task of `system=swing_up`."""
    spec = importlib.util.spec_from_file_location("plants", EXAMPLES / "plants.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    system = module.CartPole((1.5, 3.0, 3.0, 8.0))
    ends: Settings = {"start": {"theta": [3.04, 3.24]}, "bounds": {"theta": 20.0, "p": 2.4}}
    reward = TrackingReward((4.0,), error_shape="linear")
    box: Settings = {"low": [0.0, 0.0], "high": [0.0, 0.0]}
    task = Tracking(system.signature, RandomStep(**box), ("p", "theta"), ("v", "omega"), reward, **box, **ends)
    return ControlEnv(system, task, dtype=torch.float64, seed=seed)


def of_gymnasium(system: Foreign, targets: Targets, seed: int, dt: float | None = None, **task: Any) -> ControlEnv:
    """Return an environment of Gymnasium under the task of its run.

    Args:
        system: The environment's names and ranges.
        targets: Tracked states, and the ends of their targets.
        seed: Seed of the resets.
        dt: Control period [s]; None for that of the environment.
        **task: More settings of the task.
    """
    low, high = ([ends[side] for ends in targets.values()] for side in (0, 1))
    settings: Settings = {
        "rates": (),
        "reward": TrackingReward((4.0,), error_shape="linear"),
        "low": low,
        "high": high,
    } | task
    tracking = Tracking(system.signature, RandomStep(low, high), list(targets), **settings)
    return GymnasiumEnv(system, tracking, dt=dt, seed=seed)


def pendulum(seed: int) -> ControlEnv:
    """Return Pendulum-v1, to be held upright."""
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"], stops=["w"])
    return of_gymnasium(system, {"c": (1.0, 1.0), "s": (0.0, 0.0)}, seed, max_steps=200)


PENDULUM_SAC: Settings = {"learning_rate": 1e-3}
PENDULUM_TD3 = {"gamma": 0.98, "buffer_size": 200_000, "learning_starts": 10_000, "learning_rate": 1e-3}
TASKS = {
    "pendulum_v1": SwingUp(
        20_000,
        pendulum,
        lambda: gymnasium.make("Pendulum-v1"),
        lambda x: torch.atan2(x[..., 1], x[..., 0]),
        settings={"sac": PENDULUM_SAC, "td3": {"train_freq": 1, "gradient_steps": 1, **PENDULUM_TD3}},
    ),
    "swing_up": SwingUp(
        60_000,
        cart_pole,
        angle=lambda x: torch.remainder(x[..., 1] + math.pi, 2 * math.pi) - math.pi,
        settings={"sac": PENDULUM_SAC},
    ),
}


AGENTS: dict[str, type[OffPolicyAlgorithm]] = {"sac": SAC, "td3": TD3}
EVERY, EPISODES = 1000, 16
"""Real steps between two evaluations, and the episodes of one."""
UPRIGHT = 0.1
"""Angle from upright that a pole may have at the end of an episode [rad]."""
COLUMNS = (
    *("plant", "agent", "seed", "real_steps", "output", "error_percent", "worst_percent", "own_return"),
    *("upright", "held", "cpu_seconds", "commit"),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", tuple(TASKS))
    add_choices(parser, "--agents", tuple(AGENTS))
    add_seeds(parser, 3)
    parser.add_argument("--steps", type=int, help="real steps after which a run ends; a plant's own if omitted")
    add_output(parser, "swing_up")


def main(arguments: argparse.Namespace) -> None:
    """Train the agents that are not finished, and append a row per output and evaluation."""
    torch.set_num_threads(1)
    for agent, plant, seed in product(arguments.agents, arguments.plants, arguments.seeds):
        steps = arguments.steps or TASKS[plant].steps
        if is_finished(arguments.out, {"plant": plant, "agent": agent, "seed": str(seed)}, steps):
            print(f"finished before: {plant}, {agent}, seed {seed}", flush=True)
        else:
            train(plant, agent, seed, steps, arguments.out)


def is_finished(path: Path, job: Row, steps: int) -> bool:
    """Return whether a run has ended; the rows of one that was stopped before are taken away."""
    rows = read_rows(path)
    mine = [row for row in rows if job.items() <= row.items()]
    if any(row["held"] == "1" or int(row["real_steps"]) >= steps for row in mine):
        return True
    if mine:
        write_rows(path, COLUMNS, [row for row in rows if row not in mine])
    return False


def train(plant: str, kind: str, seed: int, steps: int, out: Path) -> None:
    """Train an agent until it holds the plant or has made its real steps, and append what each evaluation shows."""
    swing, spent = TASKS[plant], 0.0
    agent, env = build(swing, kind, seed), swing.judge(seed)
    while agent.num_timesteps < steps:
        before = time.process_time()
        agent.learn(EVERY, reset_num_timesteps=False)
        spent += time.process_time() - before
        head = {"plant": plant, "agent": kind, "seed": seed, "real_steps": agent.num_timesteps}
        tail = {"cpu_seconds": round(spent, 1), "commit": commit()}
        rows = [head | row | tail for row in rows_of(swing, run(env, agent, swing))]
        append_rows(out, COLUMNS, rows)
        print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
        if rows[0]["held"]:
            return


def build(swing: SwingUp, kind: str, seed: int) -> OffPolicyAlgorithm:
    """Return an agent with the environment that it learns on; TD3 explores with noise, as by default it does not."""
    env = BoundedEpisodes(swing.judge(seed)) if swing.learn is None else swing.learn()
    settings: Settings = dict(swing.settings.get(kind, {}))
    if kind == "td3":
        (n_u,) = env.action_space.shape or (1,)
        settings["action_noise"] = NormalActionNoise(np.zeros(n_u), np.full(n_u, 0.1))
    agent = AGENTS[kind](policy="MlpPolicy", env=env, seed=seed, device="cpu", **settings)
    agent.set_logger(configure(None, []))
    return agent


def run(env: ControlEnv, agent: OffPolicyAlgorithm, swing: SwingUp) -> Evaluation:
    """Run an agent, without noise, in episodes of the task.

    Args:
        env: The plant.
        agent: What acts.
        swing: Tells whether it sees the states, as in the Gymnasium environment that it learns on, and how.
    """
    space = agent.action_space
    assert isinstance(space, spaces.Box)
    low, high = space.low, space.high

    def _act(tensordict: TensorDictBase) -> TensorDictBase:
        seen = tensordict["observation" if swing.learn is None else "state"]
        action, _ = agent.predict(seen.float().numpy(), deterministic=True)
        return tensordict.set("action", torch.from_numpy(2 * (action - low) / (high - low) - 1))

    return evaluate(env, _act, Scenario("step", None, EPISODES, None))


def rows_of(swing: SwingUp, evaluation: Evaluation) -> list[Row]:
    """Return a row per output: its error at the end, and what holds of all of them."""
    found = judge_tracking(evaluation, torch.ones(evaluation.signature.n_x, dtype=torch.bool))
    share, worst = ({k: math.inf if v is None else v for k, v in d.items()} for d in (found.share, found.worst))
    near = all(v <= swing.within for v in share.values()) and all(v <= LOST * swing.within for v in worst.values())
    last = round(evaluation.steady_seconds / (evaluation.seconds / len(evaluation.time)))
    own, states = evaluation.own_returns, evaluation.trajectory["state"][:, -last:]
    of_all = {
        "own_return": "" if own is None else round(float(own.mean()), 2),
        "upright": "" if swing.angle is None else int((swing.angle(states).abs() <= UPRIGHT).all()),
        "held": int(near),
    }
    return [
        {"output": name, "error_percent": f"{100 * share[name]:.3g}", "worst_percent": f"{100 * worst[name]:.3g}"}
        | of_all
        for name in share
    ]
