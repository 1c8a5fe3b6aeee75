"""A command as Hydra composes it: its words and settings are checked; a user's mistake, or a signal, is one line.

Of a sweep, mistakes are found before its first job, and what came of the jobs is said at its end.
"""

import gc
import hashlib
import os
import re
import shutil
import signal
import sys
import threading
import time
import traceback
import warnings
from argparse import SUPPRESS, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import cache
from importlib.metadata import requires
from pathlib import Path
from typing import Any, ClassVar

import hydra
import yaml
from cli import CONF, config_dir, exit_now, group_options, handle_signals, pipe_guard, program, require_writable
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

import dynasindy
from dynasindy.limits import memory_wanted
from dynasindy.progress import LOADING, Progress, report_progress, say
from dynasindy.safe_io import LinkError, error_text, write_text
from dynasindy.sentences import use_command_words
from dynasindy.text import did_you_mean

SCRIPTS, PACKAGE = Path(__file__).parent, Path(dynasindy.__file__).parent
OTHERS = re.compile(r"^<|[/\\](site-packages|dist-packages|lib[/\\]python3[^/\\]*)[/\\]")
"""Where the code of libraries lies."""
MENDABLE = (
    *(yaml.YAMLError, ValueError, TypeError, KeyError, OSError, ModuleNotFoundError),
    *(HydraException, OmegaConfBaseException),
)
PROGRESS = ExitStack()
"""What shows the work of the command."""
ONE_TASK = {"seed", "setting", "agent", "planning", "evaluation", "scenario", "train", "replay", "gate", "threads"}
"""Groups and settings in which jobs of a sweep may differ that have one task, and read a log in one way."""
PARSER = OverridesParser.create()


