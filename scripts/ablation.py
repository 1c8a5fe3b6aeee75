"""Compare settings over seeds: `python scripts/ablation.py [system=tras] [setting=direct,oracle] ['seed=range(5)']`."""

from pathlib import Path
from typing import Any

from cli import command


@command("ablation")
def main(cfg: Any) -> None:
    """Run one job, unless it is finished."""
    from saved_run import run_job

    folder = Path(cfg.folder)
    _, _, metrics, before = run_job(cfg, progress=False)
    seconds = metrics["cost"]["wall_seconds"]
    print(f"finished before: {folder}" if before else f"finished: {folder}, {seconds:.0f} s")


if __name__ == "__main__":
    main()
