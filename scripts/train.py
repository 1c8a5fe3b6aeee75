"""Train a controller: `python scripts/train.py [system=xi] [planning.rollouts=800] [-m seed=0,1]`."""

import dataclasses
import os
from pathlib import Path

os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

import hydra
import torch
from command import one_line_errors
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.run import Evaluating, report, run
from dynasindy.viz.run import draw_run


@hydra.main(version_base="1.3", config_path="../conf", config_name="train")
def main(cfg: DictConfig) -> None:
    """Build the experiment, run it, draw its figures and print what came of it."""
    torch.set_num_threads(cfg.threads)
    folder = Path(cfg.folder)
    names = [field.name for field in dataclasses.fields(Recipe)]
    recipe = Recipe(**{name: instantiate(cfg[name], _convert_="all") if name != "seed" else cfg.seed for name in names})
    evaluating = Evaluating(instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.every)
    metrics = run(recipe, evaluating, folder, OmegaConf.to_yaml(cfg, resolve=True))
    draw_run(folder, recipe.system.signature)
    print(report(metrics, folder))


if __name__ == "__main__":
    one_line_errors(main)
