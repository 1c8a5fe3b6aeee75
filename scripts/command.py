"""What the scripts share: a Hydra command whose user's errors, and whose end by a signal, are one line each."""

import gc
import logging
import os
import re
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, redirect_stdout, suppress
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import ClassVar

# First, since the other imports take seconds.
from stopping import end_with_parent, leave, listen, say, stop  # isort: split

import hydra
from commands import asks, completes
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from manual import manual
from mistakes import CONF, MENDABLE, in_words, mendable
from omegaconf import DictConfig, OmegaConf, open_dict
from places import as_text, complete, require_writable
from reader import while_read

import dynasindy
from dynasindy.dyna import Stopped
from dynasindy.progress import report_progress
from dynasindy.safe_io import LinkError, write_text

# The jobs of a sweep run in processes of their own, which have to find the modules beside this one.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
# joblib's bookkeeper counts, line by line, what workers that were stopped no longer tidied.
os.environ["PYTHONWARNINGS"] = ",".join(
    filter(None, [os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker:UserWarning"])
)


PACKAGE = Path(dynasindy.__file__).parent
"""Folder of what warns in words for users; a checkout may have the package's name, too, and hold a whole venv."""
JOBS, SWEPT = "DYNASINDY_JOBS", "DYNASINDY_SWEPT"
"""Variables that tell the workers of a sweep how many jobs there are, and in which settings they differ."""
PROGRESS = ExitStack()
"""What shows the work of the command that was started in this process."""


def command(
    config_name: str, shown: bool = True
) -> Callable[[Callable[[DictConfig], float | None]], Callable[[], None]]:
    """Make a function of a config a command: a bad setting or file costs one line and exit code 2.

    What the function returns is the score of a job, by which a sweeper such as Optuna chooses the next ones.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. A finished run stays
    as it is: a sweep leaves the line beside its folder. A job of a sweep that fails does not end the others. Set
    DYNASINDY_TRACEBACK=1 to see where an error comes from.

    Args:
        config_name: File `conf/NAME.yaml`.
        shown: Whether what is under way is shown; a thread that draws would disturb one that keeps a clock.
    """

    def decorate(task: Callable[[DictConfig], float | None]) -> Callable[[], None]:
        @wraps(task)
        def guarded(cfg: DictConfig) -> float | None:
            if Sweep.here and shown:
                show()
            elif not Sweep.here:  # a worker of a launcher, in which no command was started
                end_with_parent()
                listen(stop)
            swept = HydraConfig.get().mode == RunMode.MULTIRUN
            with suppress(SystemExit) if swept else nullcontext(), while_read(), _mistakes_in_words(config_name, cfg):
                try:
                    from schema import check  # it imports torch, which a command that only prints its help does without

                    check(cfg)
                    if swept:  # an earlier refusal no longer holds
                        _beside(Path(HydraConfig.get().runtime.output_dir)).unlink(missing_ok=True)
                    for folder in filter(None, (cfg.get("folder"), cfg.get("output"))):
                        require_writable(Path(folder))
                    return task(cfg)
                except KeyboardInterrupt as signal:
                    raise _told(signal, cfg.get("folder")) from signal
                finally:
                    if not swept:
                        remove_empty(Path(HydraConfig.get().runtime.output_dir))
            return None  # a job of a sweep that failed

        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(guarded)

        @wraps(task)
        def start() -> None:
            Sweep.here = True
            warnings.formatwarning = _in_one_line
            listen(stop)
            with while_read(), _stopped_in_words(), _mistakes_in_words(config_name):
                if asks(sys.argv[1:]):
                    print(manual(config_name, sys.argv[1:]))
                    return
                sys.argv[1:] = map(as_text, sys.argv[1:])
                complete(sys.argv)
                with PROGRESS, _whole_names() if completes(sys.argv[1:]) else nullcontext():
                    main()
            listen(leave)
            gc.freeze()  # else the interpreter looks for a second whether anything that torch made is garbage
            refused = [str(file) for file in map(_beside, map(Path, Sweep.failed)) if file.is_file()]
            if failed := [folder for folder in Sweep.failed if str(_beside(Path(folder))) not in refused]:
                Sweep.wrong.append(f"{len(failed)} jobs failed; error.txt says why in {', '.join(failed)}")
            if refused:
                words = "jobs were refused, and the finished runs in their folders are as they were; the reasons are in"
                Sweep.wrong.append(f"{len(refused)} {words} {', '.join(refused)}")
            if Sweep.wrong:
                print(*(f"error: {line}" for line in Sweep.wrong), sep="\n", file=sys.stderr)
                sys.exit(2)

        return start

    return decorate


def _in_one_line(
    message: Warning | str, category: type[Warning], file: str, number: int, line: str | None = None
) -> str:
    """Return a warning of ours as a line; what else warns says where it stands."""
    if not Path(file).is_relative_to(PACKAGE):
        return f"{file}:{number}: {category.__name__}: {message}\n"
    return f"warning: {message}\n"


def show() -> None:
    """Show from here on what the command is doing; it begins with imports, which take a moment."""
    from dynasindy.progress import LOADING, Progress

    if Progress.active is None:
        PROGRESS.enter_context(Progress())
        report_progress(LOADING)


class Sweep(Callback):
    """Say which jobs of a sweep there are, where they are when all are done, and remember which failed."""

    here = False
    """Whether the command was started in this process."""
    running: ClassVar[str | None] = None
    """Folder of the sweep that is under way."""
    claim: ClassVar[ExitStack] = ExitStack()
    """Keeps the folder to this command, where its jobs could not be told from those of another one."""
    jobs: ClassVar[set[Path] | None] = None
    """Folders of its jobs; None where its folder holds no others, or where they are not known beforehand."""
    earlier: ClassVar[dict[Path, int | None]] = {}
    """The `error.txt` files of earlier commands, in and beside run folders, and when they were written [ns]."""
    failed: ClassVar[list[str]] = []
    """Folders of the jobs that failed."""
    wrong: ClassVar[list[str]] = []
    """What is told as an error when all is over, a line each."""

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Remember the folder, and show how many of the jobs are done."""
        from dynasindy.dyna.folder import claimed

        Sweep.running = str(config.hydra.sweep.dir)
        for name in ("hydra", "hydra_plugins"):  # which would list the jobs, too
            logging.getLogger(name).setLevel(logging.WARNING)
        if needs_score(config.hydra):
            _quiet_search()
        show()
        os.environ[JOBS] = str(number_of_jobs(config.hydra))
        os.environ[SWEPT] = " ".join(swept(config.hydra))
        folder = Path(Sweep.running)
        Sweep.earlier = {file: _written(file) for file in folder.rglob("*error.txt")}
        # All ablations share a folder. To compose a job takes a fifth of a second, so it is not done for nothing.
        if Sweep.earlier or any(folder.rglob("metrics.json")):
            with suppress(*MENDABLE):  # Hydra composes the jobs, too, and then says what is wrong
                Sweep.jobs = _folders(config, folder)
        try:
            Sweep.claim.enter_context(claimed(folder))
            for file in (folder / "multirun.yaml", folder / "optimization_results.yaml"):
                if file.is_symlink():  # Hydra and Optuna would write through it
                    raise LinkError(file)
        except ValueError as error:
            Sweep.running = None
            PROGRESS.close()
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)  # Hydra makes warnings of other exceptions
        if Sweep.jobs is not None:  # they are told from those of other commands, which may go on beside this one
            Sweep.claim.close()
        threading.Thread(target=_watch, args=(folder,), daemon=True).start()

    def on_job_start(self, config: DictConfig, **kwargs: object) -> None:
        """Say which job of a sweep begins."""
        if JOBS in os.environ and config.hydra.mode == RunMode.MULTIRUN:
            names = os.environ[SWEPT].split()
            words = " ".join(word for word in config.hydra.overrides.task if word.partition("=")[0] in names)
            print(f"Job {config.hydra.job.num + 1} of {os.environ[JOBS]}{words and f': {words}'}", flush=True)

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Look for the lines that failed jobs left; then say where the results are, and which are best."""
        folder, Sweep.running = Path(config.hydra.sweep.dir), None
        Sweep.claim.close()
        Sweep.failed.extend(map(str, Sweep.came(folder)[1]))  # whatever fails below
        print(f"Sweep: {folder}")
        if (found := folder / "optimization_results.yaml").is_file():
            best = OmegaConf.load(found)
            if "best_params" in best:  # a search with several objectives has no best trial
                values = " ".join(f"{name}={_short(value)}" for name, value in best.best_params.items())
                score = _short(best.best_value)
                print(f"Best trial: {values}, score {score}; plan with these words, and judge on another log")

    @classmethod
    def came(cls, folder: Path) -> tuple[list[Path], list[Path]]:
        """Return the folders of the jobs of this command that are done, and of those that failed."""

        def left(name: str) -> list[Path]:
            files = folder.rglob(name) if cls.jobs is None else (job / name for job in cls.jobs)
            return sorted(file.parent for file in files if fresh(file))

        def fresh(file: Path) -> bool:
            return _written(file) not in (None, cls.earlier.get(file))

        jobs = {file.parent for file in folder.rglob("metrics.json")} if cls.jobs is None else cls.jobs
        failed = sorted([*left("error.txt"), *(job for job in jobs if fresh(_beside(job)))])
        return [job for job in left("metrics.json") if job not in failed], failed


def _beside(folder: Path) -> Path:
    """Return where the line of a job lies that was refused because its folder holds a finished run."""
    ending = ".error.txt"  # names have 255 bytes at most, and those of jobs begin with their number
    return folder.with_name(os.fsdecode(os.fsencode(folder.name)[: 255 - len(ending)]) + ending)


def _written(file: Path) -> int | None:
    """Return when a file was written [ns], None if it is not there: a job may just have removed it."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


def _short(value: object) -> str:
    """Return a value of a setting as it may be given again; fractions have four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def needs_score(hydra_config: DictConfig) -> bool:
    """Return whether the sweeper chooses its next jobs by the score of those before, as Optuna does."""
    return "n_trials" in hydra_config.sweeper


def _quiet_search() -> None:
    """Let Optuna say nothing of its own: that a search begins is known, and why a trial failed stands in its line."""
    logging.getLogger("hydra_plugins.hydra_optuna_sweeper").setLevel(logging.CRITICAL)
    with suppress(ImportError):  # it need not be installed, and another sweeper may want scores, too
        import optuna  # first, as its import sets what it says

        optuna.logging.set_verbosity(optuna.logging.WARNING)


def number_of_jobs(hydra_config: DictConfig) -> int:
    """Return how many jobs a sweep has; a sweeper that proposes them one by one says how many in `n_trials`."""
    return int(hydra_config.sweeper.n_trials) if needs_score(hydra_config) else len(_jobs(hydra_config))


def swept(hydra_config: DictConfig) -> list[str]:
    """Return the names of the settings in which the jobs of a sweep differ; the last word on each counts."""
    given = {override.get_key_element(): override for override in _given(hydra_config)}
    return [name for name, override in given.items() if override.is_sweep_override()]


def _jobs(hydra_config: DictConfig) -> list[list[str]]:
    """Return the settings of each job of a sweep that does not need their scores."""
    (jobs,) = BasicSweeper.split_arguments(_given(hydra_config), None)
    return jobs


def _given(hydra_config: DictConfig) -> list[Override]:
    """Return the settings that a sweep was given, the sweeper's own first."""
    words = [*(f"{name}={value}" for name, value in (hydra_config.sweeper.get("params") or {}).items())]
    return OverridesParser.create().parse_overrides([*words, *hydra_config.overrides.task])


def _folders(config: DictConfig, folder: Path) -> set[Path] | None:
    """Return the folder of each job of a sweep, None where they are not known beforehand."""
    if needs_score(config.hydra):
        return None
    load = GlobalHydra.instance().config_loader().load_sweep_config
    folders = set()
    for number, words in enumerate(_jobs(config.hydra)):
        job = load(config, words)
        with open_dict(job):
            job.hydra.job.num = number
        folders.add(folder / job.hydra.sweep.subdir)
    return folders


def _watch(folder: Path) -> None:
    """Tell how many jobs of a sweep have left their results, wherever they run."""
    while Sweep.running:
        done, failed = map(len, Sweep.came(folder))
        words = f"{failed} failed" if failed else ""
        report_progress("sweep", done, int(os.environ[JOBS]), "jobs", words, outer=True)
        time.sleep(1.0)


@contextmanager
def _whole_names() -> Iterator[None]:
    """Offer a shell no names that begin with an underscore: they are parts of others, and make nothing alone."""
    with redirect_stdout(StringIO()) as offered:
        try:
            yield
        finally:
            words = [word for word in offered.getvalue().split() if not re.search(r"(^|[=/.])_", word)]
            print(*words, file=sys.__stdout__)


@contextmanager
def _mistakes_in_words(config_name: str, cfg: DictConfig | None = None) -> Iterator[None]:
    settings = None if cfg is None else OmegaConf.to_container(cfg)  # as they were given, before anything is read
    try:
        yield
    except Exception as error:
        diverged = type(error).__name__ == "Diverged"  # its class would cost every command the import of torch
        if os.environ.get("DYNASINDY_TRACEBACK") or not (diverged or mendable(error)):
            raise
        traceback.clear_frames(error.__traceback__)  # what they hold may be the memory that is missing
        line = f"error: {in_words(error, config_name, settings)}"
        with suppress(OSError):  # the disk may be what is wrong
            _leave_word(line)
            if Sweep.running:
                remove_jobless(Path(Sweep.running))
        if Sweep.running is None:
            PROGRESS.close()  # so that the line is the last one
        print(line, file=sys.stderr)
        sys.exit(1 if diverged else 2)


def _told(stop: KeyboardInterrupt, folder: str | None) -> Stopped:
    """Return what a command is stopped with: what it said itself, or else whether it left files."""
    if (line := str(stop)) in ("", "stopped"):
        left = folder is not None and Path(folder).is_dir() and any(Path(folder).iterdir())
        kept = f"what was written until then is in {folder}" if left else "nothing is kept"
        line = f"stopped; {kept}, the same command begins anew"
    return Stopped(line, getattr(stop, "signal", 2))


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
    """Remove the run folder if it is empty; else write the line into it. A job of a sweep always leaves its line.

    A finished run stays as it is: what is wrong is the command, not the run.
    """
    if not HydraConfig.initialized():
        return
    folder = Path(HydraConfig.get().runtime.output_dir)
    if not folder.is_dir() or folder.resolve() == Path.cwd():
        return
    swept, finished = HydraConfig.get().mode == RunMode.MULTIRUN, (folder / "metrics.json").is_file()
    if finished and not swept:
        return  # who gave the command has read the line
    if any(folder.iterdir()) or swept:
        file = _beside(folder) if finished else folder / "error.txt"
        file.unlink(missing_ok=True)  # it may be a link in a run folder of others
        write_text(file, line + "\n")
    else:
        remove_empty(folder)


def remove_jobless(folder: Path) -> None:
    """Remove the folder of a sweep of which no job began: it holds nothing but the settings that Hydra wrote."""
    with suppress(OSError):
        if [file.name for file in folder.iterdir()] == ["multirun.yaml"]:
            (folder / "multirun.yaml").unlink()
    remove_empty(folder)


def remove_empty(folder: Path) -> None:
    """Remove a run folder that holds nothing, as where `folder=` names another one, and runs/ if that was all in it."""
    with suppress(OSError):  # another process may just have begun to use it
        if folder.is_dir() and folder.resolve() != Path.cwd():
            folder.rmdir()
            if Path.cwd() in folder.resolve().parent.parents:
                folder.parent.rmdir()
