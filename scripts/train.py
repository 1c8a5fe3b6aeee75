"""Train a controller: `python scripts/train.py [system=xi] [planning.rollouts=800] [-m seed=0,1]`."""

import sys
from pathlib import Path

from command import command
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from job import run_job
from omegaconf import DictConfig

from dynasindy.dyna.run import report
from dynasindy.viz.run import draw_run


@command("train")
def main(cfg: DictConfig) -> None:
    """Build the experiment, run it, draw its figures and print what came of it."""
    folder = Path(cfg.folder)
    recipe, metrics, known = run_job(cfg)
    if known and HydraConfig.get().mode == RunMode.MULTIRUN:
        print(f"finished before: {folder}")
        return
    draw_run(folder, recipe.system.signature)
    print(report(metrics, folder))
    if cfg.evaluation.must_improve and not metrics["verdict"]["usable"] and HydraConfig.get().mode == RunMode.RUN:
        sys.exit(1)


if __name__ == "__main__":
    main()