class Sweep(Callback):
    """Check what the jobs of a sweep share before the first one."""

    config: ClassVar[DictConfig | None] = None
    """What the jobs of the sweep that is under way share."""

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Find mistakes, which cost one line and exit code 2."""
        Sweep.config = config
        show()
        with one_line():
            if (file := Path(config.hydra.sweep.dir) / "multirun.yaml").is_symlink():  # Hydra would write through it
                raise LinkError(file)
            _check_sweep(config.copy())


def _check_sweep(config: DictConfig) -> None:
    """Check the config of a sweep, its launcher, its log and where the results of an ablation go."""
    from settings import check  # it imports torch

    if config.hydra.launcher._target_.endswith(".SlurmLauncher") and shutil.which("srun") is None:
        raise ValueError("there is no srun here; choose hydra/launcher=joblib, or submitit_local")
    given = PARSER.parse_overrides(config.hydra.overrides.task)
    swept = [*(config.hydra.sweeper.get("params") or {}), *(o.key_or_group for o in given if o.is_sweep_override())]
    shared = {name.partition(".")[0] for name in swept} <= ONE_TASK and config.get("resume") is None
    with open_dict(config):
        config.folder = ""  # each job has its own
        del config.hydra
    check(config)
    if shared and (config.get("data") is not None or config.get("model") is not None):
        from saved_run import prepare

        prepare(config)
    elif shared and None not in map(config.get, ("system", "task")):
        instantiate(config.task, _convert_="all")(signature=instantiate(config.system, _convert_="all").signature)
    if "level" in config:
        from dynasindy.evaluation.ablation import CURVES, TABLE, read_ablation

        instantiate(config.level)
        require_writable(Path(config.results))
        for name in (TABLE, CURVES):  # one that is damaged is told now, and not after hours of runs
            read_ablation(Path(config.results) / name)


def end_sweep(config: DictConfig, began: float) -> None:
    """Say where the results of a sweep are, and which jobs failed; an ablation has its tables and figures, too."""
    folder = Path(config.hydra.sweep.dir)
    print(f"Sweep: {folder}")
    try:
        finished = any(folder.rglob("metrics.json"))
        if finished and "level" in config:
            from dynasindy.evaluation.ablation import gather
            from dynasindy.viz.learning import draw_ablation

            results, level = Path(config.results), instantiate(config.level)
            gather(folder, results, level)
            draw_ablation(results, level)
            say((results / "ablation.md").read_text(), f"Tables and figures: {results}")
        elif finished:
            say(f"next:\n  {program('table')} {folder}  # the table of its jobs")
    finally:  # jobs that failed may be why there are no tables
        if reasons := sorted(str(file) for file in folder.rglob("*error.txt") if file.stat().st_mtime >= began):
            raise ValueError(f"{len(reasons)} jobs failed; the reasons are in {', '.join(reasons)}")


def run(config_name: str, task: Callable[[DictConfig], None]) -> None:
    """Run a command: a bad setting or file costs one line and exit code 2.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. A finished run stays
    as it is: a sweep leaves the line beside its folder. A job of a sweep that fails does not end the others. Set
    DYNASINDY_TRACEBACK=1 to see where an error comes from.
    """
    process, began = os.getpid(), time.time()

    def job(cfg: DictConfig) -> None:
        if os.getpid() != process:  # a worker of a launcher
            end_with_parent()
            handle_signals(stop)
        elif config_name != "rig":  # whose clock a thread that draws would disturb
            show()
        use_command_words()
        folder, swept = output()
        with suppress(SystemExit) if swept else nullcontext(), pipe_guard(), one_line(cfg):
            try:
                import torch  # here, as a misspelt key does without it
                from settings import check

                check(cfg)
                gc.freeze()  # what was imported stays
                gc.enable()
                torch.set_num_threads(cfg.threads)
                if swept:  # an earlier refusal no longer holds
                    folder.with_name(f"{folder.name}.error.txt").unlink(missing_ok=True)
                for place in filter(None, (cfg.get("folder"), cfg.get("output"))):
                    require_writable(Path(place))
                task(cfg)
            finally:
                for place in () if swept else (folder, cfg.get("folder"), cfg.get("output")):
                    remove_empty(place)

    # The jobs of a sweep run in processes of their own, which have to find the modules beside this one; joblib's
    # bookkeeper counts, line by line, what workers that were stopped no longer tidied.
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(SCRIPTS), os.environ.get("PYTHONPATH")]))
    os.environ["PYTHONWARNINGS"] = f"ignore:resource_tracker,{os.environ.get('PYTHONWARNINGS', '')}".rstrip(",")
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us instead of Hydra's printer
    gc.disable()  # it would look for garbage among what is imported, a sixth of the time that this takes
    use_command_words()  # for what is refused before a job begins; workers of a sweep call it in `job`
    for kind in (DeprecationWarning, FutureWarning):  # what a library tells those who program with it
        warnings.simplefilter("ignore", kind)
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    handle_signals(stop)
    try:
        with one_line(), PROGRESS:
            sys.argv[1:] = read_words(config_name, sys.argv[1:])
            hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(job)()
            if Sweep.config is not None:
                end_sweep(Sweep.config, began)
    except KeyboardInterrupt as end:
        handle_signals(exit_now)
        line = "stopped; the same command begins anew" if str(end) in ("", "stopped") else " ".join(str(end).split())
        if Sweep.config is not None:
            line = f"stopped; what is finished stays in {Sweep.config.hydra.sweep.dir}, the same command does the rest"
        print(line, file=sys.stderr)
        sys.exit(128 + getattr(end, "signal", 2))
    handle_signals(exit_now)
    gc.freeze()  # else the interpreter looks for a second whether anything that torch made is garbage


def stop(number: int, frame: object) -> None:
    """Leave what is under way; a second signal leaves at once."""
    from dynasindy.dyna import Stopped

    handle_signals(exit_now)
    raise Stopped("stopped", number)


@cache
def end_with_parent() -> None:
    """End this process, a worker of a sweep, when its parent is gone, so that it races no later sweep.

    At once, since its launcher would catch an exception and go on with the next job; what is kept survives that.
    """
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def output() -> tuple[Path, bool]:
    """Return the folder that Hydra gives this job, and whether it is one of a sweep."""
    return Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().mode == RunMode.MULTIRUN


def show() -> None:
    """Show from here on what the command is doing; it begins with imports, which take a moment."""
    PROGRESS.enter_context(Progress())
    report_progress(LOADING)


@contextmanager
def one_line(cfg: DictConfig | None = None) -> Iterator[None]:
    """End with one line where the user can mend what is wrong: with exit code 2, or 1 if a computation ran away."""
    settings = None if cfg is None else OmegaConf.to_container(cfg)  # as they were given, before anything is read
    try:
        yield
    except (Exception, SystemExit) as error:
        words = in_words(error, settings)
        if not words:
            raise
        if os.environ.get("DYNASINDY_TRACEBACK"):
            traceback.print_exception(error)
        traceback.clear_frames(error.__traceback__)  # what they hold may be the memory that is missing
        line = f"error: {words}"
        with suppress(OSError):  # the disk may be what is wrong
            begun = HydraConfig.initialized() and not OmegaConf.is_missing(HydraConfig.get().runtime, "output_dir")
            folder, swept = output() if begun else (Path.cwd(), False)
            finished = (folder / "metrics.json").is_file()
            # Who gave the command has read the line; a job of a sweep always leaves its own.
            if folder.is_dir() and folder.resolve() != Path.cwd() and (swept or not finished):
                file = folder.with_name(f"{folder.name}.error.txt") if finished else folder / "error.txt"
                file.unlink(missing_ok=True)  # it may be a link in a run folder of others
                write_text(file, line + "\n")
            remove_empty(Sweep.config and Sweep.config.hydra.sweep.dir)
        if Sweep.config is None:
            PROGRESS.close()  # so that the line is the last one
        print(line, file=sys.stderr)
        sys.exit(1 if type(error).__name__ == "Diverged" else 2)


def remove_empty(folder: str | Path | None) -> None:
    """Remove an empty folder of a run, or that of a sweep in which no job began, and runs/ if it was all in it."""
    if not isinstance(folder, str | Path) or (folder := Path(folder)).resolve() == Path.cwd():
        return
    with suppress(OSError):  # another process may just have begun to use it
        if [file.name for file in folder.iterdir()] == ["multirun.yaml"]:  # which Hydra writes before the first job
            (folder / "multirun.yaml").unlink()
        folder.rmdir()
        if Path.cwd() in folder.resolve().parent.parents:
            folder.parent.rmdir()


def of_user(error: BaseException) -> str:
    """Return what went wrong in code of the user's, as a plant, that the package called; '' where nothing did."""
    cause: BaseException | None = error
    while cause is not None:
        frames = [(frame, Path(frame.f_code.co_filename)) for frame, _ in traceback.walk_tb(cause.__traceback__)]
        inside = next((k for k, (_, file) in enumerate(frames) if file.is_relative_to(PACKAGE)), len(frames))
        for frame, file in reversed(frames[inside:]):
            if not (OTHERS.search(str(file)) or file.is_relative_to(PACKAGE) or file.is_relative_to(SCRIPTS)):
                said = f"{type(cause).__name__}: {' '.join(str(cause).split())}".rstrip(": ")
                place = f"{frame.f_code.co_qualname} failed in {file.name}, line {frame.f_lineno}"
                return f"{place} ({said}); mend it there; DYNASINDY_TRACEBACK=1 shows the way there"
        # What has a sentence of its own is told by that.
        cause = cause.__cause__ if isinstance(cause, RuntimeError | MemoryError | InstantiationException) else None
    return ""


