"""A command as Hydra composes it: its settings are checked, and a user's mistake, or a signal, is one line.

Of a sweep, mistakes are found before its first job, and what came of the jobs is said at its end.
"""

import gc
import hashlib
import os
import re
import shutil
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import ClassVar, NoReturn

from cli import (  # isort: split
    CONF,
    SCRIPTS,
    end_with_parent,
    exit_at_once,
    handle_signals,
    pipe_guard,
    plant_settings,
    program,
    require_writable,
    stop,
)

os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us instead of Hydra's printer

import hydra
from errors import MENDABLE, MISSPELT, in_words, mendable, of_user
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf, open_dict

from dynasindy.dyna import Stopped
from dynasindy.progress import LOADING, Progress, fit_stderr, report_progress, say
from dynasindy.safe_io import LinkError, write_text
from dynasindy.sentences import use_command_words

PROGRESS = ExitStack()
"""What shows the work of the command."""
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
        folder = Path(config.hydra.sweep.dir)
        Sweep.running, Sweep.began = str(folder), time.time()
        show()
        with one_line(config.hydra.job.config_name):
            if (file := folder / "multirun.yaml").is_symlink():  # Hydra would write through it
                raise LinkError(file)
            _check_sweep(config.copy())

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Say where the results are, and which jobs failed; an ablation has its tables and figures, too."""
        folder, Sweep.running = Path(config.hydra.sweep.dir), None
        reasons = sorted(str(file) for file in folder.rglob("*error.txt") if file.stat().st_mtime >= Sweep.began)
        if reasons:
            Sweep.errors.append(f"{len(reasons)} jobs failed; the reasons are in {', '.join(reasons)}")
        print(f"Sweep: {folder}")
        if any(folder.rglob("metrics.json")) and config.hydra.job.get("config_name") == "train":
            say(f"next:\n  {program('table')} {folder}  # the table of its jobs")
        if "level" not in config:
            return
        try:
            from dynasindy.evaluation.ablation import gather
            from dynasindy.viz.learning import draw_ablation

            results, level = Path(config.results), instantiate(config.level)
            if gather(folder, results, level).empty:
                print(f"No run in {folder} has finished, so there are no tables and figures.")
                return
            draw_ablation(results, level)
            say((results / "ablation.md").read_text(), f"Tables and figures: {results}")
        except Exception as error:  # Hydra would make a warning of it, and the command would end with code 0
            if not isinstance(error, MENDABLE):
                traceback.print_exc()
            Sweep.errors.append(in_words(error, "ablation"))


def jobs_of(hydra: DictConfig) -> tuple[int, list[str]]:
    """Return how many jobs a sweep has, and the names of the settings in which they differ.

    The sweeper's own settings come first, and the last word on each counts.
    """
    words = [f"{name}={value}" for name, value in (hydra.sweeper.get("params") or {}).items()]
    overrides = OverridesParser.create().parse_overrides([*words, *hydra.overrides.task])
    last = {override.get_key_element(): override for override in overrides}
    different = [name for name, override in last.items() if override.is_sweep_override()]
    return len(BasicSweeper.split_arguments(overrides, None)[0]), different


def _check_sweep(config: DictConfig) -> None:
    """Check the config of a sweep, its launcher, its log and where the results of an ablation go."""
    from settings import check  # it imports torch

    hydra = config.hydra
    if hydra.launcher._target_.endswith(".SlurmLauncher") and shutil.which("srun") is None:
        raise ValueError("there is no srun here; choose hydra/launcher=joblib, or submitit_local")
    jobs, swept = jobs_of(hydra)
    if not jobs:
        raise ValueError("the sweep has no job, as a range in it is empty; give values, such as 'seed=range(0,5)'")
    different = {re.split(r"[.@]", word.lstrip("+~"))[0] for word in swept}
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


def run(config_name: str, task: Callable[[DictConfig], None], progress: bool = True) -> None:
    """Run a command: a bad setting or file costs one line and exit code 2.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. A finished run stays
    as it is: a sweep leaves the line beside its folder. A job of a sweep that fails does not end the others. Set
    DYNASINDY_TRACEBACK=1 to see where an error comes from.
    """

    def job(cfg: DictConfig) -> None:
        if Sweep.here and progress:
            show()
        elif not Sweep.here:
            end_with_parent()
            handle_signals(stop)
        use_command_words()
        output, swept = _output()
        with suppress(SystemExit) if swept else nullcontext(), pipe_guard(), one_line(config_name, cfg):
            try:
                import torch  # here, as a misspelt key does without it
                from settings import check

                check(cfg)
                gc.freeze()  # what was imported stays
                gc.enable()
                torch.set_num_threads(cfg.threads)
                if swept:  # an earlier refusal no longer holds
                    _refusal_file(output).unlink(missing_ok=True)
                for folder in filter(None, (cfg.get("folder"), cfg.get("output"))):
                    require_writable(Path(folder))
                task(cfg)
            except KeyboardInterrupt as end:
                line, folder = str(end), cfg.get("folder")
                if line in ("", "stopped"):
                    left = folder is not None and Path(folder).is_dir() and any(Path(folder).iterdir())
                    kept = f"what was written until then is in {folder}" if left else "nothing is kept"
                    line = f"stopped; {kept}, the same command begins anew"
                raise Stopped(line, getattr(end, "signal", 2)) from end
            finally:
                for folder in () if swept else (output, cfg.get("folder"), cfg.get("output")):
                    remove_empty(folder)

    # The jobs of a sweep run in processes of their own, which have to find the modules beside this one; joblib's
    # bookkeeper counts, line by line, what workers that were stopped no longer tidied.
    path, warned = os.environ.get("PYTHONPATH"), os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(SCRIPTS), path]))
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, ["ignore:resource_tracker", warned]))
    gc.disable()  # it would look for garbage among what is imported, a sixth of the time that this takes
    Sweep.here = True
    use_command_words()  # for what is refused before a job begins; workers of a sweep call it in `job`
    for kind in (DeprecationWarning, FutureWarning):  # what a library tells those who program with it
        warnings.simplefilter("ignore", kind)
    warnings.formatwarning = lambda message, *_, **__: fit_stderr(f"warning: {message}") + "\n"
    handle_signals(stop)
    try:
        with one_line(config_name), PROGRESS:
            parser = get_args_parser()  # which would print all options that there are
            parser.error = _refuse_option  # type: ignore[method-assign]
            parser.parse_args()
            sys.argv[1:] = complete([as_text(_resolve_latest(word)) for word in sys.argv[1:]])
            _start(hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(job))
    except KeyboardInterrupt as end:
        handle_signals(exit_at_once)
        line = " ".join((str(end) or "stopped").split())
        if Sweep.running:
            line = f"stopped; the finished jobs are kept in {Sweep.running}, the same command goes on with the others"
        print(fit_stderr(line), file=sys.stderr)
        sys.exit(128 + getattr(end, "signal", 2))
    handle_signals(exit_at_once)
    gc.freeze()  # else the interpreter looks for a second whether anything that torch made is garbage
    if Sweep.errors:
        print(*(fit_stderr(f"error: {line}") for line in Sweep.errors), sep="\n", file=sys.stderr)
        sys.exit(2)


def _output() -> tuple[Path, bool]:
    """Return the folder that Hydra gives this job, and whether it is one of a sweep."""
    return Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().mode == RunMode.MULTIRUN


def _refuse_option(said: str) -> NoReturn:
    raise ValueError(f"{said}; settings are written key=value, and --hydra-help lists the options")


def _start(main: Callable[[], None]) -> None:
    """Start a command; a setting of its plant that no file gives is added to those that one does."""
    while True:
        try:
            return main()
        except HydraException as error:
            misspelt = MISSPELT.search(str(error))
            words = [word.partition("=")[0] for word in sys.argv]
            if misspelt is None or (key := misspelt[1]) not in words or not key.startswith("plant."):
                raise
            if key.split(".")[1] not in plant_settings():
                raise
            GlobalHydra.instance().clear()
            sys.argv = [f"++{word}" if name == key else word for name, word in zip(words, sys.argv)]


def show() -> None:
    """Show from here on what the command is doing; it begins with imports, which take a moment."""
    if Progress.active is None:
        PROGRESS.enter_context(Progress())
        report_progress(LOADING)


@contextmanager
def one_line(config_name: str, cfg: DictConfig | None = None) -> Iterator[None]:
    """End with one line where the user can mend what is wrong: with exit code 2, or 1 if a computation ran away."""
    settings = None if cfg is None else OmegaConf.to_container(cfg)  # as they were given, before anything is read
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and not of_user(error):
            raise
        diverged = type(error).__name__ == "Diverged"  # its class would cost every command the import of torch
        if os.environ.get("DYNASINDY_TRACEBACK") or not (diverged or mendable(error)):
            if isinstance(error, SystemExit):  # of which Python prints nothing
                traceback.print_exception(error)
            raise
        traceback.clear_frames(error.__traceback__)  # what they hold may be the memory that is missing
        line = f"error: {in_words(error, config_name, settings)}"
        with suppress(OSError):  # the disk may be what is wrong
            folder, swept = _output() if HydraConfig.initialized() else (Path.cwd(), False)
            if not swept:
                remove_empty(folder)
            finished = (folder / "metrics.json").is_file()
            # Who gave the command has read the line; a job of a sweep always leaves its own.
            if folder.is_dir() and folder.resolve() != Path.cwd() and (swept or not finished):
                file = _refusal_file(folder) if finished else folder / "error.txt"
                file.unlink(missing_ok=True)  # it may be a link in a run folder of others
                write_text(file, line + "\n")
            remove_empty(Sweep.running)
        if Sweep.running is None:
            PROGRESS.close()  # so that the line is the last one
        print(fit_stderr(line), file=sys.stderr)
        sys.exit(1 if diverged else 2)


def _refusal_file(folder: Path) -> Path:
    """Return where the line of a job lies that was refused because its folder holds a finished run."""
    return folder.with_name(f"{folder.name}.error.txt")


def remove_empty(folder: str | Path | None) -> None:
    """Remove a folder of a run that holds nothing, or of a sweep in which no job began, and runs/ if it was all in it.

    Hydra writes the settings of a sweep before its first job.
    """
    if not isinstance(folder, str | Path) or (folder := Path(folder)).resolve() == Path.cwd():
        return
    with suppress(OSError):  # another process may just have begun to use it
        if [file.name for file in folder.iterdir()] == ["multirun.yaml"]:
            (folder / "multirun.yaml").unlink()
        folder.rmdir()
        if Path.cwd() in folder.resolve().parent.parents:
            folder.parent.rmdir()


def _resolve_latest(word: str) -> str:
    """Return a word of a command line: `run=latest` is the newest run of runs/, `run=latest~1` the one before it."""
    asked = re.fullmatch(r"(run|resume)=latest(?:~(\d+))?", word)
    if asked is None:
        return word
    files = sorted(Path("runs").glob("**/config.yaml"), key=lambda file: file.stat().st_mtime, reverse=True)
    place = int(asked[2] or 0)
    if place >= len(files):
        raise ValueError(f"{word} is none of the {len(files)} runs in runs/ of this folder; give {asked[1]}=FOLDER")
    print(f"{asked[1]}={files[place].parent}", flush=True)
    return f"{asked[1]}={_quoted(str(files[place].parent))}"


def complete(words: list[str]) -> list[str]:
    """Return the words of a command with what they imply: the folder that Hydra is to use, and the plant of a model.

    The same sweep has the same folder, so that the same command goes on with it; a resumed run keeps its own. A model
    that is given without data and without a plant, `model=model.json`, stands in the place of a log's.
    """
    implied = []
    given = dict(word.split("=", 1) for word in words if "=" in word)
    folder = given.get("resume", "null").strip("'\"")
    if given.get("model", "null") not in ("null", "") and not {"data", "system", "resume"} & set(given):
        implied.append("system=logged")
    if folder not in ("null", ""):
        if not (Path(folder) / "config.yaml").is_file():
            raise FileNotFoundError(
                f"resume={folder} is no run folder, it has no config.yaml; give the folder that train.py printed"
            )
        implied.append(f"hydra.run.dir={_quoted(folder)}")
    elif {"-m", "--multirun"} & set(words) and "hydra.sweep.dir" not in given:
        settings = [word for word in words if "=" in word and not word.startswith("hydra")]
        digest = hashlib.blake2b(" ".join(settings).encode(), digest_size=3).hexdigest()
        readable = re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(settings).replace("=", "-")).strip("-.")
        implied.append(f"hydra.sweep.dir='runs/{readable[:80]}_{digest}'")
    # Behind the last setting: Hydra reads none that an option, as --config-dir, parts from the others.
    end = max((place + 1 for place, word in enumerate(words) if "=" in word and word[0] != "-"), default=len(words))
    return [*words[:end], *implied, *words[end:]]


def as_text(word: str) -> str:
    """Return a word of a command line as Hydra reads it: a value or an item of a list that it cannot read is text.

    The shell takes away the quotation marks of `data.time="Time [ms]"`, and a bracket within a value is none that Hydra
    knows. What has brackets that are not closed is left as it is, to be refused.
    """
    key, _, value = word.partition("=")
    closed = all(value.count(a) == value.count(b) for a, b in ("[]", "()", "{}"))
    if word.startswith("-") or not value or not closed or _parses(word):
        return word
    if value[0] == "[" and value[-1] == "]":
        items = [item.strip() for item in re.split(r",(?![^\[({]*[\])}])", value[1:-1])]
        value = f"[{','.join(item if _parses(f'{key}={item}') else _quoted(item) for item in items)}]"
    elif value[0] not in "[{('\"":
        value = _quoted(value)
    made = f"{key}={value}"
    return made if _parses(made) else word


def _parses(word: str) -> bool:
    """Tell whether Hydra can read a word."""
    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return False
    return True


def _quoted(folder: str) -> str:
    """Return a path as Hydra's grammar takes any text."""
    escaped = folder.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
