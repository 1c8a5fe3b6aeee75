"""Swing-ups by agents without a model: Stable-Baselines3's SAC and TD3, judged as the library's own runs are."""

from __future__ import annotations

import argparse
import math
import time
from itertools import product
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from tensordict import TensorDictBase

from benchmarks.commit import commit
from benchmarks.swings import SWINGS, Fenced, Settings, Swing
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.held import LOST, held
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.safe_io import Row, append_rows, read_rows, write_rows

AGENTS: dict[str, type[OffPolicyAlgorithm]] = {"sac": SAC, "sac_bullet": SAC, "td3": TD3}
EVERY, EPISODES = 1000, 16
"""Real steps between two evaluations, and the episodes of one."""
UPRIGHT = 0.1
"""Angle from upright that a pole may have at the end of an episode [rad]."""
COLUMNS = (
    *("plant", "agent", "seed", "real_steps", "output", "error_percent", "worst_percent", "own_return"),
    *("upright", "held", "cpu_seconds", "commit"),
)


def main(arguments: argparse.Namespace) -> None:
    """Train the agents that are not finished, and append a row per output and evaluation."""
    torch.set_num_threads(1)
    for agent, plant, seed in product(arguments.agents, arguments.plants, arguments.seeds):
        if agent == "sac_bullet" and agent not in SWINGS[plant].settings:
            continue  # the settings of another plant
        steps = arguments.steps or SWINGS[plant].steps
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
    swing, spent = SWINGS[plant], 0.0
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


def build(swing: Swing, kind: str, seed: int) -> OffPolicyAlgorithm:
    """Return an agent with the environment that it learns on; TD3 explores with noise, as by default it does not."""
    env = Fenced(swing.judge(seed)) if swing.learn is None else swing.learn()
    settings: Settings = dict(swing.settings.get(kind, {}))
    if kind == "td3":
        (n_u,) = env.action_space.shape or (1,)
        settings["action_noise"] = NormalActionNoise(np.zeros(n_u), np.full(n_u, 0.1))
    agent = AGENTS[kind](policy="MlpPolicy", env=env, seed=seed, device="cpu", **settings)
    agent.set_logger(configure(None, []))
    return agent


def run(env: ControlEnv, agent: OffPolicyAlgorithm, swing: Swing) -> Evaluation:
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
        seen = seen if swing.seen is None else swing.seen(seen)
        action, _ = agent.predict(seen.float().numpy(), deterministic=True)
        return tensordict.set("action", torch.from_numpy(2 * (action - low) / (high - low) - 1))

    return evaluate(env, _act, Scenario("step", None, EPISODES, None))


def rows_of(swing: Swing, evaluation: Evaluation) -> list[Row]:
    """Return a row per output: its error at the end, and what holds of all of them."""
    found = held(evaluation, torch.ones(evaluation.signature.n_x, dtype=torch.bool))
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
