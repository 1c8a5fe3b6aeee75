"""Agents without a model in the ablation: Stable-Baselines3's SAC and TD3, on what `experiment=dyna` learns on.

Plant, task, reward, excitation, episodes, evaluation and level are those of the ablation; so is the layout of the run
folders, from which its tables are made. A run that is finished is not repeated. The 200 periods of the excitation are
counted as real and stand in the agent's replay buffer before its first episode: it learns from the first period on.
Agents have the settings of Stable-Baselines3, but for two: a name that ends in `_5` makes five updates per period, as
the ablation does, and TD3 explores with Gaussian noise of 0.1 as published, since by default it does not explore.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from tensordict import TensorDict, TensorDictBase

from benchmarks.common import RESULTS, add_choices, add_seeds, commit
from benchmarks.gradient import PLANTS, Plant
from dynasindy.dyna.excite import interact
from dynasindy.dyna.folder import check_settings, claimed, clear
from dynasindy.envs import ControlEnv
from dynasindy.envs.gym import GymControl
from dynasindy.evaluation.ablation import Level, gather, read_ablation
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate, step_references
from dynasindy.evaluation.summary import Summary, summarise
from dynasindy.excitation import Chirp
from dynasindy.safe_io import write_csv, write_json, write_text
from dynasindy.tasks import RandomStep, Tracking, TrackingReward
from dynasindy.viz.ablation import draw_ablation

EXPERIMENT = "dyna"
MODEL_COLUMNS = ("one_step_reward_error", "reward_error", "state_error", "model_trusted")
"""Columns of the ablation's curves that nothing without a model can fill."""


def _td3(n_u: int, **settings: Any) -> OffPolicyAlgorithm:
    return TD3(action_noise=NormalActionNoise(np.zeros(n_u), np.full(n_u, 0.1)), **settings)


def _sac(n_u: int, **settings: Any) -> OffPolicyAlgorithm:
    return SAC(**settings)


