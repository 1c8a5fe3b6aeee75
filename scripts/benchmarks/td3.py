"""Time of one TD3 update: this package, TorchRL's plain loss, Stable-Baselines3, matrix products alone.

All update the same architecture on the same batch, with the actor and the targets every second update, one
after the other within each repeat; the medians over the repeats are reported. Drawing a batch is timed apart.
The time is CPU time of the process, one thread, which other processes disturb less than they do wall time.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import TD3 as StableBaselines3TD3
from stable_baselines3.common.logger import configure
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.modules import MLP, ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss, ValueEstimators

from benchmarks.common import add_written
from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.safe_io import write_rows

N_OBS, N_U = 8, 2
REPLAY_ROWS = (80_000, 320_000)  # real and imagined, of the paper's two million
REPEATS = 15
"""Repeats at least before the published figures are replaced."""
RESULTS = Path("docs/results/td3.csv")
OURS, IN_TORCH = "dynasindy TD3.update", "dynasindy TD3.update, without machine code"
STEPS = 10
BEST = f"Stable-Baselines3 TD3, fused Adam, {STEPS} updates a call"


@dataclass(frozen=True)
class Size:
    """Architecture and batch to time.

    Attributes:
        name: its name in the table.
        hidden: widths of the hidden layers.
        batch: transitions per update.
        updates: updates per repeat, a multiple of `STEPS`.
    """

    name: str
    hidden: tuple[int, ...]
    batch: int
    updates: int


SIZES = (Size("paper", (400, 300), 512, 10), Size("quick", (128, 128), 256, 60))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--repeats", type=int, default=REPEATS, help="repeats of which the median is taken")
    add_written(parser, RESULTS, REPEATS, "repeats")


def main(arguments: argparse.Namespace) -> None:
    """Measure, print a table and write it as CSV."""
    # A quick look must not replace the published figures.
    out = RESULTS if arguments.out is None and arguments.repeats >= REPEATS else arguments.out
    torch.set_num_threads(1)
    rows = [row for size in SIZES for row in measure(size, arguments.repeats)]
    print("\n".join(table(rows)))
    if out is None:
        print(f"written to no file: fewer than {REPEATS} repeats; name one by --out")
        return
    write_rows(out, list(rows[0]), rows)
    print(f"written to {out}")


def measure(size: Size, repeats: int) -> list[dict[str, str | float]]:
    """Return a row per contender: milliseconds per update, and relative to ours."""
    torch.manual_seed(0)
    replay = filled_replay(size)
    batch = replay.sample()
    update, in_torch = (
        TD3(N_OBS, N_U, hidden=size.hidden, target_update_interval=2, machine_code=code).update
        for code in (True, False)
    )

    contenders: dict[str, tuple[Callable[[], object], int]] = {
        OURS: (lambda: update(batch), 1),
        "TorchRL TD3Loss loop": (torchrl_update(size, batch), 1),
        "Stable-Baselines3 TD3": (stable_baselines3_update(size, batch), 1),
        BEST: (stable_baselines3_update(size, batch, STEPS, fused=True), STEPS),
        IN_TORCH: (lambda: in_torch(batch), 1),
        "matrix products alone": (matrix_products(size), 1),
        "DynaReplay.sample": (replay.sample, 1),
    }
    times: dict[str, list[float]] = {name: [] for name in contenders}
    for repeat in range(repeats + 1):
        for name, (step, at_once) in contenders.items():
            start = time.process_time()
            for _ in range(size.updates // at_once):
                step()
            if repeat:  # the first warms up
                times[name].append(1e3 * (time.process_time() - start) / size.updates)
    medians = {name: statistics.median(values) for name, values in times.items()}
    hidden = "-".join(map(str, size.hidden))
    return [
        {
            "size": size.name,
            "hidden": hidden,
            "batch": size.batch,
            "what": name,
            "ms_per_update": round(median, 4),
            "ratio_to_ours": round(median / medians[OURS], 4),
        }
        for name, median in medians.items()
    ]


def table(rows: list[dict[str, str | float]]) -> list[str]:
    """Return the rows as lines of text."""
    lines = [f"{'what':<58}{'networks':>10}{'batch':>7}{'ms/update':>12}{'ours = 1':>10}"]
    for row in rows:
        lines.append(
            f"{row['what']:<58}{row['hidden']:>10}{row['batch']:>7}"
            f"{row['ms_per_update']:>12.3f}{row['ratio_to_ours']:>10.2f}"
        )
    return lines


def filled_replay(size: Size) -> DynaReplay:
    """Return a replay of the paper's capacity with random transitions."""
    replay = DynaReplay(2_000_000, size.batch, real_ratio=0.25)
    for buffer, n in zip((replay.real, replay.model), REPLAY_ROWS):
        flags = {key: torch.zeros(n, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        following = {"observation": torch.randn(n, N_OBS), "reward": torch.randn(n, 1), **flags}
        rows = {"observation": torch.randn(n, N_OBS), "action": torch.rand(n, N_U) * 2 - 1, "next": following}
        if buffer is replay.real:
            rows |= {"state": torch.randn(n, 6), "step_count": torch.zeros(n, 1, dtype=torch.int64)}
            following |= {"state": torch.randn(n, 6), "samples": torch.randn(n, 5, 6)}
            following |= {"at_stop": torch.zeros(n, 1, dtype=torch.bool)}
        buffer.extend(TensorDict(rows, [n]))
    return replay


def torchrl_update(size: Size, batch: TensorDict) -> Callable[[], None]:
    """Return the update of a plain TorchRL loop: its TD3Loss, fused Adam, its SoftUpdate.

    Args:
        size: architecture.
        batch: transitions of every step.
    """
    shape = {"num_cells": list(size.hidden), "activation_class": nn.LeakyReLU}
    network = nn.Sequential(MLP(N_OBS, N_U, **shape), nn.Tanh())
    policy = TensorDictModule(network, in_keys=["observation"], out_keys=["action"])
    critic = ValueOperator(MLP(N_OBS + N_U, 1, **shape), in_keys=["observation", "action"])
    loss = TD3Loss(policy, critic, bounds=(-1.0, 1.0), loss_function="l2")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.995)
    updater = SoftUpdate(loss, tau=0.005)
    actor_optimizer = Adam(list(loss.actor_network_params.parameters()), 1e-4, fused=True)
    critic_optimizer = Adam(list(loss.qvalue_network_params.parameters()), 1e-4, fused=True)
    count = 0

    def _critics() -> None:
        critic_loss, _ = loss.value_loss(batch)
        critic_optimizer.zero_grad()
        critic_loss.backward()
        critic_optimizer.step()

    def _actor() -> None:
        actor_loss, _ = loss.actor_loss(batch)
        actor_optimizer.zero_grad()
        actor_loss.backward()
        actor_optimizer.step()
        updater.step()

    def _step() -> None:
        nonlocal count
        count += 1
        _critics()
        if count % 2 == 0:
            _actor()

    return _step


def stable_baselines3_update(size: Size, batch: TensorDict, steps: int = 1, fused: bool = False) -> Callable[[], None]:
    """Return a call of Stable-Baselines3's TD3 that takes gradient steps on the batch.

    Args:
        size: architecture.
        batch: transitions of every step.
        steps: gradient steps of a call, whose overhead they share.
        fused: whether Adam is the fused one, as ours; by default it is not.
    """
    model = StableBaselines3TD3(
        "MlpPolicy",
        _Spaces(),
        batch_size=size.batch,
        learning_rate=1e-4,
        gamma=0.995,
        policy_kwargs={
            "net_arch": list(size.hidden),
            "activation_fn": nn.LeakyReLU,
            "optimizer_kwargs": {"fused": fused},
        },
        buffer_size=1,
        device="cpu",
    )
    model.set_logger(configure(None, []))
    samples = SimpleNamespace(
        observations=batch["observation"],
        actions=batch["action"],
        next_observations=batch["next", "observation"],
        dones=batch["next", "terminated"].float(),
        rewards=batch["next", "reward"],
        discounts=None,
    )
    vars(model)["replay_buffer"] = SimpleNamespace(sample=lambda *_, **__: samples)
    return lambda: model.train(gradient_steps=steps, batch_size=size.batch)


def matrix_products(size: Size) -> Callable[[], None]:
    """Return the matrix products of one update without anything between them: the floor of any TD3 here.

    Per update: the target actor once and four critics forward; two critics backward. Every second update: the
    actor and one critic forward, then back through both. First layers need no gradient of their input, except
    the critic's in the actor's loss.
    """
    actor = _Products(size, N_OBS, N_U, 1)
    critics = _Products(size, N_OBS + N_U, 1, 2)
    critic = _Products(size, N_OBS + N_U, 1, 1)
    count = 0

    def _step() -> None:
        nonlocal count
        count += 1
        actor.forward()
        critics.forward()
        critics.forward()
        critics.backward(inputs=False, weights=True)
        if count % 2 == 0:
            actor.forward()
            critic.forward()
            critic.backward(inputs=True, weights=False)
            actor.backward(inputs=False, weights=True)

    return _step


class _Products:
    """Products of a stack of perceptrons, on preallocated tensors."""

    def __init__(self, size: Size, n_in: int, n_out: int, stack: int) -> None:
        widths = [n_in, *size.hidden, n_out]
        lead = () if stack == 1 else (stack,)
        self.x: list[Tensor] = [torch.randn(*lead, size.batch, width) for width in widths]
        self.w: list[Tensor] = [torch.randn(*lead, b, a) for a, b in pairwise(widths)]
        self.dx, self.dw = [torch.empty_like(x) for x in self.x], [torch.empty_like(w) for w in self.w]

    def forward(self) -> None:
        """Multiply through all layers."""
        for i, w in enumerate(self.w):
            torch.matmul(self.x[i], w.mT, out=self.dx[i + 1])

    def backward(self, *, inputs: bool, weights: bool) -> None:
        """Multiply back, to the gradients of the first layer's inputs and of the weights as asked."""
        for i in reversed(range(len(self.w))):
            if weights:
                torch.matmul(self.x[i + 1].mT, self.x[i], out=self.dw[i])
            if i or inputs:
                torch.matmul(self.x[i + 1], self.w[i], out=self.dx[i])


class _Spaces(gym.Env):
    """What Stable-Baselines3 asks an environment for before it learns."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (N_OBS,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (N_U,), np.float32)
