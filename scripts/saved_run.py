"""Finished runs, loaded again: the environment they were made for and the policy they found."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import hydra
import torch
from cli import CONF, called
from errors import MENDABLE
from hydra._internal.config_search_path_impl import ConfigSearchPathImpl
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from settings import check as check_values
from settings import register_functions
from trust import check, read_config, trusted

from dynasindy.dyna.folder import read_weights
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Policy, Scenario
from dynasindy.limits import raise_if_memory
from dynasindy.safe_io import read_json, reading
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.sindy import Oracle, SindyModel

TWIN_ROTORS = ("dynasindy.systems.Tras", "dynasindy.systems.Trms33", "dynasindy.systems.Xi")
"""Plants of which the paper says signals and noise, which runs of earlier versions do not hold."""


def load_config(folder: Path, plugins: Sequence[str] = ()) -> DictConfig:
    """Return the resolved configuration of a run, of which nothing but admitted parts can be built.

    Args:
        folder: Run folder; it may be anybody's.
        plugins: Packages of parts that the user names, beside dynasindy; those of DYNASINDY_PLUGINS count too.

    Raises:
        FileNotFoundError: The folder is not one of a run.
        ValueError: The configuration is damaged, or names something to build that is not admitted.
    """
    file = folder / "config.yaml"
    if not file.is_file():
        raise FileNotFoundError(f"{folder} is not a run folder, it has no config.yaml; give one that train.py printed")
    config = read_config(file)
    if config.get("data") is not None or config.get("model") is not None:
        if not (folder / "metrics.json").is_file():
            raise ValueError(
                f"{folder} was planned from a log or a model, and stopped before it had a controller; its equations "
                f"are kept, so give the command in {folder / 'origin.json'} once more, with "
                f"model={folder / 'model.json'}, which plans on them without a new fit"
            )
        raise ValueError(
            f"{folder} was planned from a log or a model, so there is no plant to fly; what its controller does on "
            f"models stands in {folder / 'metrics.json'}, and {called('check')} run={folder} tells more of it"
        )
    if config.get("rig") is not None:
        raise ValueError(
            f"{folder} is that of a session on a rig, so there is no simulated plant to fly; {called('check')} "
            f"run={folder} tells what its controller does on the model, {called('rig')} folder={folder} flies again"
        )
    check(OmegaConf.to_container(config, resolve=False), trusted(plugins), str(file))
    if absent := [part for part in ("system", "task", "env", "agent", "plant") if not config.get(part)]:
        raise ValueError(f"{file} is not of a run, it has no {absent[0]}; give a folder that train.py printed")
    register_functions(config)
    return config


def load_policy(config: DictConfig, folder: Path) -> tuple[ControlEnv, Policy]:
    """Return the real environment of a run and its deployed policy.

    Raises:
        FileNotFoundError: The run did not end, it has no policy.
        ValueError: The configuration builds no environment and agent, or the saved policy does not fit the agent.
    """
    try:
        system = instantiate(config.system)
        task = instantiate(config.task, _convert_="all")(signature=system.signature)
        env = instantiate(config.env)(system=system, task=task)
        policy = instantiate(config.agent, _convert_="all")(n_obs=task.n_o, n_u=system.signature.n_u).deployed
        wanted = policy.state_dict()
    except MENDABLE:
        raise
    except Exception as error:  # any: other parts than those of a run stand where they are looked for
        raise_if_memory(error)
        raise ValueError(f"{folder}/config.yaml builds no environment and agent: {error}; restore it") from error
    if not (folder / "policy.pt").is_file():
        raise FileNotFoundError(
            f"{folder} has no policy.pt, its run did not end; go on with {called('train')} resume={folder}, or end it "
            f"there with finish=true beside it"
        )
    policy.load_state_dict(read_weights(folder / "policy.pt", wanted))
    return env, policy


def load_sensing(config: DictConfig, folder: Path, env: ControlEnv) -> Sensing | None:
    """Return the sensors and the observer through which the policy of a run sees the plant, None if it sees all states.

    Raises:
        FileNotFoundError: The run left no model or observer.
        ValueError: The configuration builds no sensors, or a file is damaged.
    """
    sensors = instantiate(config.get("sensors"), _convert_="all")
    if sensors is None:
        if not (folder / "observer.json").is_file():
            return None
        sensors = Sensors.exact(env.system.signature)  # a delay was found, for which an observer makes up
    model = instantiate(config.world_model, _convert_="all")(signature=env.system.signature)
    if not isinstance(model, Oracle):
        model = SindyModel.load(folder / "model.json")
    observer, file = Observer(model, sensors, env), folder / "observer.json"
    record = read_json(file)
    with reading(file):
        observer.load_state_dict(record)
    return Sensing(env, observer, torch.Generator())


def load_scenario(name: str, config: DictConfig, env: ControlEnv) -> Scenario:
    """Return a scenario for the plant of a run, by its name in `scenario` of conf/ or of a folder of the user's own.

    Args:
        name: Name of its file.
        config: Configuration of the run.
        env: Environment of the run, whose episodes and control period the scenario may copy.

    Raises:
        ValueError: There is no scenario of that name, or its file holds what a scenario does not have.
    """
    GlobalHydra.instance().clear()
    Hydra.create_main_hydra2("scenario", _search_path())
    try:
        options = GlobalHydra.instance().config_loader().get_group_options("scenario")
        names = sorted(option for option in options if not option.startswith("_"))
        if name not in names:
            raise ValueError(
                f"scenario '{name}' is unknown; use some of {', '.join(names)}, or give --config-dir FOLDER, in which "
                f"scenario/NAME.yaml is one of your own"
            )
        twin = ["+system=_twin_rotor"] if config.system.get("_target_") in TWIN_ROTORS else []
        found = hydra.compose(overrides=[f"+scenario={name}", *twin])
    finally:
        GlobalHydra.instance().clear()
    place = {"task": {"max_steps": env.task.max_steps}, "env": {"dt": env.dt}}
    # What a run says of a key counts as a whole: a noise of one state is no noise of the others.
    whole = OmegaConf.to_container(found)
    whole["plant"] = {key: value for key, value in whole.get("plant", {}).items() if key not in config.plant}
    merged = OmegaConf.merge(whole, {"plant": config.plant}, place)
    check_values(merged)
    scenario: Scenario = instantiate(merged.scenario, _convert_="all")
    own = OmegaConf.select(config, "scenario.seconds")
    # A run that was judged in short flights is flown in short ones, unless a scenario has its disturbance later.
    if own and own < scenario.length(env) and not scenario.windows:
        scenario = replace(scenario, seconds=own)
    return scenario


def _search_path() -> ConfigSearchPath:
    """Return where the command that runs looks for configs, as in the folder of `--config-dir`; else conf/ alone."""
    if not HydraConfig.initialized():
        return create_config_search_path(str(CONF))
    path = ConfigSearchPathImpl()
    for source in HydraConfig.get().runtime.config_sources:
        path.append(source.provider, f"{source.schema}://{source.path}")
    return path
