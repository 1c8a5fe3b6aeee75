"""What goes wrong between the laboratory and the model: wind, other parameters, noise, delay.

`PerturbedPlant` is a plant made from a plant, for `Scenario.plant`; `SensorNoise` and `DelayedActuator`
are policies made from a policy, for `Scenario.wrappers`. Where a run has sensors and an observer, `SensorNoise` says
how much noisier the sensors are.
"""

from collections import deque
from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.control.controller import Policy
from dynasindy.envs import Channel, ControlEnv, Sensors
from dynasindy.limits import Count
from dynasindy.systems import Altered, Signature, System

SHARE = 1e-3
"""Noise of a state of whose sensor nothing is known [ranges of the state]."""


class PerturbedPlant(Altered):
    """A plant with other parameters, under a constant push such as wind: dx/dt = gain * f(x, input_gain * u) + push.

    A gain of 0.9 on a rate is a moment of inertia 11 % larger, an input gain of 0.9 an amplifier 10 % weaker.

    Args:
        system: The plant.
        push: Acceleration by name of a state, e.g. `{"Omega_a": 0.5}` [unit of the state per second].
        gain: Factor on dx/dt by name of a state; 1 where not named.
        input_gain: Factor on each input; 1 if omitted.

    Raises:
        ValueError: A named state does not exist, or there is not one input gain per input.
    """

    push: Tensor
    gain: Tensor
    input_gain: Tensor

    def __init__(
        self,
        system: System,
        push: Mapping[str, float] | None = None,
        gain: Mapping[str, float] | None = None,
        input_gain: Sequence[float] | None = None,
    ) -> None:
        super().__init__(system)
        self.register_buffer("push", _by_state(system.signature, push or {}, 0.0, "push"))
        self.register_buffer("gain", _by_state(system.signature, gain or {}, 1.0, "gain"))
        n_u = system.signature.n_u
        input_gain = [1.0] * n_u if input_gain is None else list(input_gain)
        if len(input_gain) != n_u:
            raise ValueError(f"input_gain has {len(input_gain)} numbers, the plant {n_u} inputs; give one each")
        self.register_buffer("input_gain", torch.tensor(input_gain, dtype=torch.float64))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""
        return self.gain.to(x) * self.system(x, self.input_gain.to(u) * u) + self.push.to(x)


class SensorNoise:
    """A policy that sees the states through noisy sensors.

    A policy that flies by the estimates of an observer is not wrapped: `evaluate` adds the noise to the measurements
    in front of the observer then, which does not know of it.

    Args:
        policy: The policy.
        env: Environment whose task makes the observation.
        std: Standard deviation of white noise by name of a state, 0 where not named [unit of the state]; None takes
            those of `sensors`.
        seed: Of the noise.
        sensors: Resolution and noise of the plant's sensors, by name of a state, each a `Channel` or its keys. The
            noise of a state of which they do not tell is `SHARE` of its range.

    Raises:
        ValueError: A standard deviation is negative, or a named state does not exist.
    """

    def __init__(
        self,
        policy: Policy,
        env: ControlEnv,
        std: Mapping[str, float] | None = None,
        seed: int = 0,
        sensors: Mapping[str, Channel | Mapping[str, float]] | None = None,
    ) -> None:
        signature = env.system.signature
        self.policy, self.env, self.std = policy, env, _by_state(signature, std or {}, 0.0, "std").float()
        if bool((self.std < 0).any()):
            raise ValueError(f"the scenario's std is {std}; give numbers of 0 or more")
        if std is None:
            scale = torch.tensor(signature.x_scale, dtype=torch.float64)
            known = Sensors(sensors).variance(signature).sqrt() if sensors else torch.zeros_like(scale)
            self.std = known.where((known > 0) & known.isfinite(), SHARE * scale).float()
        self.generator = torch.Generator().manual_seed(seed)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action for a noisy measurement; the true state stays in the tensordict."""
        x, t = tensordict["state"], tensordict["step_count"] * self.env.dt
        measured = x + self.std.to(x) * torch.randn(x.shape, generator=self.generator).to(x)
        seen = tensordict.copy().set("state", measured)
        seen["observation"] = self.env.task.observation(measured, tensordict["task_params"], t.to(x)).float()
        return tensordict.set("action", self.policy(seen)["action"])


class DelayedActuator:
    """A policy whose actions reach the plant some control periods late; until then the inputs are zero.

    Args:
        policy: The policy.
        env: Environment it runs in, which has the control period.
        periods: Delay [control periods].
    """

    def __init__(self, policy: Policy, env: ControlEnv, periods: Count) -> None:
        self.policy, self.periods = policy, periods
        self.waiting: deque[Tensor] = deque()

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action that was chosen `periods` control periods ago."""
        action = self.policy(tensordict)["action"]
        if not self.waiting:
            self.waiting.extend(torch.zeros_like(action) for _ in range(self.periods))
        self.waiting.append(action)
        return tensordict.set("action", self.waiting.popleft())


def _by_state(signature: Signature, values: Mapping[str, float], default: float, key: str) -> Tensor:
    row = torch.full((signature.n_x,), default, dtype=torch.float64)
    for name, value in values.items():
        row[signature.state_index(name, f"the scenario's {key}")] = value
    return row
