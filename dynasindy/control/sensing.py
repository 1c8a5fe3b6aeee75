"""Sensors, actuator and observer as a TorchRL transform of the real environment.

Downstream of it `state`, `samples`, `observation` and `reward` are made of measurements and estimates alone. The truth
travels along as `true_state`, which the transform hands back to the plant, and `true_reward`; nothing but the metrics
of an evaluation may read them.

| key                       | what it holds                                                                     |
| ------------------------- | --------------------------------------------------------------------------------- |
| `measurement`             | what the sensors saw at this time, NaN where nothing; late ones stand at their time |
| `state`                   | the estimate for the time at which the next action arrives at the plant           |
| `("next", "samples")`     | what the sensors saw within the period                                            |
| `("observer", ...)`       | mean, covariance, past inputs, measurements under way, normalised innovation       |
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import Transform
from torchrl.envs.utils import make_composite_from_td

from dynasindy.control.controller import Policy, acting
from dynasindy.control.observer import Belief, Observer
from dynasindy.envs import ControlEnv
from dynasindy.envs.control_env import FARTHEST
from dynasindy.envs.sensors import Sensors


class Sensing(Transform):
    """Hide the true state of a plant behind its sensors, and show what an observer makes of them.

    Args:
        env: The real environment.
        observer: Observer, with the sensors that it reads.
        rng: Generator of noise and losses.
        sensors: What the plant is read by, if the observer does not know it well; those that it knows if omitted.
    """

    def __init__(
        self, env: ControlEnv, observer: Observer, rng: torch.Generator, sensors: Sensors | None = None
    ) -> None:
        super().__init__(in_keys=[], out_keys=["true_state", "true_reward", "measurement", "observer"])
        self.__dict__["env"] = env  # transforms have parents, not children
        self.observer, self.rng, self.sensors = observer, rng, sensors or observer.sensors

    @staticmethod
    def measured(rows: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return what an observer reads of an episode: measurements `(T + 1, n_x)` and the commands between them.

        Args:
            rows: Control periods `(T,)` of one episode behind sensors.
        """
        return torch.cat([rows["measurement"][:1], rows["next", "samples"][:, -1]]), rows["action"]

    def on(self, env: ControlEnv) -> Sensing:
        """Return the same sensors, generator and observer for another environment of the same plant."""
        return Sensing(env, self.observer, self.rng, self.sensors)

    def controller(self, policy: Policy) -> Policy:
        """Return a policy as it acts behind the observer, whose estimate of a push it counteracts, if there is one."""
        return acting(policy, self.env, bool(self.observer.pushed))

    @torch.no_grad()
    def begin(self, start: TensorDictBase) -> TensorDictBase:
        """Hide the true states in which episodes begin; until then the plant was at rest, and inputs zero."""
        x, sensors = start["state"], self.sensors
        y = sensors.read(x, self.env.system.signature, self.rng)
        held = dict(self._blank(x.shape[:-1]).items())
        held |= {"measurements": y.unsqueeze(-2).repeat_interleave(sensors.delay + 1, -2), "nis": held["nis"] + 1}
        start["true_reward"] = torch.zeros(*x.shape[:-1], 1)
        start["samples"] = y.unsqueeze(-2).expand(start["samples"].shape).clone()
        self._show(start, self.observer.begin(y), held)
        start["true_state"] = x
        return start

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Hand the plant its true state, and the input that has arrived."""
        if not {"action", "true_state"} <= set(tensordict.keys()):  # a reset
            return tensordict
        commanded = tensordict["action"].unsqueeze(-2)
        inputs = torch.cat([tensordict["observer", "inputs"][..., 1:, :], commanded], -2)
        tensordict["estimate"], tensordict["state"] = tensordict["state"], tensordict["true_state"]
        tensordict["observer", "inputs"] = inputs
        tensordict["action"] = inputs[..., -1 - self.sensors.actuator_delay, :]
        return tensordict

    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Measure what the plant did, and estimate where it is."""
        before, after, task = tensordict["observer"], next_tensordict, self.env.task
        y = self.sensors.read(after["samples"], self.env.system.signature, self.rng)
        measurements = torch.cat([before["measurements"][..., 1:, :], y[..., -1:, :]], -2)
        belief = self.observer.advance(Belief(before["mean"], before["covariance"]), before["inputs"])
        belief, nis, _ = self.observer.correct(belief, measurements[..., 0, :])
        true_state, true_reward, after["samples"] = after["state"], after["reward"], y
        held = {key: before[key] for key in ("inputs", "shift") if key in set(before.keys())}
        self._show(after, belief, held | {"measurements": measurements, "nis": nis.unsqueeze(-1)})
        x, x_next = tensordict["estimate"], after["state"]
        t_next, touched = after["step_count"].to(x.dtype) * self.env.dt, after["at_stop"].squeeze(-1)
        if not task.own:  # what the plant itself pays is known as it is
            reward = task.earned(x, before["inputs"][..., -1, :], x_next, after["task_params"], t_next, touched)
            after["reward"] = reward.float().unsqueeze(-1)
        after["true_state"], after["true_reward"] = true_state, true_reward
        return after

    def reestimated(self, rows: TensorDictBase, x: Tensor) -> TensorDictBase:
        """Return the rows of a real episode with other estimates of its states.

        Args:
            rows: Control periods `(T,)` with `task_params`.
            x: States at their ends, `(T + 1, n_x)`.
        """
        shown, task, x = rows.clone(), self.env.task, x.to(self.env.float_type)
        params, t = rows["task_params"], rows["step_count"].to(x.dtype) * self.env.dt
        touched = rows["next", "at_stop"].squeeze(-1)
        shown["state"], shown["next", "state"] = x[:-1], x[1:]
        shown["observation"] = task.observation(x[:-1], params, t).float()
        shown["next", "observation"] = task.observation(x[1:], params, t + self.env.dt).float()
        if not task.own:
            reward = task.earned(x[:-1], rows["action"], x[1:], params, t + self.env.dt, touched)
            shown["next", "reward"] = reward.float().unsqueeze(-1)
        return shown

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self.begin(tensordict_reset)

    def _show(self, shown: TensorDictBase, belief: Belief, held: dict[str, Tensor]) -> None:
        """Write what may be seen in the place of the true state, and what the observer holds besides its belief."""
        dtype, task = self.env.float_type, self.env.task
        mean = self.observer.ahead(belief.mean, held["inputs"])
        n_x = self.observer.n_x
        ends = FARTHEST * self.observer.scale[:n_x]
        # Rewards and actions of larger estimates would be no numbers.
        x = torch.minimum(torch.maximum(mean[..., :n_x], -ends), ends).to(dtype)
        t = shown["step_count"].to(dtype) * self.env.dt
        shown["state"] = x
        shown["observation"] = task.observation(x, shown["task_params"], t).float()
        shown["measurement"] = held["measurements"][..., -1, :]
        if self.observer.pushed:
            outputs = [self.env.system.signature.state_index(name) for name in task.output_names]
            held["shift"] = self.observer.correction(mean, held["inputs"], outputs, held["shift"])
        held |= {"mean": belief.mean, "covariance": belief.covariance}
        shown["observer"] = TensorDict(held, shown.batch_size)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add what is measured, what the observer holds, and the truth behind."""
        shown = self.transform_state_spec(observation_spec)
        shown["true_reward"], shown["measurement"] = Unbounded(shape=(*shown.shape, 1)), shown["state"].clone()
        return shown

    def transform_state_spec(self, state_spec: TensorSpec) -> TensorSpec:
        """Add what is carried from step to step: the true state and what the observer holds."""
        assert isinstance(state_spec, Composite)
        state_spec["true_state"] = state_spec["state"].clone()
        state_spec["observer"] = make_composite_from_td(self._blank(state_spec.shape))
        return state_spec

    def get_extra_state(self) -> dict[str, Any]:
        """Return what a resumed run needs."""
        return {"observer": self.observer.state_dict(), "rng": self.rng.get_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `get_extra_state` returned."""
        self.observer.load_state_dict(state["observer"])
        self.rng.set_state(state["rng"])

    def _blank(self, batch: torch.Size) -> TensorDict:
        n, n_x, n_u = len(self.observer.scale), self.env.system.signature.n_x, self.env.system.signature.n_u
        doubles = {"mean": (n,), "covariance": (n, n), "nis": (1,)} | (
            {"shift": (n_x + n_u,)} if self.observer.pushed else {}
        )
        held = {name: torch.zeros(*batch, *shape, dtype=torch.float64) for name, shape in doubles.items()}
        held["inputs"] = torch.zeros(*batch, self.observer.memory, n_u)
        held["measurements"] = torch.zeros(*batch, self.sensors.delay + 1, n_x, dtype=self.env.float_type)
        return TensorDict(held, batch)
