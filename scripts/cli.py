"""The commands of `dynasindy`: which there are, their help, how their processes end, and which of them comes next.

It imports no library that takes long, so that help comes at once, and a signal that comes early is one line, too.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shlex
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryFile
from types import FrameType
from typing import Any

COMMANDS = ("train", "identify", "evaluate", "check", "export", "rig", "ablation", "table", "report")
"""Each is the script of that name, with a function `main` without arguments."""
SCRIPTS = Path(__file__).resolve().parent
CONF = SCRIPTS.parent / "conf"
IN_CLONE = (SCRIPTS.parent / "pyproject.toml").is_file()
HELP = ("-h", "--help")
WIDTH = 100
"""Columns of the help that are not those of a file."""
OF_RUN = {
    "evaluate": "flies it to steps, along sines and along squares, and draws that",
    "check": "tells its margins and worst cases, on the model",
    "export": "writes the controller as C, for a microcontroller",
}
"""What a command shows or makes of a run."""
SMOKE = ("experiment=smoke", "experiment=gradient_smoke")
"""What tries every part of a training once, and learns too little."""
IDENTIFYING = ("system", "data", "plant", "world_model", "refinement", "source", "longest_delay", "threads")
"""Words of `train` that say how a log is identified; `identify` has them too."""


def exit_now(number: int, frame: FrameType | None) -> None:
    """End at once: nothing was begun, or everything is done."""
    os.write(2, b"stopped\n")
    os._exit(128 + number)


def handle_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Let a handler hear of Ctrl-C and SIGTERM; only the main thread may say so."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)


handle_signals(exit_now)  # the imports of a script take seconds, in which a traceback would be all that a user sees


@contextmanager
def pipe_guard() -> Iterator[None]:
    """End with the exit code of a broken pipe, 141, when whoever reads stdout has left."""
    try:
        yield
    finally:
        try:
            print(end="\n" * isinstance(sys.exception(), BrokenPipeError), flush=True)  # what broke may be another pipe
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # which the interpreter flushes at its end
            sys.exit(141)


def command(config_name: str) -> Callable[[Callable[[Any], None]], Callable[[], None]]:
    """Make a function of a config, `conf/NAME.yaml`, a command, which is composed by Hydra; see `command.run`."""

    def decorate(task: Callable[[Any], None]) -> Callable[[], None]:
        @wraps(task)
        def start() -> None:
            with pipe_guard():
                if any(word in HELP for word in sys.argv[1:]):
                    print(help_page(config_name, sys.argv[1:]))
                else:
                    from command import run

                    run(config_name, task)

        return start

    return decorate


def main() -> None:
    """Run the command that the first word names, with the words after it."""
    sys.argv[0] = "dynasindy"
    name, *rest = sys.argv[1:] or ["--help"]
    if name in COMMANDS:
        sys.argv[1:] = rest
        import_module(name).main()
    elif name in HELP:
        lines = "\n".join(f"  {name:<8}  {purpose(name).partition(': `')[0]}" for name in COMMANDS)
        with pipe_guard():
            print(
                "Identify nonlinear systems and learn to control them, from little data.\n\n"
                f"dynasindy COMMAND [--help] [words of the command]\n{lines}\n\n"
                "What a command makes goes into the folder in which it is called."
            )
    elif name == "--version":
        import dynasindy

        print(dynasindy.__version__)
    else:
        from command import one_line, unknown_name

        with one_line():
            raise ValueError(unknown_name(name, COMMANDS, "dynasindy"))


def require_writable(folder: Path) -> None:
    """Make a folder, before the work that fills it, and make sure that it can be written."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=folder):  # permissions alone do not tell
        pass


def program(name: str) -> str:
    """Return how a command is called here: as its script in a clone, unless it was called otherwise."""
    installed = not IN_CLONE or Path(sys.argv[0]).name == "dynasindy"
    return f"dynasindy {name}" if installed else f"python scripts/{name}.py"


def purpose(name: str) -> str:
    """Return the docstring of a command's script, which says what it does and how it is called."""
    words = " ".join((ast.get_docstring(ast.parse((SCRIPTS / f"{name}.py").read_text())) or "").split())
    return words.replace(f"python scripts/{name}.py", program(name))


def config_dir() -> str | None:
    """Return the folder of the user's own settings, if the command line names one."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    return parser.parse_known_args()[0].config_dir


def group_options(group: str) -> dict[str, Path]:
    """Return the files of a group by their names, the user's own too; those with an underscore are parts of others."""
    folders = [CONF, Path(config_dir() or CONF)]
    return {file.stem: file for folder in folders for file in sorted((folder / group).glob("[!_]*.yaml"))}


