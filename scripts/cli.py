"""The commands of `dynasindy`: which there are, what `--help` says of them, and how their processes end.

It imports no library that takes long, so that help comes at once, and a signal that comes early is one line, too.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import select
import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from io import UnsupportedOperation
from pathlib import Path
from tempfile import TemporaryFile
from types import FrameType
from typing import Any

COMMANDS = ("train", "identify", "evaluate", "check", "export", "rig", "ablation", "table", "report")
"""Each is the script of that name, with a function `main` without arguments."""
SCRIPTS = Path(__file__).resolve().parent
CONF = SCRIPTS.parent / "conf"
IN_CLONE = (SCRIPTS.parent / "pyproject.toml").is_file()
HELP, COMPLETION = ("-h", "--help"), ("-sc", "--shell-completion")
WIDEST = 110
"""Columns that a line of help takes at most, also where the terminal is wider."""


def exit_at_once(number: int, frame: FrameType | None) -> None:
    """End at once: nothing was begun, or everything is done."""
    os.write(2, b"stopped\n")
    os._exit(128 + number)


def stop(number: int, frame: FrameType | None) -> None:
    """Leave what is under way; a second signal leaves at once."""
    from dynasindy.dyna import Stopped

    handle_signals(exit_at_once)
    raise Stopped("stopped", number)


def handle_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Let a handler hear of Ctrl-C and SIGTERM; only the main thread may say so."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)


handle_signals(exit_at_once)  # the imports of a script take seconds, in which a traceback would be all that a user sees


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


@contextmanager
def pipe_guard() -> Iterator[None]:
    """End with the exit code of a broken pipe, 141, when whoever reads stdout has left; other errors stay theirs."""
    end: SystemExit | BrokenPipeError | None = None
    try:
        yield
    except (SystemExit, BrokenPipeError) as error:
        end = error
    if not getattr(end, "code", None) and _reader_left():
        sys.exit(141)
    if end is not None:  # also where another pipe broke, as that of a worker that died
        raise end


def _reader_left() -> bool:
    """Write what is left of the output; return whether nobody reads it, and then let it go nowhere."""
    try:
        sys.stdout.flush()
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        left = any(event & select.POLLERR for _, event in poll.poll(0))
    except BrokenPipeError:
        left = True
    except (UnsupportedOperation, AttributeError):  # no file, as under pytest; no poll, as on Windows
        return False
    if left:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what the interpreter flushes at its end
    return left


def command(config_name: str, progress: bool = True) -> Callable[[Callable[[Any], float | None]], Callable[[], None]]:
    """Make a function of a config a command, which is composed by Hydra; see `command.run`.

    Args:
        config_name: File `conf/NAME.yaml`.
        progress: Whether what is under way is shown; a thread that draws would disturb one that keeps a clock.
    """

    def decorate(task: Callable[[Any], float | None]) -> Callable[[], None]:
        @wraps(task)
        def start() -> None:
            with pipe_guard():
                if any(word in HELP for word in sys.argv[1:]):
                    print(help_page(config_name, sys.argv[1:]))
                else:
                    from command import run

                    run(config_name, task, progress)

        return start

    return decorate


def main() -> None:
    """Run the command that the first word names, with the words after it."""
    sys.argv[0] = "dynasindy"
    name, *rest = _answer_shell(sys.argv[1:]) or ["--help"]
    if name in HELP or name == "--version":
        import dynasindy

        with pipe_guard():
            print(overview() if name in HELP else dynasindy.__version__)
    elif name in COMMANDS:
        sys.argv[1:] = rest
        import_module(name).main()
    else:
        from dynasindy.text import did_you_mean

        refuse(f"'{name}' is no command; there are {', '.join(COMMANDS)}{did_you_mean(name, COMMANDS)}")


def require_writable(folder: Path) -> None:
    """Make a folder, before the work that fills it, and make sure that it can be written.

    Raises:
        OSError: It cannot.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=folder):  # permissions alone do not tell
        pass


def refuse(line: str) -> None:
    """End with a line and the exit code of a bad setting."""
    from dynasindy.progress import fit_stderr

    print(fit_stderr(f"error: {line}"), file=sys.stderr)
    sys.exit(2)


def program(name: str) -> str:
    """Return how a command is called here: as its script in a clone, unless it was called otherwise."""
    installed = not IN_CLONE or Path(sys.argv[0]).name == "dynasindy"
    return f"dynasindy {name}" if installed else f"python scripts/{name}.py"


