"""What the scripts share: a Hydra command whose user's errors, and whose end by a signal, are one line each."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import wraps
from pathlib import Path
from typing import ClassVar

# First, since the other imports take seconds.
from stopping import end_with_parent, leave, listen, say, stop  # isort: split

import hydra
from commands import asks
from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from manual import manual
from mistakes import CONF, MENDABLE, in_words
from omegaconf import DictConfig, OmegaConf
from places import complete, require_writable
from reader import while_read

# The jobs of a sweep run in processes of their own, which have to find the modules beside this one.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
# joblib's bookkeeper counts, line by line, what workers that were stopped no longer tidied.
os.environ["PYTHONWARNINGS"] = ",".join(
    filter(None, [os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker:UserWarning"])
)


def command(config_name: str) -> Callable[[Callable[[DictConfig], float | None]], Callable[[], None]]:
    """Make a function of a config a command: a bad setting or file costs one line and exit code 2.

    What the function returns is the score of a job, by which a sweeper such as Optuna chooses the next ones.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. A job of a sweep
    that fails does not end the others. Set DYNASINDY_TRACEBACK=1 to see where an error comes from.
    """

    def decorate(task: Callable[[DictConfig], float | None]) -> Callable[[], None]:
        @wraps(task)
        def guarded(cfg: DictConfig) -> float | None:
            from schema import check  # it imports torch, which a command that only prints its help does without

            if not Sweep.here:  # a worker of a launcher, in which no command was started
                end_with_parent()
                listen(stop)
            swept = HydraConfig.get().mode == RunMode.MULTIRUN
            with suppress(SystemExit) if swept else nullcontext(), while_read(), _mistakes_in_words(config_name):
                check(cfg)
                for folder in filter(None, (cfg.get("folder"), cfg.get("output"))):
                    require_writable(Path(folder))
                return task(cfg)
            return None  # a job of a sweep that failed

        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(guarded)

        @wraps(task)
        def start() -> None:
            Sweep.here = True
            listen(stop)
            with while_read(), _stopped_in_words(), _mistakes_in_words(config_name):
                if asks(sys.argv[1:]):
                    print(manual(config_name, sys.argv[1:]))
                    return
                complete(sys.argv)
                main()
            listen(leave)
            if Sweep.failed:
                folders = ", ".join(Sweep.failed)
                print(f"error: {len(Sweep.failed)} jobs failed; error.txt says why in {folders}", file=sys.stderr)
                sys.exit(2)

        return start

    return decorate


class Sweep(Callback):
    """When every job of a sweep is done, say where they are, and remember which failed."""

    here = False
    """Whether the command was started in this process."""
    running: ClassVar[str | None] = None
    """Folder of the sweep that is under way."""
    failed: ClassVar[list[str]] = []

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Remember the folder."""
        Sweep.running = str(config.hydra.sweep.dir)

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Look for the lines that failed jobs left."""
        folder = Path(config.hydra.sweep.dir)
        print(f"Sweep: {folder}")
        if (found := folder / "optimization_results.yaml").is_file():
            best = OmegaConf.load(found)
            values = " ".join(f"{name}={value:.4g}" for name, value in best.best_params.items())
            print(f"Best trial: {values}, score {best.best_value:.4g}; plan with these words, and judge on another log")
        Sweep.failed.extend(str(file.parent) for file in sorted(folder.rglob("error.txt")))


@contextmanager
def _mistakes_in_words(config_name: str) -> Iterator[None]:
    try:
        yield
    except (*MENDABLE, ArithmeticError) as error:
        diverged = type(error).__name__ == "Diverged"  # its class would cost every command the import of torch
        if os.environ.get("DYNASINDY_TRACEBACK") or (isinstance(error, ArithmeticError) and not diverged):
            raise
        line = f"error: {in_words(error, config_name)}"
        with suppress(OSError):  # the disk may be what is wrong
            _leave_word(line)
        print(line, file=sys.stderr)
        sys.exit(1 if diverged else 2)


@contextmanager
def _stopped_in_words() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as stopped:
        listen(leave)
        line = str(stopped) or "stopped"
        if Sweep.running:
            line = f"stopped; the finished jobs are kept in {Sweep.running}, the same command goes on with the others"
        say(line, getattr(stopped, "signal", 2))


def _leave_word(line: str) -> None:
    """Remove the run folder if it is empty; else write the line into it. A job of a sweep always leaves its line."""
    if not HydraConfig.initialized():
        return
    folder = Path(HydraConfig.get().runtime.output_dir)
    if not folder.is_dir() or folder.resolve() == Path.cwd():
        return
    if any(folder.iterdir()) or HydraConfig.get().mode == RunMode.MULTIRUN:
        (folder / "error.txt").unlink(missing_ok=True)  # it may be a link in a run folder of others
        (folder / "error.txt").write_text(line + "\n")
    else:
        folder.rmdir()
