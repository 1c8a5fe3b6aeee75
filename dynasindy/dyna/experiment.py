"""An experiment: the parts of Algorithm 1, built from a recipe and one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torchrl.envs import TransformedEnv

from dynasindy.agents import MEASURED_KEYS, TD3, DynaReplay
from dynasindy.dyna.components import Components, LoopSettings
from dynasindy.envs import ControlEnv
from dynasindy.excitation import Excitation
from dynasindy.limits import check_memory
from dynasindy.limits import device as device_of
from dynasindy.planning import Gate, Planner
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.sindy import WorldModel
from dynasindy.systems import System
from dynasindy.tasks import Task


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