def purpose(name: str) -> str:
    """Return the docstring of a command's script, which says what it does and how it is called."""
    words = " ".join((ast.get_docstring(ast.parse((SCRIPTS / f"{name}.py").read_text())) or "").split())
    return words.replace(f"python scripts/{name}.py", program(name))


def overview() -> str:
    """Return what there is to be called."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {purpose(name).partition(': `')[0]}" for name in COMMANDS]
    return "\n".join(
        [
            "Identify nonlinear systems and learn to control them, from little data.",
            "",
            "dynasindy COMMAND [--help] [words of the command]",
            *lines,
            "",
            "What a command makes goes into the folder in which it is called.",
            "Tab completion in bash, in other shells as Hydra has it:",
            '  eval "$(dynasindy -sc install=bash)"',
        ]
    )


def _answer_shell(words: list[str]) -> list[str]:
    """Return the words that answer a shell's question of how a line goes on; those of other lines as they are.

    A shell asks `dynasindy -sc query=bash`, and the line stands in COMP_LINE. Hydra knows what a command takes, and is
    asked as if the command were a program of its own. What the commands are it does not know.
    """
    if not words or words[0] not in COMPLETION:
        return words
    line = os.environ.get("COMP_LINE", "").lstrip()
    typed = line.split()
    if not any(word.startswith("query=") for word in words) or not typed:
        return [COMMANDS[0], *words]  # what a shell has to know of any of them
    if len(typed) - (not line.endswith(" ")) <= 1:
        print(*(name for name in COMMANDS if name.startswith("".join(typed[1:]))))
        sys.exit(0)
    name, *rest = line.split(maxsplit=2)[1:]
    if not (CONF / f"{name}.yaml").is_file():
        sys.exit(0)  # the shell goes on with names of files
    os.environ["COMP_LINE"] = " ".join(["dynasindy", *rest]) if rest else "dynasindy "
    return [name, *words]


def config_dir(words: Sequence[str]) -> str | None:
    """Return the folder of the user's own settings, if a command line names one."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    return parser.parse_known_args(words)[0].config_dir


def group_options(group: str, words: Sequence[str] | None = None) -> dict[str, Path]:
    """Return the files of a group by their names, the user's own too; those with an underscore are parts of others."""
    own = config_dir(sys.argv[1:] if words is None else words)
    folders = [CONF, Path(own)] if own else [CONF]
    return {file.stem: file for folder in folders for file in sorted((folder / group).glob("[!_]*.yaml"))}


@cache
def plant_settings() -> frozenset[str]:
    """Return the settings of a plant: those that conf/ reads, beside those that code reads by their names."""
    texts = [file.read_text() for file in CONF.rglob("*.yaml")]
    return frozenset(["functions", "libraries", *re.findall(r"\bplant\.([a-z]+)", " ".join(texts))])


def help_page(name: str, words: Sequence[str]) -> str:
    """Return the help of a command, from the comments of `conf/NAME.yaml`; an option of a group shows in its values.

    Args:
        name: Command.
        words: The other words of the command line. `group` asks for its options, `group=option` for the keys of one.
    """
    groups = {place.name: group_options(place.name, words) for place in sorted(CONF.iterdir()) if place.is_dir()}
    lines: list[str] = []
    for group, _, option in (word.partition("=") for word in words):
        for each, file in groups.get(group, {}).items():
            if option in ("", each):
                lines += [f"{group}={each}", *_wrapped(heading(file), "    "), ""]
                lines += _setting_lines(_settings(file)) if option else []
    if lines:
        return "\n".join(lines).rstrip()
    file = CONF / f"{name}.yaml"
    chosen, settings = _defaults(file), _settings(file)
    for group, option in list(chosen.items()):
        other = groups.get(group, {}).get(option)
        if other is not None and _is_global(other):
            chosen |= _defaults(other)
            changed = _settings(other)
            settings |= {key: (changed[key][0], comment) for key, (_, comment) in settings.items() if key in changed}
    lines = [*_wrapped(purpose(name)), "", *_wrapped(heading(file))]
    if chosen := {group: option for group, option in chosen.items() if group in groups}:
        lines += ["", f"What it is made of; `{program(name)} GROUP --help` says what the options are:"]
        for group, option in chosen.items():
            others = ", ".join(other for other in groups[group] if other != option)
            text = f"{group}={option}".ljust(20) + f"  or {others}"
            lines += textwrap.wrap(text, _width(), initial_indent="  ", subsequent_indent=" " * 27)
    lines += ["", "Settings:", *_setting_lines(settings), ""]
    if chosen:
        lines.append("Settings of an option:       {} {}={} --help".format(program(name), *next(iter(chosen.items()))))
    lines.append(f"The whole config:            {program(name)} --cfg job")
    if name in ("train", "ablation"):
        lines.append(f"A sweep:                     {program(name)} -m seed=0,1,2 [hydra/launcher=joblib]")
    return "\n".join([*lines, f"What Hydra itself can do:    {program(name)} --hydra-help"])


