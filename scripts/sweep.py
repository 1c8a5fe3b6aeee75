"""What happens around the jobs of a sweep: mistakes are found before the first, and the end says what came of them."""

from __future__ import annotations

import shutil
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from cli import program, require_writable
from errors import MENDABLE, in_words
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from omegaconf import DictConfig, open_dict

from dynasindy.progress import say
from dynasindy.safe_io import LinkError

if TYPE_CHECKING:
    from dynasindy.evaluation.ablation import Level

TASK = {"system", "task", "plant", "experiment", "setting"}
"""Groups that a task is made of; where jobs differ in them, each has a task of its own."""
LOGGED = {"seed", "planning", "evaluation", "scenario", "threads"}
"""Groups and settings in which jobs on a log may differ without reading it in different ways."""


class Sweep(Callback):
    """Check what the jobs of a sweep share, and say at the end what came of them."""

    here: ClassVar[bool] = False
    """Whether a command was started in this process; a worker of a launcher has none."""
    running: ClassVar[str | None] = None
    """Folder of the sweep that is under way."""
    began: ClassVar[float] = 0.0
    """When it began."""
    errors: ClassVar[list[str]] = []
    """What is told as an error when all is over, a line each."""

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Find mistakes, which cost one line and exit code 2."""
        from command import one_line, show

        folder = Path(config.hydra.sweep.dir)
        Sweep.running, Sweep.began = str(folder), time.time()
        show()
        with one_line(config.hydra.job.config_name):
            if (file := folder / "multirun.yaml").is_symlink():  # Hydra would write through it
                raise LinkError(file)
            _check(config.copy())

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Say where the results are, and which jobs failed; an ablation has its tables and figures, too."""
        folder, Sweep.running = Path(config.hydra.sweep.dir), None
        reasons = sorted(str(file) for file in folder.rglob("*error.txt") if file.stat().st_mtime >= Sweep.began)
        if reasons:
            Sweep.errors.append(f"{len(reasons)} jobs failed; the reasons are in {', '.join(reasons)}")
        print(f"Sweep: {folder}")
        if any(folder.rglob("metrics.json")) and config.hydra.job.get("config_name") == "train":
            say(f"next:\n  {program('table')} {folder}  # the table of its jobs")
        if "level" in config:
            try:
                _gather(folder, Path(config.results), instantiate(config.level))
            except Exception as error:  # Hydra would make a warning of it, and the command would end with code 0
                if not isinstance(error, MENDABLE):
                    traceback.print_exc()
                Sweep.errors.append(in_words(error, "ablation"))


def _gather(folder: Path, results: Path, level: Level) -> None:
    """Make the tables and figures of all finished runs of an ablation."""
    from dynasindy.evaluation.ablation import gather
    from dynasindy.viz.learning import draw_ablation

    if gather(folder, results, level).empty:
        print(f"No run in {folder} has finished, so there are no tables and figures.")
        return
    draw_ablation(results, level.error, share=level.share)
    say((results / "ablation.md").read_text(), f"Tables and figures: {results}")


def jobs_of(hydra: DictConfig) -> tuple[int, list[str]]:
    """Return how many jobs a sweep has, and the names of the settings in which they differ.

    The sweeper's own settings come first, and the last word on each counts.
    """
    words = [f"{name}={value}" for name, value in (hydra.sweeper.get("params") or {}).items()]
    overrides = OverridesParser.create().parse_overrides([*words, *hydra.overrides.task])
    last = {override.get_key_element(): override for override in overrides}
    different = [name for name, override in last.items() if override.is_sweep_override()]
    return len(BasicSweeper.split_arguments(overrides, None)[0]), different


def _check(config: DictConfig) -> None:
    """Check the config of a sweep, its launcher, its log and where the results of an ablation go."""
    from settings import check  # it imports torch, and this module is imported before anything is shown

    hydra = config.hydra
    if hydra.launcher._target_.endswith(".SlurmLauncher") and shutil.which("srun") is None:
        raise ValueError("there is no srun here; choose hydra/launcher=joblib, or submitit_local")
    jobs, swept = jobs_of(hydra)
    if not jobs:
        raise ValueError("the sweep has no job, as a range in it is empty; give values, such as 'seed=range(0,5)'")
    different = {word.lstrip("+~").partition(".")[0].partition("@")[0] for word in swept}
    with open_dict(config):
        config.folder = ""  # each job has its own
        del config.hydra
    check(config)
    if config.get("data") is not None or config.get("model") is not None:
        if different <= LOGGED and config.get("resume") is None:
            from logged import prepare

            prepare(config)
    elif None not in map(config.get, ("system", "task")) and config.resume is None and not different & TASK:
        instantiate(config.task, _convert_="all")(signature=instantiate(config.system, _convert_="all").signature)
    if "level" in config:
        from dynasindy.evaluation.ablation import read_tables

        instantiate(config.level)
        require_writable(Path(config.results))
        read_tables(Path(config.results))  # one that is damaged is told now, and not after hours of runs
