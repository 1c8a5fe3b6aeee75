"""Plants for agents without a model: what they learn on, and how they are judged.

Pendulum-v1 and MountainCarContinuous-v0 pay their own reward, with the settings that rl-baselines3-zoo publishes for
them. The cart-pole of docs/examples has the task of its run, whose episodes end at the ends of the track, without a
cost of its own. SAC has the settings of Pendulum-v1 there, or, as `sac_bullet`, those that the zoo has for the swing-up
of Bullet's cart-pole; TD3 has those of Stable-Baselines3. So have both on MuJoCo's plants. There they learn the double
pendulum by its own reward, which pays for each period upright and knows no place at which the cart is wanted, and
Reacher by the task of its run.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import torch
from torch import Tensor

from benchmarks.plants import EXAMPLES
from dynasindy.dyna.excite import within
from dynasindy.envs import ControlEnv, Foreign, GymnasiumEnv
from dynasindy.envs.gym import Array, GymControl
from dynasindy.evaluation.held import WITHIN
from dynasindy.tasks import RandomStep, Tracking, TrackingReward

Settings = dict[str, Any]
Targets = dict[str, tuple[float, float]]


class Fenced(GymControl):
    """A plant whose episodes also end where a state leaves the task's bounds, as the library's own do."""

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        observation, reward, terminated, truncated, info = super().step(action)
        assert isinstance(self.env.task, Tracking)
        inside = bool(within(torch.from_numpy(info["state"]), *self.env.task.bounds))
        return observation, reward, terminated, truncated or not inside, info


@dataclass(frozen=True)
class Swing:
    """What an agent learns on, and how it is judged.

    Attributes:
        steps: Real steps after which a run ends.
        judge: Makes the environment of the evaluations, for a seed.
        learn: Makes that of an agent; None wraps the one of the evaluations.
        angle: Angle from upright [rad], `(...)`, of states `(..., n_x)`; None where nothing stands.
        seen: What an agent that has an environment of its own observes there, of states `(..., n_x)`; None for these.
        within: Mean absolute error at the end that is asked for [target ranges].
        settings: Settings of an agent, by its name.
    """

    steps: int
    judge: Callable[[int], ControlEnv]
    learn: Callable[[], gymnasium.Env[Any, Any]] | None = None
    angle: Callable[[Tensor], Tensor] | None = None
    seen: Callable[[Tensor], Tensor] | None = None
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


def mountain_car(seed: int) -> ControlEnv:
    """Return MountainCarContinuous-v0, to be driven to the flag."""
    system = Foreign("MountainCarContinuous-v0", {"p": 1.2, "v": 0.07}, ["force"])
    return of_gymnasium(system, {"p": (0.47, 0.47)}, seed, 1.0, max_steps=999)


def double_pendulum(seed: int) -> ControlEnv:
    """Return MuJoCo's InvertedDoublePendulum-v5, to be held upright at a place."""
    system = Foreign(
        "InvertedDoublePendulum-v5",
        {"p": 1.0, "theta1": 0.2, "theta2": 0.2, "v": 2.0, "w1": 2.0, "w2": 2.0},
        ["force"],
        observed=["p", "s1", "s2", "c1", "c2", "v", "w1", "w2", "stop"],
        angles={"theta1": ["s1", "c1"], "theta2": ["s2", "c2"]},
    )
    targets = {"p": (-0.1, 0.1), "theta1": (0.0, 0.0), "theta2": (0.0, 0.0)}
    return of_gymnasium(system, targets, seed, bounds={"theta1": 0.5, "theta2": 0.6, "p": 0.9})


def double_pendulum_seen(x: Tensor) -> Tensor:
    """Return what that environment shows of its states `(..., 6)`, `(..., 9)`; its track's ends push nothing here."""
    angles = x[..., 1:3]
    return torch.cat([x[..., :1], angles.sin(), angles.cos(), x[..., 3:].clamp(-10.0, 10.0), 0 * x[..., :1]], -1)


def reacher(seed: int) -> ControlEnv:
    """Return MuJoCo's Reacher-v5, whose tip is to reach a point."""
    ranges = dict.fromkeys(("c1", "c2", "s1", "s2", "theta2"), 1.0) | {"tx": 0.2, "ty": 0.2}
    system = Foreign(
        "Reacher-v5",
        ranges | {"w1": 10.0, "w2": 10.0, "dx": 0.2, "dy": 0.2},
        ["shoulder", "elbow"],
        stops=[],
        observed=["c1", "c2", "s1", "s2", "tx", "ty", "w1", "w2", "dx", "dy"],
        angles={"theta2": ["s2", "c2"]},
    )
    task: Settings = {"rates": ("w1", "w2"), "bounds": {"theta2": 2.9}, "max_steps": 250}
    return of_gymnasium(system, {"dx": (0.0, 0.0), "dy": (0.0, 0.0)}, seed, **task)


PENDULUM_SAC: Settings = {"learning_rate": 1e-3}
BULLET_SAC: Settings = {
    **{"learning_rate": 7.3e-4, "buffer_size": 300_000, "batch_size": 256, "ent_coef": "auto", "gamma": 0.98},
    **{"tau": 0.02, "train_freq": 8, "gradient_steps": 8, "learning_starts": 10_000, "use_sde": True},
    "policy_kwargs": {"log_std_init": -3, "net_arch": [400, 300]},
}
PENDULUM_TD3 = {"gamma": 0.98, "buffer_size": 200_000, "learning_starts": 10_000, "learning_rate": 1e-3}
CAR_SAC: Settings = {
    **{"buffer_size": 50_000, "batch_size": 512, "ent_coef": 0.1, "train_freq": 32, "gradient_steps": 32},
    **{"gamma": 0.9999, "tau": 0.01, "learning_starts": 0, "use_sde": True},
    "policy_kwargs": {"log_std_init": -3.67, "net_arch": [64, 64]},
}
SWINGS = {
    "pendulum_v1": Swing(
        20_000,
        pendulum,
        lambda: gymnasium.make("Pendulum-v1"),
        lambda x: torch.atan2(x[..., 1], x[..., 0]),
        settings={"sac": PENDULUM_SAC, "td3": {"train_freq": 1, "gradient_steps": 1, **PENDULUM_TD3}},
    ),
    "swing_up": Swing(
        60_000,
        cart_pole,
        angle=lambda x: torch.remainder(x[..., 1] + math.pi, 2 * math.pi) - math.pi,
        settings={"sac": PENDULUM_SAC, "sac_bullet": BULLET_SAC},
    ),
    "mountain_car": Swing(
        50_000, mountain_car, lambda: gymnasium.make("MountainCarContinuous-v0"), within=0.05, settings={"sac": CAR_SAC}
    ),
    "double_pendulum": Swing(
        30_000,
        double_pendulum,
        lambda: gymnasium.make("InvertedDoublePendulum-v5"),
        lambda x: torch.maximum(x[..., 1].abs(), (x[..., 1] + x[..., 2]).abs()),
        double_pendulum_seen,
    ),
    "reacher": Swing(30_000, reacher),
}
