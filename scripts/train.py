"""Train a controller: `python scripts/train.py [system=xi] [-m seed=0,1]`, or from a log alone: `data=csv`."""

import sys
from pathlib import Path

from command import command
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig


@command("train")
def main(cfg: DictConfig) -> None:
    """Build the experiment, run it, draw its figures and print what came of it."""
    if cfg.get("data") is not None or cfg.model is not None:
        from logged import plan_from_log

        if not plan_from_log(cfg).controlled and cfg.evaluation.get("must_control"):
            sys.exit(1)
        return
    from job import run_job

    folder = Path(cfg.folder)
    done, swept = run_job(cfg), HydraConfig.get().mode == RunMode.MULTIRUN
    if done.before and swept:
        print(f"finished before: {folder}")
        return
    from dynasindy.dyna.run import report
    from dynasindy.viz.run import draw_run  # Matplotlib, when there is something to draw

    draw_run(folder, done.recipe.system.signature)
    print(report(done.metrics, folder))
    if not (done.enough or swept):
        sys.exit(1)


if __name__ == "__main__":
    main()
