"""Runs of Algorithm 1: made from a composed config, gone on with, and loaded again for their policy."""

import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch
from cli import CONF, IN_CLONE, group_options, program
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from settings import check
from trust import plugins_of, read_config, require_trusted
from words import compose, unknown_name

from dynasindy.control import load
from dynasindy.control.files import NAME
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.folder import read_weights, result
from dynasindy.dyna.recorder import Evaluating
from dynasindy.dyna.run import run
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Policy, Scenario
from dynasindy.safe_io import read_json, reading
from dynasindy.sensing import Channel, Observer, Sensing, Sensors
from dynasindy.sindy import Oracle, SindyModel

NO_PLANT = {"rig": "is a session on a rig", "data": "was planned from a log", "model": "was planned from a model"}
"""Settings of folders that hold no run on a simulated plant, and what these are."""


def run_job(cfg: DictConfig, progress: bool = True) -> tuple[DictConfig, Recipe, dict[str, Any], bool]:
    """Build the experiment of a config and run it, unless it has ended before.

    Returns:
        Its settings, the run's own where it went on with one; the experiment; what its `metrics.json` holds; and
        whether it had ended before.
    """
    job = HydraConfig.get()
    if cfg.resume is not None:
        cfg = _resumed(cfg, job)
    if cfg.system is None:
        raise ValueError(
            f"system={job.runtime.choices.system} is no plant to train on, only a log of one; choose another, or fit a "
            f"model to the log: {program('identify')} data=csv data.path=FILE"
        )
    folder, begun = Path(cfg.folder), cfg.copy()
    begun.resume, begun.finish = None, False  # a run that is resumed before its first checkpoint writes them anew
    config = OmegaConf.to_yaml(begun, resolve=True)  # before anything is built, which names what is not given less well
    names = [field.name for field in fields(Recipe) if field.name not in ("seed", "device")]
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed, device=cfg.get("device", "cpu"))
    scenario, within = instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.get("within", 0.01)
    evaluating = Evaluating(scenario, cfg.evaluation.every, within, cfg.get("tensorboard", False))
    if progress:
        print(f"Run folder: {folder}", flush=True)
    before = result(folder, recipe.train.episodes) is not None
    kept = cfg.checkpoint.every, shlex.join([*program("train").split(), *plugins_of(cfg)])
    metrics = run(recipe, evaluating, folder, config, command_and_commit(job), *kept, progress, cfg.finish)
    return cfg, recipe, metrics, before


def _resumed(cfg: DictConfig, job: DictConfig) -> DictConfig:
    """Return the config of the run to resume, in the folder where it is now."""
    own = ("resume", "finish", "threads", "plugins", "device")
    if others := [word for word in job.overrides.task if word.partition("=")[0] not in own]:
        raise ValueError(f"resume={cfg.resume} goes on with the run's own settings; leave out {' '.join(others)}")
    folder = Path(cfg.resume)
    saved = load_config(folder, cfg.plugins)
    ended = (folder / "metrics.json").is_file() and not (folder / "checkpoints").is_dir()
    if ended and result(folder, saved.train.episodes) is None:
        raise ValueError(f"{folder} holds results and no checkpoint to go on from; give the folder of a stopped run")
    given = {name: cfg[name] for name in own if name != "plugins"}
    return DictConfig({**saved, **given, "folder": str(folder.absolute())})


def command_and_commit(job: DictConfig) -> dict[str, str]:
    """Return the command line of a job and the commit of the code, "unknown" outside a git checkout.

    An installed package is in none, though it may lie in one of the user's.
    """
    git = ["git", "-C", str(CONF.parent), "describe", "--always", "--dirty", "--exclude", "*"]
    asked = IN_CLONE and shutil.which("git") is not None
    commit = subprocess.run(git, capture_output=True, text=True).stdout.strip() if asked else ""
    return {"command": " ".join([program(job.job.config_name), *job.overrides.task]), "commit": commit or "unknown"}


def load_config(folder: Path, plugins: Sequence[str] = ()) -> DictConfig:
    """Return the resolved configuration of a run, of which nothing but parts of dynasindy and plug-ins can be built.

    The folder may be anybody's.
    """
    file = folder / "config.yaml"
    if not file.is_file():
        raise FileNotFoundError(f"{folder} is not a run folder, it has no config.yaml; give one that train.py printed")
    config = read_config(file)
    if kinds := [what for key, what in NO_PLANT.items() if config.get(key) is not None]:
        told = f"{program('check')} run={folder} tells what its controller does on the model"
        raise ValueError(f"{folder} {kinds[0]}, so there is no simulated plant to fly; {told}")
    require_trusted(OmegaConf.to_container(config, resolve=False), plugins, str(file))
    check(config, str(file))
    return config


def load_policy(config: DictConfig, folder: Path) -> tuple[ControlEnv, Policy]:
    """Return the real environment of a run and its deployed policy."""
    system = instantiate(config.system)
    task = instantiate(config.task, _convert_="all")(signature=system.signature)
    env = instantiate(config.env)(system=system, task=task)
    if not (folder / "policy.pt").is_file():
        if (folder / NAME).is_file():
            return env, load(folder).policy  # a controller that was handed on without the files of its training
        goes_on = f"go on with {program('train')} resume={folder}, or end it with finish=true beside it"
        raise FileNotFoundError(f"{folder} has no policy.pt, its run did not end; {goes_on}")
    policy = instantiate(config.agent, _convert_="all")(n_obs=task.n_o, n_u=system.signature.n_u).deployed
    policy.load_state_dict(read_weights(folder / "policy.pt", policy.state_dict()))
    return env, policy


def load_sensing(config: DictConfig, folder: Path, env: ControlEnv) -> Sensing | None:
    """Return sensors and observer through which the policy of a run sees the plant, None if it sees all states."""
    sensors = instantiate(config.get("sensors"), _convert_="all")
    if sensors is None:
        if not (folder / "observer.json").is_file():
            return None
        # A delay was found, for which an observer makes up.
        sensors = Sensors(dict.fromkeys(env.system.signature.state_names, Channel()))
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

    It may copy episodes and control period of the run's environment.
    """
    if name not in (names := group_options("scenario")):
        raise ValueError(unknown_name(name, names, "scenario"))
    place = {"task": {"max_steps": env.task.max_steps}, "env": {"dt": env.dt}, "plant": config.plant}
    merged: Any = OmegaConf.merge(place, OmegaConf.to_container(compose(None, [f"+scenario={name}"])))
    check(merged)
    scenario: Scenario = instantiate(merged.scenario, _convert_="all")
    own = OmegaConf.select(config, "scenario.seconds")
    # A run that was judged in short flights is flown in short ones, unless a scenario has its disturbance later.
    if own and own < scenario.length(env) and not scenario.windows:
        scenario = replace(scenario, seconds=own)
    return scenario
