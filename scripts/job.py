"""What the scripts that train share: one run of Algorithm 1 from a composed config."""

import json
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from command import CONF
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.run import Evaluating, run


def run_job(cfg: DictConfig, progress: bool = True) -> tuple[Recipe, dict[str, Any]]:
    """Build the experiment of a config, run it, and return it with what its `metrics.json` holds."""
    if not isinstance(cfg.threads, int) or cfg.threads < 1:
        raise ValueError(f"threads must be a whole number >= 1, got {cfg.threads}; 1 unless the cores are idle")
    settings = settings_of(cfg)
    torch.set_num_threads(cfg.threads)
    names = [field.name for field in fields(Recipe) if field.name != "seed"]
    parts = {name: instantiate(cfg[name], _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed)
    evaluating = Evaluating(instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.every)
    origin = command_and_commit(HydraConfig.get())
    metrics = run(recipe, evaluating, Path(cfg.folder), settings, progress)
    (Path(cfg.folder) / "origin.json").write_text(json.dumps(origin, indent=2) + "\n")
    return recipe, metrics


def settings_of(cfg: DictConfig) -> str:
    """Return the resolved config as a run folder keeps it.

    Raises:
        ValueError: The config names no plant, only a log of one.
    """
    if cfg.system is None:
        given = HydraConfig.get().runtime.choices.system
        plants = sorted(file.stem for file in (CONF / "system").glob("*.yaml") if file.stem != given)
        raise ValueError(
            f"system={given} is no plant to train on, only a log of one; choose one of {', '.join(plants)}, "
            "or fit a model to the log: python scripts/identify.py data=csv data.path=FILE"
        )
    return OmegaConf.to_yaml(cfg, resolve=True)


def command_and_commit(job: DictConfig) -> dict[str, str]:
    """Return the command line of a job and the commit of the code, "unknown" outside a git checkout."""
    git = ["git", "-C", str(CONF.parent), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    return {"command": " ".join([f"python scripts/{job.job.name}.py", *job.overrides.task]), "commit": commit}
