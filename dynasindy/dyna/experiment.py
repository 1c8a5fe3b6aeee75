"""An experiment: what Algorithm 1 works on, the lengths of its loop, and the recipe it is built from with one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import torch
from pydantic import Field
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs import EnvBase, TransformedEnv

from dynasindy.agents import MEASURED_KEYS, TD3, DynaReplay
from dynasindy.control import Observer
from dynasindy.control.sensing import Sensing
from dynasindy.envs import Channel, ControlEnv, Excitation, Sensors, Task
from dynasindy.limits import Count, check_memory
from dynasindy.limits import device as device_of
from dynasindy.planning import Gate, Planner
from dynasindy.sindy import WorldModel
from dynasindy.systems import System


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

    def watch(self) -> None:
        """Put sensors without errors, and an observer, between the plant and all else."""
        sensors = Sensors(dict.fromkeys(self.plant.system.signature.state_names, Channel()))
        observer = Observer(self.world_model, sensors, self.plant)
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
            self.watch()
        for name, part in self._kept().items():
            part.load_state_dict(state[name])
        for name in self._drawing:
            getattr(self, name).rng.set_state(state["generators"][name])
        GlobalRNGState().load_state_dict(state["global"])
        self.gate.is_open = state["gate"]

    def _kept(self) -> dict[str, Any]:
        parts = {name: getattr(self, name) for name in ("world_model", "agent", "replay", "planner", "sensing")}
        return {name: part for name, part in parts.items() if part is not None} | {"task": self.plant.task}

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


@dataclass(frozen=True)
class Recipe:
    """What an experiment is made of; builders that need something of the others get it when it is built.

    Attributes:
        system: The real plant.
        task: Builder of the task, called with `signature`.
        env: Builder of the real environment, called with `system`, `task` and `seed`.
        excitation: Builder of the excitation, called with `n_u` and `dt`.
        world_model: Builder of the world model, called with `signature`.
        agent: Builder of the agent, called with `n_obs`, `n_u` and `seed`, and on a GPU with `device`.
        replay: Builder of the storages, called with `seed`, and on a GPU with `device`.
        planning: Builder of the planner, called with `env`, `agent`, `replay` and `seed`.
        gate: Trust in the model.
        train: Lengths of the loop.
        sensors: What is measured of the plant; None sees all states as they are.
        seed: Seed of everything; each part draws its own from it.
        device: Where the agent learns and imagines, and its storages lie: `cpu`, or `cuda` for a GPU.
    """

    system: System
    task: Callable[..., Task]
    env: Callable[..., ControlEnv]
    excitation: Callable[..., Excitation]
    world_model: Callable[..., WorldModel]
    agent: Callable[..., TD3]
    replay: Callable[..., DynaReplay]
    planning: Callable[..., Planner]
    gate: Gate
    train: LoopSettings
    sensors: Sensors | None = None
    seed: int = 0
    device: str = "cpu"

    def build(self) -> Components:
        """Build the parts; nothing is written and no step is taken.

        Raises:
            ValueError: A part refuses its settings, there is no such device, the excitation is longer than an episode,
                or the storages do not fit into memory.
            TypeError: The plant is none.
        """
        if not isinstance(self.system, System):
            raise TypeError(f"system is a {type(self.system).__name__}; name a class of plants by system._target_")
        seeds = torch.randint(2**31, (6,), generator=torch.Generator().manual_seed(self.seed)).tolist()
        signature = self.system.signature
        plant = self.env(system=self.system, task=self.task(signature=signature), seed=seeds[0])
        plant.check_plant()
        world_model = self.world_model(signature=signature)
        model_env = plant.with_system(world_model, torch.float32, seed=seeds[1])
        model_env.delay = 0.0  # in imagined episodes inputs act at once
        device = device_of(self.device)
        there = {} if device.type == "cpu" else {"device": device}
        agent = self.agent(n_obs=plant.task.n_o, n_u=signature.n_u, seed=seeds[2], **there)
        sensing = None
        if self.sensors is not None:
            generator = torch.Generator().manual_seed(seeds[5])
            sensing = Sensing(plant, Observer(world_model, self.sensors, plant), generator)
        keys = {} if sensing is None else {"keys": MEASURED_KEYS}
        replay = self.replay(seed=seeds[3], **keys, **there)
        learned = 4 * (2 * plant.task.n_o + signature.n_u + 1)  # float32, of both storages and of a batch
        real, model = (buffer.storage.max_size for buffer in (replay.real, replay.model))
        logged = real * (2 + plant.substeps) * signature.n_x * plant.float_type.itemsize
        check_memory(
            (real + model + replay.batch_size) * learned + logged,
            f"replay.capacity={real}, model_capacity={model}, batch_size={replay.batch_size} with "
            f"env.substeps={plant.substeps} samples a row",
        )
        excitation = self.excitation(n_u=signature.n_u, dt=plant.dt)
        if excitation.n_steps > plant.task.max_steps:
            raise ValueError(
                f"an excitation of {excitation.n_steps * plant.dt:g} s does not fit into an episode of "
                f"{plant.task.max_steps * plant.dt:g} s; shorten excitation.duration or raise task.max_steps"
            )
        return Components(
            plant=plant,
            env=plant if sensing is None else TransformedEnv(plant, sensing),
            model_env=model_env,
            excitation=excitation,
            world_model=world_model,
            agent=agent,
            replay=replay,
            planner=self.planning(env=model_env, agent=agent, replay=replay, seed=seeds[4]),
            gate=self.gate,
            sensing=sensing,
        )