AGENTS: dict[str, Callable[..., OffPolicyAlgorithm]] = {
    "sac_5": partial(_sac, gradient_steps=5),
    "sac": partial(_sac, gradient_steps=1),
    "td3_5": partial(_td3, gradient_steps=5),
    "td3": partial(_td3, gradient_steps=1),
}


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        plant: Name of the plant.
        agent: Name of the agent.
        seed: Seed of the plant's references, the networks, the noise and the batches.
        episodes: Real episodes after the excitation.
    """

    plant: str
    agent: str
    seed: int
    episodes: int

    def folder(self, root: Path) -> Path:
        """Return its run folder, where the ablation looks for it."""
        return root / self.plant / EXPERIMENT / f"sb3_{self.agent}" / f"seed_{self.seed}"

    @property
    def settings(self) -> str:
        """What `config.yaml` holds, by which a finished run is known."""
        return "".join(f"{key}: {value}\n" for key, value in asdict(self).items())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", ("xi", "tras"))
    add_choices(parser, "--agents", tuple(AGENTS))
    add_seeds(parser, 5)
    parser.add_argument("--episodes", type=int, default=20, help="real episodes after the excitation")
    parser.add_argument("--out", type=Path, default=Path("runs/model_free"), help="folder of the runs")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the ablation's tables and figures")


def main(arguments: argparse.Namespace) -> None:
    """Run what is not finished, seed by seed, then make the tables and figures of the ablation anew."""
    torch.set_num_threads(1)
    named = product(arguments.seeds, arguments.plants, arguments.agents)
    jobs = [Job(plant, agent, seed, arguments.episodes) for seed, plant, agent in named]
    for folder, job in [(job.folder(arguments.out), job) for job in jobs]:
        if folder.is_dir():
            try:
                check_settings(folder, job.settings)
            except ValueError as error:
                print(f"benchmark.py model_free: {error}", file=sys.stderr)
                sys.exit(2)
    for job in jobs:
        perform(job, arguments.out)
    level = Level()
    gather(arguments.out, arguments.results, level)
    draw_ablation(arguments.results, level.error)


def perform(job: Job, root: Path) -> None:
    """Run a job unless its folder holds the result; `metrics.json`, the last file, says that it is finished."""
    folder = job.folder(root)
    with claimed(folder):
        if is_finished(folder, job):
            print(f"finished before: {folder}", flush=True)
            return
        clear(folder)
        write_text(folder / "config.yaml", job.settings)
        command = f"python scripts/benchmark.py {' '.join(sys.argv[1:])}".strip()
        write_json(folder / "origin.json", {"command": command, "commit": commit()})
        metrics = learn(job, folder)
        write_json(folder / "metrics.json", metrics)
    errors = [f"{v:.3g}" for k, v in metrics["evaluation"].items() if k.startswith("steady_state_error/")]
    print(f"finished: {folder}, error {' / '.join(errors)} rad, {metrics['cost']['wall_seconds']:.0f} s", flush=True)


def is_finished(folder: Path, job: Job) -> bool:
    """Return whether a run folder, whose settings were compared before, holds the result of all episodes."""
    try:
        json.loads((folder / "metrics.json").read_text())
    except (OSError, ValueError):
        return False
    return len(read_ablation(folder / "progress.csv")) == job.episodes


def learn(job: Job, folder: Path) -> dict[str, Any]:
    """Train an agent, evaluate it after every episode, and write `progress.csv` as it goes.

    Args:
        job: What to run.
        folder: Run folder.

    Returns:
        What `metrics.json` is to hold.
    """
    start = time.perf_counter()
    facts = PLANTS[job.plant]
    env = build_env(facts, job.seed)
    agent = build_agent(job, env)
    excite(agent, env, facts)
    steps, scenario = env.task.max_steps, Scenario("step", step_references(facts.low, facts.high, 64), 64)
    latest = untrained = summarise(judge(env, agent, scenario))
    excited, rows = stored(agent), []
    for episode in range(1, job.episodes + 1):
        agent.learn(steps, reset_num_timesteps=False)
        latest = summarise(judge(env, agent, scenario))
        real = excited + episode * steps
        cost: Summary = {
            "real_steps": real,
            "plant_seconds": real * env.dt,
            "imagined_transitions": 0,
            "updates": agent._n_updates,
            "wall_seconds": time.perf_counter() - start,
        }
        rows.append(progress(episode, agent, cost, latest))
        write_csv(folder / "progress.csv", list(rows[0]), [list(row.values()) for row in rows])
    steps = round(scenario.length(env) / env.dt)
    spent = cost | {"evaluation_steps": (job.episodes + 1) * scenario.episodes * steps}
    head = {"seed": job.seed, "system": job.plant, "episodes": job.episodes, "cost": spent, "scenario": scenario.name}
    return {**head, "evaluation": latest, "untrained": untrained}


def build_env(facts: Plant, seed: int) -> ControlEnv:
    """Return the real environment of `experiment=dyna`."""
    system = facts.build()
    reward = TrackingReward((4.0,), error_shape="logarithmic")
    task = Tracking(system.signature, RandomStep(facts.low, facts.high), reward=reward)
    return ControlEnv(system, task, dtype=torch.float64, seed=seed)


def build_agent(job: Job, env: ControlEnv) -> OffPolicyAlgorithm:
    """Return the agent of a job, which learns from its first period on."""
    adapted = GymControl(env)
    common = {"policy": "MlpPolicy", "env": adapted, "train_freq": 1, "learning_starts": 0}
    agent = AGENTS[job.agent](env.system.signature.n_u, **common, seed=job.seed, device="cpu")
    agent.set_logger(configure(None, []))
    return agent


def excite(agent: OffPolicyAlgorithm, env: ControlEnv, facts: Plant) -> None:
    """Excite the plant as the ablation does, and store what happened where the agent learns from."""
    excitation = Chirp(env.system.signature.n_u, dt=env.dt, amplitude=facts.amplitude, offset=facts.offset)
    assert agent.replay_buffer is not None
    for row in interact(env, excitation, excitation.n_steps):
        agent.replay_buffer.add(*_transition(row))


def _transition(row: TensorDict) -> tuple[Any, ...]:
    """Return observation, next observation, action, reward, done and info of one period, as a buffer wants them."""
    following = row["next"]
    kept = (row["observation"], following["observation"], row["action"], following["reward"][0], following["done"][0])
    observation, next_observation, action, reward, done = (value.numpy()[None] for value in kept)
    return observation, next_observation, action, reward, done, [{"TimeLimit.truncated": bool(done[0])}]


def stored(agent: OffPolicyAlgorithm) -> int:
    """Return how many transitions an agent has stored."""
    assert agent.replay_buffer is not None
    return agent.replay_buffer.size()


def judge(env: ControlEnv, agent: OffPolicyAlgorithm, scenario: Scenario) -> Evaluation:
    """Run the agent's policy, without noise, in the scenario."""

    def _act(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", agent.policy(tensordict["observation"], deterministic=True))

    return evaluate(env, _act, scenario)


def progress(episode: int, agent: OffPolicyAlgorithm, cost: Summary, figures: Summary) -> Summary:
    """Return a row of `progress.csv`, with the columns of a run of the ablation."""
    assert agent.ep_info_buffer is not None
    row: Summary = {"episode": episode, "return": agent.ep_info_buffer[-1]["r"]}
    row |= dict.fromkeys(MODEL_COLUMNS) | cost
    kept = {k: v for k, v in figures.items() if k == "return" or k.startswith(("steady_state_error/", "rmse/"))}
    return row | {f"evaluated_{key}": value for key, value in kept.items()}
