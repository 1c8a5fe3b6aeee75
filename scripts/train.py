"""Train a controller: `python scripts/train.py [system=xi] [-m seed=0,1]`, or from a log alone: `data=csv`."""

import sys
from pathlib import Path
from typing import Any

from cli import command


@command("train")
def main(cfg: Any) -> None:
    """Build the experiment, run it, draw its figures and print what came of it."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    swept, words = HydraConfig.get().mode == RunMode.MULTIRUN, HydraConfig.get().overrides.task
    if cfg.get("data") is not None or cfg.model is not None:
        from logged import plan_from_log

        controlled = plan_from_log(cfg)
        if not (controlled or swept) and cfg.evaluation.get("must_control"):
            sys.exit(1)
        return
    from next_steps import improvements, next_steps, run_steps
    from saved_run import run_job
    from trust import plugins_of

    from dynasindy.control.files import NAME
    from dynasindy.dyna.run import run_report
    from dynasindy.progress import say
    from dynasindy.viz.controllers import name_by_planning

    folder = Path(cfg.folder)
    cfg, recipe, metrics, before = run_job(cfg)
    if before and swept:
        print(f"finished before: {folder}")
        return
    from dynasindy.viz.run import draw_run  # Matplotlib, when there is something to draw

    draw_run(folder, recipe.system.signature, tuple(cfg.get("formats", ("png",))), name_by_planning(cfg.planning))
    say(run_report(metrics, folder))
    if swept:
        return
    controlled = metrics["verdict"].get("controlled") is not False
    written = (folder / NAME).is_file()  # a task without targets leaves no controller to check or to export
    if controlled:
        flown = run_steps(folder, "evaluate", plugins=plugins_of(cfg))
        say(next_steps(*flown, *(run_steps(folder, "check", "export") if written else ())))
    else:
        say(improvements(folder, words, recipe.train.episodes, written, metrics["imagined_error"]))
    wanted = cfg.evaluation
    if (wanted.must_improve and not metrics["verdict"]["usable"]) or (wanted.get("must_control") and not controlled):
        sys.exit(1)


if __name__ == "__main__":
    main()
