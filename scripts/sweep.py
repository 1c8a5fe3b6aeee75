"""What is wrong with a sweep, said before any of its jobs begins."""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryFile

from command import needs_score, number_of_jobs, remove_jobless, swept
from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from mistakes import in_words, mendable
from omegaconf import DictConfig, open_dict


class Checking(Callback):
    """Check what the jobs of a sweep have in common; a mistake costs one line and exit code 2."""

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Check the config, its launcher, its log and where the results of an ablation go."""
        try:
            _check(config.copy())
        except Exception as error:
            if not mendable(error):
                raise
            remove_jobless(Path(config.hydra.sweep.dir))
            print(f"error: {in_words(error, config.hydra.job.config_name)}", file=sys.stderr)
            sys.exit(2)  # Hydra makes warnings of other exceptions


PARTS = ("system", "task", "plant", "experiment", "setting")
"""Groups that a task is made of; where jobs differ in them, each has a task of its own."""


LOGGED = ("seed", "planning", "evaluation", "scenario", "threads")
"""Groups and settings in which jobs on a log may differ without reading it in different ways."""
HERE = ("BasicLauncher", "JoblibLauncher", "LocalLauncher")
"""Launchers whose jobs run on this machine."""


def require_sweep(hydra: DictConfig) -> None:
    """Refuse a launcher or a sweeper where there is one job.

    Raises:
        ValueError: One was chosen, and no sweep was asked for.
    """
    for group in ("hydra/sweeper", "hydra/launcher"):
        if (choice := hydra.runtime.choices.get(group, "basic")) != "basic":
            raise ValueError(
                f"{group}={choice} is for many jobs, and this command is one; add -m, and give several values or a "
                "range, such as seed=0,1"
            )


def require_targets(cfg: DictConfig, hydra: DictConfig) -> None:
    """Refuse a task without targets, before a search spends runs on scores that are all the same.

    Raises:
        ValueError: The task tracks no output.
    """
    task = instantiate(cfg.task, _convert_="all")(signature=instantiate(cfg.system, _convert_="all").signature)
    if task.n_r == 0:
        given = hydra.runtime.choices.get("task", "own")
        raise ValueError(
            f"task={given} has no targets, so its jobs have no score by which the sweeper could choose the next; "
            "take a task that tracks plant.outputs, such as task=random_step, or hydra/sweeper=basic"
        )


def _check_plant(config: DictConfig, hydra: DictConfig, different: set[str]) -> None:
    """Check what the jobs track, on the plant or in the log that they share."""
    if config.get("data") is not None or config.get("model") is not None:
        if different <= {*LOGGED}:
            from logged import prepared

            prepared(config)
    elif config.get("system") is not None and config.get("task") is not None and not different & {*PARTS}:
        if needs_score(hydra):
            require_targets(config, hydra)
        instantiate(config.task, _convert_="all")(signature=instantiate(config.system, _convert_="all").signature)


def _check(config: DictConfig) -> None:
    from schema import check  # it imports torch; this module is imported before anything is shown

    from dynasindy.limits import device

    hydra = config.hydra
    launcher = hydra.launcher._target_.rpartition(".")[2]
    if launcher == "SlurmLauncher" and shutil.which("srun") is None:
        raise ValueError(
            "hydra/launcher=submitit_slurm found no srun; it needs a machine that submits to SLURM: choose "
            "hydra/launcher=joblib, or submitit_local"
        )
    if not needs_score(hydra) and not number_of_jobs(hydra):
        raise ValueError(
            "the sweep has no job, as a range in it is empty; give one with values, such as 'seed=range(0,5)'"
        )
    different = {word.lstrip("+~").partition(".")[0].partition("@")[0] for word in swept(hydra)}
    if needs_score(hydra) and not (different or any(map(hydra.sweeper.get, ("search_space", "custom_search_space")))):
        raise ValueError("nothing is searched; give a range, such as 'planning.lr=interval(0.002,0.03)'")
    with open_dict(config):
        config.folder = ""  # each job has its own
        del config.hydra
    check(config)
    if "device" in config and launcher in HERE and "device" not in different:
        device(config.device)
    if config.get("resume") is None:
        _check_plant(config, hydra, different)
    if "level" in config:
        instantiate(config.level)
        results = Path(config.results)
        results.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=results):  # permissions alone do not tell
            pass
        from dynasindy.evaluation.ablation import read_tables

        read_tables(results)  # one that is damaged is told now, and not after hours of runs
