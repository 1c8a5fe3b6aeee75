"""The commands of `dynasindy`: which there are, their help, how their processes end, and which of them comes next.

It imports no library that takes long, so that help comes at once, and a signal that comes early is one line, too.
"""

import argparse
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
from typing import Any

COMMANDS = ("train", "identify", "evaluate", "check", "export", "rig", "ablation", "table", "report")
"""Each is the script of that name, with a function `main` without arguments."""
CONF = Path(__file__).resolve().parents[1] / "conf"
IN_CLONE = CONF.with_name("pyproject.toml").is_file()
HELP = ("-h", "--help")
OF_RUN = {
    "evaluate": "flies it to steps, along sines and along squares, and draws that",
    "check": "tells its margins and worst cases, on the model",
    "export": "writes the controller as C, for a microcontroller",
}
"""What a command shows or makes of a run."""


def exit_now(number: int, frame: object) -> None:
    """End at once: nothing was begun, or everything is done."""
    os.write(2, b"stopped\n")
    os._exit(128 + number)


def handle_signals(handler: Callable[[int, Any], None]) -> None:
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
    TemporaryFile(dir=folder).close()  # permissions alone do not tell


def program(name: str) -> str:
    """Return how a command is called from here: as its script in a clone, unless it was called otherwise."""
    if not IN_CLONE or Path(sys.argv[0]).name == "dynasindy":
        return f"dynasindy {name}"
    script = Path("scripts", f"{name}.py")
    return f"python {script if script.is_file() else shlex.quote(str(CONF.with_name('scripts') / script.name))}"


def purpose(name: str) -> str:
    """Return the docstring of a command's script, which says what it does and how it is called."""
    return str(import_module(name).__doc__).replace(f"python scripts/{name}.py", program(name))


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
    bases = re.findall(r"^  - ([a-z]\w+)$", (CONF / f"{name}.yaml").read_text(), re.M)
    files = [CONF / f"{each}.yaml" for each in (*bases, name)]
    files += [groups[group][option] for group, option in _options(files).items() if group in ("experiment", "setting")]
    used = {group: option for group, option in _options(files).items() if group in groups}
    lines = [textwrap.fill(purpose(name), 100)]
    lines += ["", f"What it is made of; `{program(name)} GROUP[=OPTION] --help` says more:"] if used else []
    for group, option in used.items():
        others = ", ".join(other for other in groups[group] if other != option)
        text = f"  {group}={option}".ljust(22) + f"  or {others}"
        lines.append(textwrap.fill(text, 100, subsequent_indent=" " * 27))
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
    own = ["--config-dir", folder] if (folder := config_dir()) else []
    line = " ".join([program(name), *map(shlex.quote, [*own, *words])])
    added = str(Path(__file__).resolve().parent)  # which a command adds for its workers
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path not in ("", added)]
    if paths and any(word.startswith("plugins=") for word in words):
        line = f"PYTHONPATH={shlex.quote(os.pathsep.join(paths))} {line}"
    return f"{line}  # {comment}" if comment else line


def next_steps(*lines: str) -> str:
    """Return commands under their heading; nothing where there are none."""
    return "\n  ".join(["next:", *lines]) if lines else ""


def run_steps(folder: object, *names: str, plugins: Sequence[str] = ()) -> list[str]:
    """Return the commands that go on with a run, each with what comes of it; `plugins` are words for all of them."""
    return [command_line(name, [f"run={folder}", *plugins], OF_RUN[name]) for name in names]


def without(words: Sequence[str], *keys: str) -> list[str]:
    """Return the words that give no such key, nor one of such a group."""
    given = {word: word.lstrip("+~").partition("=")[0] for word in words}
    return [word for word, key in given.items() if key not in keys and re.split(r"[./]", key)[0] not in keys]