def in_words(error: BaseException, settings: object = None) -> str:
    """Return the innermost message of an error on one line, with what to do; '' if it is none that the user can mend.

    A key that takes its value from another one in the `settings` of the command is named as that one.
    """
    if isinstance(error, SystemExit):
        return of_user(error)
    while isinstance(error, InstantiationException) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, BrokenPipeError):
        raise error
    words = str(error).strip("'\"") if isinstance(error, KeyError) else error_text(error)
    text = " ".join(words.split()).partition(" Config search path:")[0]
    text = re.sub(r'^\[Errno -?\d+\] |(?<=in )"|"(?=, line )', "", text)  # in "my.yaml", line 2
    if place := of_user(error):
        return place
    if (wanted := memory_wanted(error)) is not None:
        said = f": {wanted} more were wanted" if wanted else f": {text}" if text and type(error) is MemoryError else ""
        lower = "replay.capacity, planning.rollouts, agent.hidden or draws, log less, or allow more (ulimit -v)"
        return f"memory ran out{said}; lower {lower}"
    if not (isinstance(error, MENDABLE) or type(error).__name__ == "Diverged"):  # whose class would import torch
        return ""
    if isinstance(error, OverrideParseException):
        return f"'{error.override}' cannot be read; write key=value, all of it in quotes: 'plant.outputs=[angle]'"
    engine = re.search(r"Could not find 'hydra/launcher/([a-z]+)", text)
    module = engine[1] if engine else str(getattr(error, "name", None)).partition(".")[0]
    optional = "\n".join(requires("dynasindy") or ()) if engine or isinstance(error, ModuleNotFoundError) else ""
    if extra := re.search(rf"^(?:hydra-)?{module}\b.*extra == .(\w+)", optional, re.M):
        instead = ", or choose hydra/launcher=basic" * bool(engine)
        return f"{module} is not installed; install it by pip install 'dynasindy[{extra[1]}]'{instead}"
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        return unknown_name(option, (choice for choice in error.options if not choice.startswith("_")), group)
    if lacking := re.search(r"Missing mandatory value: ([\w.]+)", text):  # also where another key takes it from there
        return f"{lacking[1]} is not given; give {lacking[1]}=VALUE, of which --help says more"
    if deleted := next((word for word in sys.argv[1:] if word.startswith("~")), ""):
        return f"{deleted} takes away what the command reads ({text}); leave it out, or give the key another value"
    return re.sub(r"\b[a-z_]+(?:\.[a-z_]+)+\b", lambda key: taken_from(key[0], settings) or key[0], text)