def help_page(name: str, words: Sequence[str]) -> str:
    """Return the help of a command: what it does, and its files of conf/, whose comments say what each key means.

    Of its words, `group` asks for the options of one, `group=option` for the file of one.
    """
    groups = {place.name: group_options(place.name) for place in sorted(CONF.iterdir()) if place.is_dir()}
    asked = []
    for group, _, option in (word.partition("=") for word in words):
        files = {each: file for each, file in groups.get(group, {}).items() if option in ("", each)}
        shown = _settings if option else heading
        asked += [f"{group}={each}\n{textwrap.indent(shown(file), '    ')}" for each, file in files.items()]
    if asked:
        return "\n\n".join(asked)
    own = CONF / f"{name}.yaml"
    bases = [CONF / f"{base}.yaml" for base in re.findall(r"^  - ([a-z]\w+)$", own.read_text(), re.M)]
    files = [*bases, own]
    files += [groups[group][option] for group, option in _options(files).items() if group in ("experiment", "setting")]
    used = {group: option for group, option in _options(files).items() if group in groups}
    lines = [textwrap.fill(purpose(name), WIDTH)]
    lines += ["", f"What it is made of; `{program(name)} GROUP[=OPTION] --help` says more:"] if used else []
    for group, option in used.items():
        others = ", ".join(other for other in groups[group] if other != option)
        text = f"  {group}={option}".ljust(22) + f"  or {others}"
        lines.append(textwrap.fill(text, WIDTH, subsequent_indent=" " * 27))
    for file in files:
        lines += ["", f"Settings, from {file.relative_to(CONF.parent)}:", "", _settings(file)]
    lines += ["", f"The whole config: {program(name)} --cfg job; what Hydra can do: {program(name)} --hydra-help"]
    return "\n".join(lines)


def _options(files: Sequence[Path]) -> dict[str, str]:
    """Return which option of each group files choose, of which the last has the last word."""
    text = "\n".join(file.read_text() for file in files)
    return dict(re.findall(r"^  - (?:override )?/?(\w+): (\w+)$", text, re.M))


def _settings(file: Path) -> str:
    """Return the text of a file of conf/, without what it says to Hydra."""
    text = re.sub(r"^(# @package.*|(defaults|hydra):\n(( .*)?\n)*)", "\n", file.read_text(), flags=re.M)
    return text.strip().replace("${hydra:runtime.output_dir}", "runs/DATE_TIME")


def heading(file: Path) -> str:
    """Return the sentences at the top of a file."""
    lines = takewhile(lambda line: line.startswith("#"), file.read_text().splitlines())
    return " ".join(line.strip("# ") for line in lines if not line.startswith("# @package"))


def command_line(name: str, words: Sequence[str], comment: str = "") -> str:
    """Return a command as a shell takes it, with the folder of the user's own settings, and what comes of it."""
    folder = config_dir()
    own = ["--config-dir", folder] if folder else []
    line = " ".join([program(name), *map(shlex.quote, [*own, *words])])
    return f"{line}  # {comment}" if comment else line


def next_steps(*lines: str) -> str:
    """Return commands under their heading; nothing where there are none."""
    return "\n  ".join(["next:", *lines]) if lines else ""


def run_steps(folder: object, *names: str, plugins: Sequence[str] = ()) -> list[str]:
    """Return the commands that go on with a run, each with what comes of it; `plugins` are words for all of them."""
    return [command_line(name, [f"run={folder}", *plugins], OF_RUN[name]) for name in names]


def improvements(
    run: object, words: Sequence[str], episodes: int | None = None, checked: bool = True, imagined: float | None = None
) -> str:
    """Return what helps where the plant is not controlled: where the loop is weak, and more or better data.

    A plan from a log has no real `episodes`; `imagined` is the error at the end of imagined ones [target ranges].
    """
    from dynasindy.evaluation.tracking_criteria import WITHIN  # with TorchRL, which `identify` does without

    lines = []
    if checked:
        lines.append(command_line("check", [f"run={run}"], "tells at which targets the loop is weak, and how"))
    if episodes is not None and not any(word.startswith("resume=") for word in words):
        key, value, does = "train.episodes", max(3, 2 * episodes), "flies more episodes, whose data mend the model"
        if imagined is not None and imagined > WITHIN:  # where the model is not what fails
            key, value = "planning.updates", 3000
            does = f"plans longer: in the model, too, targets are missed by {100 * imagined:.2g} %"
        kept = without([word for word in words if word not in SMOKE], key, "folder", "finish")
        lines.append(command_line("train", [*kept, f"{key}={value}"], does))
    if episodes is None and any(word.startswith("data.path=") for word in words):
        others = without(words, *IDENTIFYING)
        lacks = "tells what the log lacks: what to record, or which functions"
        lines.append(command_line("identify", [word for word in words if word not in others], lacks))
    return next_steps(*lines)


def without(words: Sequence[str], *keys: str) -> list[str]:
    """Return the words that give no such key, nor one of such a group."""
    given = {word: word.lstrip("+~").partition("=")[0] for word in words}
    return [word for word, key in given.items() if key not in keys and re.split(r"[./]", key)[0] not in keys]
