"""Compare settings over seeds: `python scripts/ablation.py [system=tras] [setting=direct,oracle] ['seed=range(5)']`."""

from pathlib import Path
from typing import Any

from cli import command


@command("ablation")
def main(cfg: Any) -> None:
    """Run one job, unless it is finished."""
    from job import run_job

    from dynasindy.evaluation.ablation import errors_in_words

    folder = Path(cfg.folder)
    done = run_job(cfg, progress=False)
    if done.before:
        print(f"finished before: {folder}")
        return
    seconds = done.metrics["cost"]["wall_seconds"]
    print(f"finished: {folder}, steady-state error {errors_in_words(done.metrics)}, {seconds:.0f} s")


if __name__ == "__main__":
    main()
