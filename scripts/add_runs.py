"""Add the policies of finished runs to the table of controllers: `python scripts/add_runs.py RUN... [--out FILE]`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from benchmarks import baselines
from mistakes import in_words, mendable
from omegaconf import DictConfig
from reader import while_read
from saved_run import load_config, load_policy

from dynasindy.safe_io import read_json, reading
from dynasindy.viz.controllers import controller_name, name_by_planning


def controller(config: DictConfig) -> tuple[str, str]:
    """Return the name of a run's controller and where its model is from."""
    name = name_by_planning(config.planning)
    if name == controller_name("rollouts_0"):
        return name, "none"
    return name, "true" if config.world_model._target_.endswith("Oracle") else "identified"


def keys(folders: list[Path], plugins: Sequence[str] = ()) -> dict[tuple[str, ...], Path]:
    """Return the runs by plant, controller, model and seed.

    Raises:
        ValueError: Two runs have all of these in common.
    """
    found: dict[tuple[str, ...], Path] = {}
    for folder in folders:
        config = load_config(folder, plugins)
        with reading(folder / "config.yaml"):
            key = (config.system._target_.rpartition(".")[2].lower(), *controller(config), str(int(config.seed)))
        if key in found:
            raise ValueError(f"{found[key]} and {folder} are both {', '.join(key)}; give one of them")
        found[key] = folder
    return found


def main(argv: list[str]) -> None:
    """Evaluate each run's policy in scenarios A, B and C and put its rows in place of earlier ones."""
    parser = argparse.ArgumentParser(prog="add_runs.py", description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+", help="folders of finished runs")
    parser.add_argument("--out", type=Path, default=baselines.OUT, help="CSV file of the benchmark")
    parser.add_argument("--plugins", nargs="*", default=[], help="packages beside dynasindy that the runs may name")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    for key, folder in keys(arguments.runs, arguments.plugins).items():
        env, policy = load_policy(load_config(folder, arguments.plugins), folder)
        with reading(folder / "metrics.json"):
            seconds = float(read_json(folder / "metrics.json")["cost"]["plant_seconds"])
        baselines.append(arguments.out, baselines.judge(env, policy, (*key, seconds), baselines.scenarios(key[0])))
    baselines.write_tables(arguments.out)


if __name__ == "__main__":
    with while_read():
        try:
            main(sys.argv[1:])
        except Exception as error:
            if not mendable(error):
                raise
            print(f"error: {in_words(error, 'evaluate')}", file=sys.stderr)
            sys.exit(2)
