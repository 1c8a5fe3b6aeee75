"""What the scripts that train share: one run of Algorithm 1 from a composed config."""

import shlex
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

from cli import CONF, IN_CLONE, program
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from saved_run import load_config
from trust import packages

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.folder import result
from dynasindy.dyna.recorder import Evaluating
from dynasindy.dyna.run import run


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
    folder = Path(cfg.folder)
    begun = cfg.copy()  # a run that is resumed before its first checkpoint writes them anew
    begun.resume, begun.finish = None, False
    config = OmegaConf.to_yaml(begun, resolve=True)  # before anything is built, which names what is not given less well
    names = [field.name for field in fields(Recipe) if field.name not in ("seed", "device")]
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed, device=cfg.get("device", "cpu"))
    evaluating = Evaluating(
        instantiate(cfg.scenario, _convert_="all"),
        cfg.evaluation.every,
        cfg.evaluation.get("within", 0.01),
        cfg.get("tensorboard", False),
    )
    if progress:
        print(f"Run folder: {folder}", flush=True)
    before = result(folder, recipe.train.episodes) is not None
    kept = cfg.checkpoint.every, shlex.join([*program("train").split(), *plugins_of(cfg)])
    metrics = run(recipe, evaluating, folder, config, command_and_commit(job), *kept, progress, cfg.finish)
    return cfg, recipe, metrics, before


def plugins_of(cfg: DictConfig) -> tuple[str, ...]:
    """Return the word of a command line that names the packages of the user's own parts; none where there are none."""
    own = packages(OmegaConf.to_container(cfg, resolve=True))
    return (f"plugins=[{','.join(own)}]",) if own else ()


def _resumed(cfg: DictConfig, job: DictConfig) -> DictConfig:
    """Return the config of the run to resume, in the folder where it is now."""
    own = ("resume=", "finish=", "threads=", "plugins=", "device=")
    if others := [word for word in job.overrides.task if not word.startswith(own)]:
        raise ValueError(f"resume={cfg.resume} goes on with the run's own settings; leave out {' '.join(others)}")
    folder = Path(cfg.resume)
    saved = load_config(folder, cfg.plugins)
    ended = (folder / "metrics.json").is_file() and not (folder / "checkpoints").is_dir()
    if ended and result(folder, saved.train.episodes) is None:
        raise ValueError(
            f"{folder} holds results and no checkpoint, it cannot go on and would begin anew; give the folder of a "
            "stopped run, or restore its files"
        )
    given = {name: cfg[name] for name in ("resume", "finish", "threads", "device")}
    return DictConfig({**saved, **given, "folder": str(folder.absolute())})


def command_and_commit(job: DictConfig) -> dict[str, str]:
    """Return the command line of a job and the commit of the code, "unknown" outside a git checkout.

    An installed package is in none, though it may lie in one of the user's.
    """
    git = ["git", "-C", str(CONF.parent), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip() if IN_CLONE else ""
    except (OSError, subprocess.CalledProcessError):
        commit = ""
    return {"command": " ".join([program(job.job.config_name), *job.overrides.task]), "commit": commit or "unknown"}
