"""The control environment as a plain Gymnasium environment, for users and libraries outside TorchRL.

`import dynasindy` registers `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` with `gymnasium.make`.
"""

import math
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase

from dynasindy.envs import RandomStep, Tracking, TrackingReward
from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.drawing import Frame, draw
from dynasindy.envs.tracking import TrackingMachine
from dynasindy.systems import Pendulum, System, Tras, Trms33, Xi
from dynasindy.systems.steps import steps_of
from dynasindy.text import duration_unit

PLANTS: dict[str, Callable[[], System]] = {"tras": Tras, "xi": Xi, "trms33": Trms33}
Array = NDArray[np.float32]


class _GymControl(gymnasium.Env[Array, Array]):
    """A `ControlEnv` with one row behind Gymnasium's interface, truncated, never terminated; actions are clipped."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, env: ControlEnv, render_mode: str | None = None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode '{render_mode}' is unknown; use None or 'rgb_array'")
        assert isinstance(env.task, Tracking) and not env.batch_size
        self.env, self._task = env, env.task
        self.render_mode = render_mode
        n_o, n_u = env.task.n_o, env.system.signature.n_u
        # No state has an end of its own; a space without ends, which Gymnasium warns of, would say no more.
        most = np.finfo(np.float32).max
        self.observation_space = spaces.Box(-most, most, (n_o,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n_u,), np.float32)
        self._steps: int | None = None
        self._compiled: Callable[[Array], tuple[Array, float, dict[str, Any]]] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode with a fresh reference; the same seed begins the same sequence of episodes."""
        super().reset(seed=seed)
        # EnvBase.set_seed would also seed torch's global generator, which is not ours to touch.
        self.env.rng.manual_seed(int(self.np_random.integers(2**31)))
        self._now, self._steps = self.env.reset(), 0
        self._compiled = _compiled_step(self.env, self._now)
        return self._observed(self._now)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        if self._steps is None:
            raise RuntimeError("step was called before reset; call reset first")
        u = np.minimum(np.maximum(np.asarray(action, dtype=np.float32), -1.0), 1.0)
        if u.shape != self.action_space.shape:
            raise ValueError(f"an action has shape {self.action_space.shape}, given {u.shape}")
        self._steps += 1
        over = self._steps >= self._task.max_steps
        if self._compiled is not None:
            observation, reward, self._info = self._compiled(u)
            return observation, reward, False, over, self._info
        with torch.no_grad():
            stepped = self.env.step(self._now.set("action", torch.from_numpy(u)))
        self._now, after = self.env.step_mdp(stepped), stepped["next"]
        observation, info = self._observed(after)
        return observation, float(after["reward"]), False, over or bool(after["truncated"]), info

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy goes on from; until its next episode without the compiled step, which reads from here."""
        return {**vars(self), "_compiled": None}

    def render(self) -> Frame | None:
        """Return a picture of the state, uint8 `(height, width, 3)`, or None without a render mode."""
        if self.render_mode is None or self._steps is None:
            return None
        unit = duration_unit(self._task.max_steps * self.env.dt)
        words = f"t = {self._steps * self.env.dt / unit.seconds:.2f} {unit.name}"
        state, reference = (self._info[key].tolist() for key in ("state", "reference"))
        return draw(self.env.system.signature, state, reference, self._task.outputs, words)

    def _observed(self, shown: TensorDictBase) -> tuple[Array, dict[str, Any]]:
        self._info = {key: shown[key].numpy().copy() for key in ("state", "reference")}
        return shown["observation"].numpy(), self._info


def _compiled_step(
    env: ControlEnv, begun: TensorDictBase
) -> Callable[[Array], tuple[Array, float, dict[str, Any]]] | None:
    """Return what advances one row, its state and count in `begun`, by two calls of machine code, if there is any."""
    x, params, steps = begun["state"], begun["task_params"].contiguous(), begun["step_count"]
    u = x.new_zeros(1, env.system.signature.n_u)
    judge, code = TrackingMachine.of(env.task, env.dt, x.dtype), env.system.compiled(x, u[0])
    beaten = env.delay or math.isfinite(env.left_beyond)
    if type(env) is not ControlEnv or beaten or judge is None or code is None:
        return None
    count = steps_of(code.step, env.dt, env.substeps).number
    samples, touched = x.new_empty(1, count, len(x)), torch.zeros(1, dtype=torch.bool)
    results = torch.empty(judge.n_o, dtype=torch.float32), x.new_empty(judge.n_r), torch.empty(1, dtype=torch.float32)
    advance = code.bind(x, u, samples, touched, env.dt, env.substeps, env.stops)
    judged = judge.bind(x, samples[0, -1], params, steps, touched, results)
    before, after, acting, clock = x.numpy(), samples[0, -1].numpy(), u[0].numpy(), steps.numpy()
    observation, reference, reward = (result.numpy() for result in results)

    def _step(action: Array) -> tuple[Array, float, dict[str, Any]]:
        acting[:] = action
        clock[0] += 1
        advance()
        judged()
        before[:] = after
        return observation.copy(), float(reward[0]), {"state": after.copy(), "reference": reference.copy()}

    return _step


def twin_rotor(
    plant: str = "tras",
    low: tuple[float, float] = (-0.4, -0.25),
    high: tuple[float, float] = (0.4, 0.25),
    render_mode: str | None = None,
) -> _GymControl:
    """Return the twin rotor under random step references, the paper's training task.

    Args:
        plant: "tras", "xi" or "trms33".
        low: Lower ends of the azimuth and pitch references [rad].
        high: Upper ends [rad].
        render_mode: None or "rgb_array".

    Raises:
        ValueError: The plant is unknown.
    """
    if plant not in PLANTS:
        raise ValueError(f"plant '{plant}' is unknown; use one of {', '.join(PLANTS)}")
    system = PLANTS[plant]()
    return _GymControl(ControlEnv(system, Tracking(system.signature, RandomStep(low, high))), render_mode)


def pendulum(low: float = -1.0, high: float = 1.0, render_mode: str | None = None) -> _GymControl:
    """Return the pendulum under random step references between `low` and `high` [rad]."""
    system = Pendulum()
    task = Tracking(
        system.signature,
        RandomStep([low], [high]),
        outputs=("theta",),
        rates=("Omega",),
        reward=TrackingReward(error_weights=(4.0,)),
    )
    return _GymControl(ControlEnv(system, task), render_mode)
