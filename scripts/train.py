"""Train a controller: `python scripts/train.py [system=xi] [-m seed=0,1]`, or from a log alone: `data=csv`."""

import sys
from typing import Any

from cli import command


def train(cfg: Any) -> None:
    """Train on a plant, or plan from a log, and end with 1 where what came of it is not what the config wants."""
    from command import output
    from saved_run import plan_from_log, train_on_plant

    _, swept = output()
    work = train_on_plant if cfg.get("data") is None and cfg.model is None else plan_from_log
    if not work(cfg, swept) and not swept:
        sys.exit(1)


main = command("train")(train)

if __name__ == "__main__":
    main()
