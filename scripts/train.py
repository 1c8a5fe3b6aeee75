"""Train a controller: `python scripts/train.py [system=xi] [planning.rollouts=800] [-m seed=0,1]`."""

from dataclasses import fields
from pathlib import Path

import torch
from command import command
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.run import Evaluating, report, run
from dynasindy.viz.run import draw_run


@command("train")
def main(cfg: DictConfig) -> None:
    """Build the experiment, run it, draw its figures and print what came of it."""
    torch.set_num_threads(cfg.threads)
    names = [field.name for field in fields(Recipe) if field.name != "seed"]
    parts = {name: instantiate(cfg[name], _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed)
    evaluating = Evaluating(instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.every)
    folder = Path(cfg.folder)
    metrics = run(recipe, evaluating, folder, OmegaConf.to_yaml(cfg, resolve=True))
    draw_run(folder, recipe.system.signature)
    print(report(metrics, folder))


if __name__ == "__main__":
    main()
