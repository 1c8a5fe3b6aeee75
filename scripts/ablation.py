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
    if before:
        print(f"finished before: {folder}")
        return
    found, seconds = metrics["evaluation"], metrics["cost"]["wall_seconds"]
    errors = ((name, found.get(f"steady_state_error/{name}"), unit) for name, unit in metrics["units"].items())
    words = ", ".join(f"{name} {'not finite' if e is None else f'{e:.3g} {unit}'}" for name, e, unit in errors)
    print(f"finished: {folder}, steady-state error {words or 'of no output'}, {seconds:.0f} s")


if __name__ == "__main__":
    main()
