"""The paper's figures and tables beside ours: `python scripts/report.py [results=FOLDER]`."""

from pathlib import Path
from typing import Any

from cli import command


@command("report")
def main(cfg: Any) -> None:
    """Build the report from the tables of a folder and the runs in it."""
    from dynasindy.viz.report import build

    results = Path(cfg.results)
    files = sorted(results.glob("runs/*/config.yaml"))
    if not files and not any(results.glob("*.csv")):
        raise ValueError(f"{results} holds no run and no table; give results=FOLDER of tables, and runs in FOLDER/runs")
    page, *_ = build(results, Path(cfg.output))
    print(f"{page}, from {len(files)} saved run{'s' * (len(files) != 1)}")


if __name__ == "__main__":
    main()
