"""Train a controller: `python scripts/train.py [system=xi] [-m seed=0,1]`, or from a log alone: `data=csv`."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cli import command

if TYPE_CHECKING:
    from omegaconf import DictConfig


@command("train")
def main(cfg: DictConfig) -> float:
    """Build the experiment, run it, draw its figures, print what came of it and return its score."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from next_steps import following, mending
    from sweep import needs_score, require_sweep, require_targets
    from trust import read_config

    hydra = HydraConfig.get()
    swept = hydra.mode == RunMode.MULTIRUN
    if not swept:
        require_sweep(hydra)
    if cfg.get("data") is not None or cfg.model is not None:
        from logged import plan_from_log

        found = plan_from_log(cfg)
        if not (found["controlled"] or swept) and cfg.evaluation.get("must_control"):
            sys.exit(1)
        return score(found["score"])
    if swept and needs_score(hydra) and cfg.resume is None and cfg.system is not None:
        require_targets(cfg, hydra)
    from job import run_job

    folder = Path(cfg.folder)
    done = run_job(cfg)
    shares = [score(share) for share in done.metrics.get("held", {}).get("share", {}).values()]
    if done.before and swept:
        print(f"finished before: {folder}")
        return max(shares, default=math.inf)
    from dynasindy.control.files import NAME
    from dynasindy.dyna.run import run_report
    from dynasindy.progress import say
    from dynasindy.viz.controllers import name_by_planning
    from dynasindy.viz.run import draw_run  # Matplotlib, when there is something to draw

    planning = read_config(folder / "config.yaml").planning  # a run that is resumed has its own
    draw_run(folder, done.recipe.system.signature, controller=name_by_planning(planning))
    say(run_report(done.metrics, folder))
    if not swept:
        written = (folder / NAME).is_file()  # a task without targets leaves no controller to check or to export
        if done.metrics["verdict"].get("controlled") is False:
            say(mending(folder, hydra.overrides.task, done.recipe.train.episodes, written))
        else:
            say(following(folder, "evaluate", *(("check", "export") if written else ()), trusting=done.trusting))
    if not (done.enough or swept):
        sys.exit(1)
    return max(shares, default=math.inf)


def score(error: float | None) -> float:
    """Return an error by which jobs compare; what ran away has none, and is the worst."""
    return math.inf if error is None else float(error)


if __name__ == "__main__":
    main()
