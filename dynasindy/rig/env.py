"""The rig as an environment of TorchRL, in real time: what runs on a simulated plant runs on the rig.

A step applies the action, waits for the next sample, and returns; what acts has until then to think. An episode begins
at the safe input and ends there: after its last period, with any fault, and when nobody takes the next step in time.
Between two episodes the rig rests, however long fitting and planning take.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, Transform, TransformedEnv

from dynasindy.envs import ControlEnv
from dynasindy.rig.flights import FlightSequence
from dynasindy.systems import System
from dynasindy.tasks import Task

WARM = 3
"""Steps of a rehearsal."""


class RigEnv(ControlEnv):
    """A rig under a task, with the keys and specs of `ControlEnv`; its period is that of the rig's wiring.

    `state` and `samples` are what was measured at the end of each period, NaN where nothing was: unless every state has
    a sensor and no sample may be lost, `TransformedEnv(env, Sensing(env, observer, rng))` with sensors that are `Wired`
    makes estimates of them. A rig can be begun anew and stepped, and cannot be put into a state. So `start_from` begins
    where the rig is, a step must go on from the step before, and a batch has one row. Environments of other tasks made
    by `with_task` share the rig.

    Args:
        system: Names and ranges of the rig's states and inputs; its equations are not used, its stops are.
        task: What is wanted.
        flights: The rig, what is measured of it, and what ends a flight.
        dtype: Floating type of states.
        seed: Seed of the references.

    Raises:
        ValueError: The rig has other states or inputs than the system.
    """

    begins_anew = False

    def __init__(
        self, system: System, task: Task, flights: FlightSequence, *, dtype: torch.dtype = torch.float64, seed: int = 0
    ) -> None:
        theirs, ours = flights.wiring.signature, system.signature
        if (theirs.state_names, theirs.input_names) != (ours.state_names, ours.input_names):
            raise ValueError(
                f"the rig has states {', '.join(theirs.state_names)} and inputs {', '.join(theirs.input_names)}, the "
                f"system {', '.join(ours.state_names)} and {', '.join(ours.input_names)}; give the same to both"
            )
        self.flights = flights
        super().__init__(system, task, flights.wiring.dt, 1, dtype=dtype, seed=seed)
        self.register_buffer("_seen", torch.tensor(flights.wiring.seen), persistent=False)

    def with_system(self, system: System, dtype: torch.dtype | None = None, seed: int = 0) -> ControlEnv:
        """Return an environment around a model of the rig, with the same task, period and stops."""
        env = ControlEnv(system, self.task, self.dt, 1, dtype=dtype or self.float_type, seed=seed)
        env.stops = self.stops
        return env

    def with_task(self, task: Task, seed: int = 0) -> ControlEnv:
        """Return the same rig under another task; an episode of either ends where the other begins one."""
        return RigEnv(self.system, task, self.flights, dtype=self.float_type, seed=seed)

    def as_used(self, env: EnvBase) -> EnvBase:
        """Return the environment with a rehearsal before each episode."""
        return TransformedEnv(env, _Rehearsal(env, self.flights), auto_unwrap=False)

    def start_from(self, states: Tensor) -> TensorDict:
        """Begin an episode where the rig is; the states are not used, only their batch, which has one row.

        Raises:
            ValueError: The batch has more rows than one.
            Fault: The rig gives no sample to begin with.
        """
        if states.shape[:-1].numel() != 1:
            raise ValueError(f"a rig is one plant, and was asked for a batch {tuple(states.shape[:-1])}; fly one row")
        return super().start_from(self._measured(self.flights.begin()).expand(states.shape))

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Ask the rig for its safe input and close the environment."""
        self.flights.end()
        super().close(raise_if_closed=raise_if_closed)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        x, u, steps = tensordict["state"], tensordict["action"], tensordict["step_count"] + 1
        if int(steps) != self.flights.k + 1:
            self.flights.end()
            raise RuntimeError("a rig goes on from its last period only; reset it first")
        x_next = self._measured(self.flights.period(u.detach().reshape(-1).double().numpy())).expand(x.shape)
        if int(steps) >= self.task.max_steps:
            self.flights.end()  # before anything else: nothing more is to come
        touched = torch.zeros(x.shape[:-1], dtype=torch.bool)
        if self.stops is not None:
            touched = self.stops.apply(x_next)[1]
        return self._moved(tensordict, x_next.unsqueeze(-2).clone(), touched)

    def _measured(self, y: Any) -> Tensor:
        """Return a sample as a tensor, `(n_x,)`, NaN where there is no sensor."""
        return torch.as_tensor(y).to(self.float_type).masked_fill(~self._seen, torch.nan)

    def _require_rates(self) -> None:
        """Ask for none, as the equations of a rig are not known."""

    def check_plant(self) -> None:
        """Find nothing wrong, as the equations of a rig are not known."""


class _Rehearsal(Transform):
    """Take a few steps before each episode that move nothing: first calls take longer than a period has.

    The observer and the prediction of the model, which changes between episodes, have then computed before; the policy
    may take its time for its first action anyway.

    Args:
        env: The rig with all transforms around it.
        flights: Those of the rig.
    """

    def __init__(self, env: EnvBase, flights: FlightSequence) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self.__dict__["env"] = env  # transforms have parents, not children
        self.flights = flights

    @torch.no_grad()
    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        still = self.env.action_spec.zero()
        with self.flights.dry():
            for _ in range(WARM):
                self.env.step(tensordict_reset.clone().set("action", still))
        return tensordict_reset