def read_words(config_name: str, words: list[str]) -> list[str]:
    """Return the settings of a command line and then its options, which Hydra reads in this order only.

    A value that Hydra cannot read is text, `run=latest` is a folder, and a setting of a plant that no file gives is
    added to those that one does.
    """
    parts = (resolve_latest(word).partition("=") for word in words if word[:1] != "-" and re.search("=|^~", word))
    settings = [f"{key}{sign}{as_text(value)}" for key, sign, value in parts]
    options = [word for word in words if word[:1] == "-" or not re.search("=|^~", word)]
    parser = get_args_parser()
    parser.usage = SUPPRESS  # all options that there are
    given, strange = parser.parse_known_args([*settings, *options])
    if strange:
        raise ValueError(f"{strange[0]} is no option; settings are written key=value, and --hydra-help lists options")
    if not given.config_path:
        settings = require_keys(given.config_name or config_name, settings)
    return [*settings, *implied(settings, given), *options]


def resolve_latest(word: str) -> str:
    """Return a word of a command line: `run=latest` is the newest run of runs/, `run=latest~1` the one before it."""
    if (asked := re.fullmatch(r"(run|resume)=latest(?:~(\d+))?", word)) is None:
        return word
    files = sorted(Path("runs").glob("**/config.yaml"), key=lambda file: file.stat().st_mtime, reverse=True)
    if not (older := files[int(asked[2] or 0) :]):
        raise ValueError(f"{word} is none of the {len(files)} runs in runs/ of this folder; give {asked[1]}=FOLDER")
    print(f"{asked[1]}={older[0].parent}", flush=True)
    return f"{asked[1]}={_quoted(older[0].parent)}"


def as_text(value: str) -> str:
    """Return a value as Hydra reads it: one that it cannot read is text, or a list of values that may be.

    The shell takes away the quotation marks of `data.time="Time [ms]"`, and a bracket within a value is none that Hydra
    knows. A bracket that is not closed is left as it is, to be refused.
    """
    with suppress(HydraException):
        PARSER.parse_override(f"key={value}")
        return value
    if value[0] == "[" and value[-1] == "]":
        items = re.split(r",(?![^\[({]*[\])}])", value[1:-1])
        return f"[{','.join(as_text(item.strip()) for item in items)}]"
    return value if value[0] in "[{('\"" else _quoted(value)


def _quoted(text: object) -> str:
    """Return what Hydra's grammar takes as text."""
    escaped = str(text).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def require_keys(config_name: str, settings: list[str]) -> list[str]:
    """Refuse a key that the config of a command does not have, and let one of a plant, or of its class, be added."""
    if not settings:
        return []
    folders, chosen, keys = [CONF, Path(config_dir() or CONF)], [], {}
    for word, override in zip(settings, PARSER.parse_overrides(settings)):
        key, glob = override.key_or_group, "=glob(" in word
        many = (override.is_choice_sweep() and not glob) or override.is_range_sweep()
        first = next(override.sweep_string_iterator(), None) if many else word.partition("=")[2].strip("'\"")
        if first is None:
            raise ValueError(f"the sweep has no job, as {word} is empty; give values, such as 'seed=range(0,5)'")
        group = key.startswith("hydra/") or any((folder / key).is_dir() for folder in folders)
        if key == "hydra.searchpath" or (group and not glob):  # of several options the first stands for all
            text = group and not first.startswith("[") and word[0] != "~"  # null is an option that there is not
            chosen.append(f"{override.get_key_element()}='{first}'" if text else word)
        elif not group and not key.startswith("hydra."):
            keys[word] = key
    groups = dict(nodes(OmegaConf.to_container(compose(config_name, chosen))))
    names = [f"{group}.{name}".lstrip(".") for group, node in groups.items() for name in node]
    added, free = [], tuple(f"{each}." for each in ("plant", "system") if each in groups)
    for word, key in keys.items():
        group, _, name = key.rpartition(".")
        if source := taken_from(group, groups[""]):
            raise ValueError(f"'{key}' follows another key; give {source}.{name} instead")
        new = key not in names and word[0] not in "+~"
        if new and not key.startswith(free):
            names.sort(key=lambda each: each.count("."))
            known = [each for each in names if not re.search(r"\[|(^|\.)_", each)]
            while group not in ("", *known):
                group = group.rpartition(".")[0]
            own = [each.rpartition(".")[2] for each in known if each.rpartition(".")[0] == group]
            raise ValueError(unknown_name(key.removeprefix(f"{group}."), own, group, known))
        added += [word] * (new or (word.startswith(free) and "={" in word and key in groups))
    return [f"++{word}" if word in added else word for word in settings]


