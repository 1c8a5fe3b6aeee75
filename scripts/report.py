"""The paper's figures and tables beside ours: `python scripts/report.py [results=FOLDER]`."""

from pathlib import Path
from typing import Any

from cli import command


@command("report")
def main(cfg: Any) -> None:
    """Build the report from the tables of a folder and the runs in it."""
    from omegaconf import OmegaConf
    from trust import read_config

    from dynasindy.viz.report import Results, build

    results = Path(cfg.results)
    configs = {file.parent.name: read_config(file) for file in sorted(results.glob("runs/*/config.yaml"))}
    if not configs and not any(results.glob("*.csv")):
        raise ValueError(
            f"{results} holds no run and no table, so there is nothing to report; give results=FOLDER, where they are, "
            "runs as FOLDER/runs/NAME"
        )
    settings = {name: OmegaConf.to_container(config) for name, config in configs.items()}
    files = build(Results(results, settings), Path(cfg.output))
    print(f"{files[0]}, from {len(settings)} saved run{'s' * (len(settings) != 1)}")


if __name__ == "__main__":
    main()
