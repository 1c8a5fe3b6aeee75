"""Finished runs, loaded again: the environment they were made for and the policy they found."""

from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import instantiate
from mistakes import CONF
from omegaconf import DictConfig, OmegaConf

from dynasindy.dyna.weights import read_weights
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Policy, Scenario


def load_config(folder: Path) -> DictConfig:
    """Return the resolved configuration of a run.

    Raises:
        FileNotFoundError: The folder is not one of a run.
    """
    file = folder / "config.yaml"
    if not file.is_file():
        raise FileNotFoundError(f"{folder} is not a run folder, it has no config.yaml; give one that train.py printed")
    config = OmegaConf.load(file)
    assert isinstance(config, DictConfig)
    return config


def load_policy(config: DictConfig, folder: Path) -> tuple[ControlEnv, Policy]:
    """Return the real environment of a run and its deployed policy.

    Raises:
        FileNotFoundError: The run did not end, it has no policy.
        ValueError: The saved policy does not fit the agent of the configuration.
    """
    system = instantiate(config.system)
    task = instantiate(config.task, _convert_="all")(signature=system.signature)
    env = instantiate(config.env)(system=system, task=task)
    policy = instantiate(config.agent, _convert_="all")(n_obs=task.n_o, n_u=system.signature.n_u).deployed
    if not (folder / "policy.pt").is_file():
        raise FileNotFoundError(f"{folder} has no policy.pt, its run did not end; give the folder of a finished run")
    policy.load_state_dict(read_weights(folder / "policy.pt", policy.state_dict()))
    return env, policy


def load_scenario(name: str, config: DictConfig) -> Scenario:
    """Return a scenario by its name in conf/scenario, for the plant of a run.

    Raises:
        ValueError: There is no scenario of that name.
    """
    names = sorted(path.stem for path in (CONF / "scenario").glob("*.yaml"))
    if name not in names:
        raise ValueError(f"scenario '{name}' is unknown; use some of {', '.join(names)}")
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        merged = OmegaConf.merge({"plant": config.plant}, hydra.compose(overrides=[f"+scenario={name}"]))
    scenario: Scenario = instantiate(merged.scenario, _convert_="all")
    return scenario