def compose(config_name: str | None, settings: list[str]) -> DictConfig:
    """Return a config as Hydra composes it of settings, with the folder of the user's own as the command names it."""
    folder = [f"hydra.searchpath=[file://{Path(own).absolute()}]"] if (own := config_dir()) else []
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra.compose(config_name, overrides=[*folder, *settings])


def implied(settings: list[str], options: Namespace) -> list[str]:
    """Return what settings imply: the folder that Hydra is to use, and the plant of a model.

    The same sweep has the same folder, so that the same command goes on with it; a resumed run keeps its own. A model
    that is given without data and without a plant, `model=model.json`, stands in the place of a log's.
    """
    pairs = (word.partition("=")[::2] for word in settings)
    given = {key: text for key, value in pairs if (text := value.strip("'\"")) not in ("null", "")}
    found = ["system=logged"] if "model" in given and not {"data", "system", "resume"} & given.keys() else []
    if folder := given.get("resume"):
        if not (Path(folder) / "config.yaml").is_file():
            raise FileNotFoundError(f"resume={folder} is no run folder, it has no config.yaml; give a stopped run's")
        found.append(f"hydra.run.dir={_quoted(folder)}")
    elif options.multirun and "hydra.sweep.dir" not in given:
        own = [word for word in settings if not word.startswith("hydra")]
        digest = hashlib.blake2b(" ".join(own).encode(), digest_size=3).hexdigest()
        readable = re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(own)).strip("-.")
        found.append(f"hydra.sweep.dir='runs/{readable[:80]}_{digest}'")
        if sum(map(len, own)) > 200:  # disks take names of 255 letters: what all jobs share names the sweep alone
            shared = [each.key_or_group for each in PARSER.parse_overrides(own) if not each.is_sweep_override()]
            found.append(f"hydra.job.config.override_dirname.exclude_keys=[{','.join(shared)}]")
    return found


def taken_from(key: str, node: object) -> str:
    """Return the key that another one takes its value from, as `sensors.channels` does from `plant.sensors`, or ''."""
    step, _, rest = key.partition(".")
    if not isinstance(node, dict) or step not in node:
        return ""
    source = re.fullmatch(r"\$\{(?:oc\.select:)?([\w.]+)(,.*)?\}", str(node[step]))
    return f"{source[1]}.{rest}".rstrip(".") if source else taken_from(rest, node[step])


def unknown_name(name: str, names: Iterable[str], where: str, elsewhere: Iterable[str] = ()) -> str:
    """Return which names are allowed instead of one that does not exist in a group, or is a key of another one."""
    names = sorted(names)
    same = [key for key in elsewhere if key.rpartition(".")[2] == name.rpartition(".")[2]]
    meant = [repr(key) for key in same if key.count(".") == same[0].count(".")][:3]
    hint = f"; did you mean {' or '.join(meant)}?" if meant else did_you_mean(name, names)
    group, _, key = f"{where}.{name}".strip(".").partition(".")
    files = group_options(group) if key else {}  # another option of the group may have the key
    own = [option for option, file in files.items() if re.search(rf"^ *{re.escape(key)}:", file.read_text(), re.M)]
    hint = f"; {group}={' or '.join(own)} has it" if own else hint
    place = f" in '{where}'" if where else ""
    return f"'{name}' does not exist{place}; allowed are {', '.join(names) or 'none'}{hint}"


def nodes(tree: Any, key: str = "") -> Iterator[tuple[str, Mapping[Any, Any]]]:
    """Yield all groups of settings, each with its key; a group comes before those in it."""
    if isinstance(tree, Mapping):
        yield key, tree
        for name, child in tree.items():
            yield from nodes(child, f"{key}.{name}".lstrip("."))
    elif isinstance(tree, list):
        for place, child in enumerate(tree):
            yield from nodes(child, f"{key}[{place}]")
