"""What the scripts that train share: one run of Algorithm 1 from a composed config."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.run import Evaluating, run


def run_job(cfg: DictConfig, progress: bool = True) -> tuple[Recipe, dict[str, Any]]:
    """Build the experiment of a config, run it, and return it with what its `metrics.json` holds."""
    if not isinstance(cfg.threads, int) or cfg.threads < 1:
        raise ValueError(f"threads must be a whole number >= 1, got {cfg.threads}; 1 unless the cores are idle")
    torch.set_num_threads(cfg.threads)
    names = [field.name for field in fields(Recipe) if field.name != "seed"]
    parts = {name: instantiate(cfg[name], _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed)
    evaluating = Evaluating(instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.every)
    return recipe, run(recipe, evaluating, Path(cfg.folder), settings_of(cfg), progress)


def settings_of(cfg: DictConfig) -> str:
    """Return the resolved config as a run folder keeps it."""
    return OmegaConf.to_yaml(cfg, resolve=True)
