"""The control environment as a plain Gymnasium environment, for users and libraries outside TorchRL.

`import dynasindy` registers `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` with `gymnasium.make`.
"""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.drawing import Frame, draw
from dynasindy.systems import Pendulum, System, Tras, Trms33, Xi
from dynasindy.tasks import RandomStep, Tracking, TrackingReward
from dynasindy.text import duration_unit

PLANTS: dict[str, Callable[[], System]] = {"tras": Tras, "xi": Xi, "trms33": Trms33}
Array = NDArray[np.float32]


class _GymControl(gymnasium.Env[Array, Array]):
    """A `ControlEnv` with one row behind Gymnasium's interface.

    Observation, action and reward are those of `ControlEnv`; `info` holds `state` and `reference`. Episodes
    are truncated after the task's `max_steps` periods, or where the environment cuts them, and never terminated.
    Actions are clipped to [-1, 1].

    Args:
        env: The environment to adapt; its batch size is ().
        render_mode: None or "rgb_array".
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, env: ControlEnv, render_mode: str | None = None) -> None:
        if tuple(env.batch_size):
            raise ValueError(f"Gymnasium environments have one row, got batch size {tuple(env.batch_size)}; use ()")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode '{render_mode}' is unknown; use None or 'rgb_array'")
        if not isinstance(env.task, Tracking):
            raise TypeError(f"task {type(env.task).__name__} tracks nothing; adapt environments with a Tracking task")
        self.env, self._task = env, env.task
        self.render_mode = render_mode
        n_o, n_u = env.task.n_o, env.system.signature.n_u
        # No state has an end of its own; a space without ends, which Gymnasium warns of, would say no more.
        most = np.finfo(np.float32).max
        self.observation_space = spaces.Box(-most, most, (n_o,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n_u,), np.float32)
        self._steps: int | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode with a fresh reference; the same seed begins the same sequence of episodes."""
        super().reset(seed=seed)
        # EnvBase.set_seed would also seed torch's global generator, which is not ours to touch.
        self.env.rng.manual_seed(int(self.np_random.integers(2**31)))
        begun = self.env.reset()
        self._now, self._x, self._params, self._steps = begun, begun["state"], begun["task_params"], 0
        self._t = torch.zeros(1, dtype=self._x.dtype)
        return self._observed()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        if self._steps is None:
            raise RuntimeError("step was called before reset; call reset first")
        u = torch.from_numpy(np.asarray(action, dtype=np.float32)).clamp(-1.0, 1.0)
        self._steps += 1
        self._t = torch.tensor([self._steps], dtype=self._x.dtype).mul_(self.env.dt)
        reward, truncated = (self._advance if type(self.env)._step is ControlEnv._step else self._step)(u)
        observation, info = self._observed()
        return observation, reward, False, truncated or self._steps >= self._task.max_steps, info

    @torch.no_grad()
    def _advance(self, u: Tensor) -> tuple[float, bool]:
        """Do what `ControlEnv.step` does, on one row, without a tensordict, which would cost several times as much."""
        x = self._x
        samples, touched = self.env.advance(x, u.to(x.dtype))
        self._x = samples[-1]
        return float(self._task.earned(x, u, self._x, self._params, self._t, touched).float()), False

    @torch.no_grad()
    def _step(self, u: Tensor) -> tuple[float, bool]:
        """Let an environment that steps in its own way do so."""
        stepped = self.env.step(self._now.set("action", u))
        self._now, self._x = self.env.step_mdp(stepped), stepped["next", "state"]
        return float(stepped["next", "reward"]), bool(stepped["next", "truncated"])

    def render(self) -> Frame | None:
        """Return a picture of the state, uint8 `(height, width, 3)`, or None without a render mode."""
        if self.render_mode is None or self._steps is None:
            return None
        reference = self._task.reference(self._params, self._t).tolist()
        unit = duration_unit(self._task.max_steps * self.env.dt)
        words = f"t = {float(self._t) / unit.seconds:.2f} {unit.name}"
        return draw(self.env.system.signature, self._x.tolist(), reference, self._task.outputs, words)

    def _observed(self) -> tuple[Array, dict[str, Any]]:
        observation = self._task.observation(self._x, self._params, self._t).float().numpy()
        reference = self._task.reference(self._params, self._t).numpy().copy()
        return observation, {"state": self._x.numpy().copy(), "reference": reference}


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