def _is_global(file: Path) -> bool:
    return file.parent == CONF or file.read_text().startswith("# @package _global_")


def _defaults(file: Path) -> dict[str, str]:
    """Return which option of each group a file chooses; those of the files that it begins with first."""
    import yaml

    chosen: dict[str, str] = {}
    for entry in (yaml.safe_load(file.read_text()) or {}).get("defaults", ()):
        if isinstance(entry, dict):
            chosen |= {key.removeprefix("override ").lstrip("/"): str(option) for key, option in entry.items()}
        elif entry != "_self_" and "@" not in entry and (file.parent / f"{entry}.yaml").is_file():
            chosen |= _defaults(file.parent / f"{entry}.yaml")
    return {group: option.replace("None", "null") for group, option in chosen.items()}


def _settings(file: Path) -> dict[str, tuple[str, str]]:
    """Return the keys of a file, each as a command line has it, with its value and the sentences above it.

    What is said above several keys is said of the first, and so is what is said above a group.
    """
    import yaml

    found: dict[str, tuple[str, str]] = {}
    for entry in (yaml.safe_load(file.read_text()) or {}).get("defaults", ()):
        if isinstance(entry, str) and (base := file.parent / f"{entry}.yaml").is_file():
            found |= _settings(base)
    prefix, above, parts = "" if _is_global(file) else f"{file.parent.name}.", "", "-"
    for name, value, comment in entries(file):
        if re.match(r"(defaults|hydra)\b|(.*\.)?_", name) or name.startswith(parts):
            continue
        said = f"{above} {comment}".strip()
        above = said if value is None else ""
        parts = f"{name}." if value == "" else "-"  # of a list, which a command line gives as a whole
        if value is not None:
            written = value.replace("${hydra:runtime.output_dir}", "runs/DATE_TIME")
            shown = written if written and "\n" not in written else "[...]"
            found[prefix + name] = (shown, said or found.get(prefix + name, ("", ""))[1])
    return found


def entries(file: Path) -> Iterator[tuple[str, str | None, str]]:
    """Yield the keys of a file as a command line has them, each with its value as it is written and what is said above.

    The value of a group, whose keys follow, is None, that of a list whose parts stand below it empty.
    """
    import yaml

    text = file.read_text()
    lines = text.splitlines()

    def walk(node: yaml.Node | None, prefix: str) -> Iterator[tuple[str, str | None, str]]:
        if isinstance(node, yaml.SequenceNode):
            for part in node.value:
                yield from () if getattr(part, "flow_style", True) else walk(part, prefix)
        for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
            below = isinstance(value, yaml.CollectionNode) and bool(value.value) and not value.flow_style
            written = "" if below else text[value.start_mark.index : value.end_mark.index].rstrip()
            group = below and isinstance(value, yaml.MappingNode)
            start = end = key.start_mark.line
            while start and lines[start - 1].lstrip().startswith("#"):
                start -= 1
            # A comment that begins at the top of the file is the file's own.
            yield f"{prefix}{key.value}", None if group else written, _joined(lines[start:end]) if start else ""
            if below:
                yield from walk(value, f"{prefix}{key.value}.")

    yield from walk(yaml.compose(text, Loader=yaml.SafeLoader), "")


def heading(file: Path) -> str:
    """Return the sentences at the top of a file."""
    lines = file.read_text().splitlines()
    end = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return _joined(line for line in lines[:end] if not line.startswith("# @package"))


def _setting_lines(settings: dict[str, tuple[str, str]]) -> list[str]:
    """Return each setting, and what is said of it below."""
    pairs = settings.items()
    return [line for key, (value, said) in pairs for line in (f"  {key}={value}", *_wrapped(said, "      "))]


def _joined(comment: Iterable[str]) -> str:
    return " ".join(" ".join(line.strip().lstrip("#") for line in comment).split())


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, _width(), initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _width() -> int:
    return min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST)
