"""What Algorithm 1 works on, and the lengths of its loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import torch
from pydantic import Field
from tensordict import TensorDictBase
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs import EnvBase, TransformedEnv

from dynasindy.agents import MEASURED_KEYS, TD3, DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.excitation import Excitation
from dynasindy.limits import Count
from dynasindy.planning import Gate, Planner
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.sindy import WorldModel


@dataclass(kw_only=True)
class PlantComponents:
    """What an excitation needs of the parts.

    Attributes:
        plant: Real environment.
        env: The same through its sensors.
        excitation: Input signal of the data collection.
        sensing: Sensors and observer of the real environment; None where all states are seen as they are.
    """

    plant: ControlEnv
    env: EnvBase
    excitation: Excitation
    sensing: Sensing | None = None


@dataclass(kw_only=True)
class Components(PlantComponents):
    """What Algorithm 1 works on.

    Attributes:
        model_env: The same environment around the world model.
        world_model: Model to fit.
        agent: TD3 agent.
        replay: Real and model storages.
        planner: Dyna's planning phase.
        gate: Trust in the model.
    """

    model_env: ControlEnv
    world_model: WorldModel
    agent: TD3
    replay: DynaReplay
    planner: Planner
    gate: Gate

    def make_up(self, newest: TensorDictBase) -> None:
        """Have an observer make up for a delay of the inputs that was found, where states are seen as they are.

        The policy is then shown the state for the time at which its action arrives. Real rows stay, as measurements of
        what was seen. Only the newest are estimated anew, so that of the others no reference has to be known.

        Args:
            newest: The newest real control periods, `(T,)`, as the environment returned them.
        """
        if self.sensing is not None or not self.world_model.delay:
            return
        rows = self.replay.real_in_order()
        older, params = rows[: max(0, len(rows) - len(newest))].exclude("index"), newest["task_params"]
        older["task_params"] = params[:1].expand(len(older), *params.shape[1:]).clone()
        self._watch()
        for seen_before in filter(len, (older, newest.copy())):
            self.replay.extend_real(seen_before.set("measurement", seen_before["state"]))

    def _watch(self) -> None:
        """Put sensors without errors, and an observer, between the plant and all else."""
        observer = Observer(self.world_model, Sensors.exact(self.plant.system.signature), self.plant)
        self.sensing = Sensing(self.plant, observer, torch.Generator())
        self.env = TransformedEnv(self.plant, self.sensing)
        self.replay.keep(MEASURED_KEYS)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that a resumed run needs to equal an uninterrupted one, between two phases.

        Raises:
            Diverged: The agent's weights are not finite, and no run could go on from them.
        """
        self.agent.check()
        kept = {name: part.state_dict() for name, part in self._kept().items()}
        generators = {name: getattr(self, name).rng.get_state() for name in self._drawing}
        # Parts draw from generators of their own; a stranger's plant or task may use the global ones.
        return {**kept, "generators": generators, "global": GlobalRNGState().state_dict(), "gate": self.gate.is_open}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned.

        Raises:
            KeyError: The state lacks a part.
            RuntimeError: The state is of parts of other shapes.
        """
        if "sensing" in state and self.sensing is None:
            self._watch()
        for name, part in self._kept().items():
            part.load_state_dict(state[name])
        for name in self._drawing:
            getattr(self, name).rng.set_state(state["generators"][name])
        GlobalRNGState().load_state_dict(state["global"])
        self.gate.is_open = state["gate"]

    def _kept(self) -> dict[str, Any]:
        parts = {name: getattr(self, name) for name in ("world_model", "agent", "replay", "planner", "sensing")}
        task = self.plant.task
        parts |= {"task": task if task.learns else None}
        return {name: part for name, part in parts.items() if part is not None}

    _drawing: ClassVar = ("plant", "model_env")


@dataclass(frozen=True)
class LoopSettings:
    """Lengths of the loop.

    Attributes:
        episodes: Real episodes after the excitation.
        updates_per_step: Gradient updates per real step (update-to-data ratio).
        held_out: Every n-th window of 20 periods of the newest episode tests the refit instead of entering it; 0 tests
            nothing.
    """

    episodes: Count
    updates_per_step: Annotated[float, Field(ge=0, le=1e4)] = 1.0
    held_out: Literal[0] | Annotated[int, Field(ge=2)] = 4
