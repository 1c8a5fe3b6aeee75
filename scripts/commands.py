"""The commands of `dynasindy`: which there are, how they are called, and the one that a command line names."""

import ast
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

# First, since the other imports take a moment.
from stopping import listen, stop  # isort: split

from reader import while_read

import dynasindy
from dynasindy.text import did_you_mean

COMMANDS = (
    "train",
    "identify",
    "evaluate",
    "check",
    "export",
    "rig",
    "ablation",
    "table",
    "report",
)
"""Each is the script of that name, with a function `main` without arguments."""
SCRIPTS = Path(__file__).resolve().parent
IN_CLONE = (SCRIPTS.parent / "pyproject.toml").is_file()
HELP, COMPLETION = ("-h", "--help"), ("-sc", "--shell-completion")


def called(name: str) -> str:
    """Return how a command is called here: as its script in a clone, unless it was called otherwise."""
    installed = not IN_CLONE or Path(sys.argv[0]).name == "dynasindy"
    return f"dynasindy {name}" if installed else f"python scripts/{name}.py"


def purpose(name: str) -> str:
    """Return the docstring of a command's script, which says what it does and how it is called."""
    words = " ".join((ast.get_docstring(ast.parse((SCRIPTS / f"{name}.py").read_text())) or "").split())
    return words.replace(f"python scripts/{name}.py", called(name))


def asks(words: Sequence[str]) -> bool:
    """Return whether a command line asks for help."""
    return any(word in HELP for word in words)


def completes(words: Sequence[str]) -> bool:
    """Return whether a shell asks how a command line goes on."""
    return any(word in COMPLETION for word in words) and any(word.startswith("query=") for word in words)


def main() -> None:
    """Run the command that the first word names, with the words after it."""
    listen(stop)
    sys.argv[0] = "dynasindy"
    words = _answer_about_command(sys.argv[1:])
    with while_read():
        if not words or words[0] in HELP:
            print(page())
            return
        if words[0] == "--version":
            print(dynasindy.__version__)
            return
    name, *rest = words
    if name not in COMMANDS:
        hint = did_you_mean(name, COMMANDS)
        print(f"error: '{name}' is no command; there are {', '.join(COMMANDS)}{hint}", file=sys.stderr)
        sys.exit(2)
    sys.argv[1:] = rest
    import_module(name).main()


def page() -> str:
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


def _answer_about_command(words: list[str]) -> list[str]:
    """Return the words that answer a shell's question of how a line goes on; those of other lines as they are.

    A shell asks `dynasindy -sc query=bash`, and the line stands in COMP_LINE. Hydra knows what a command takes, and is
    asked as if the command were a program of its own. What the commands are it does not know.
    """
    if not words or words[0] not in COMPLETION:
        return words
    line = os.environ.get("COMP_LINE", "").lstrip()
    typed = line.split()
    if not completes(words) or not typed:
        return [COMMANDS[0], *words]  # what a shell has to know of any of them
    before = max(1, len(typed) - (not line.endswith(" ")))
    if before == 1:
        started = typed[1] if len(typed) > 1 else ""
        print(*(name for name in COMMANDS if name.startswith(started)))
        sys.exit(0)
    name, *rest = line.split(maxsplit=2)[1:]
    if not (SCRIPTS.parent / "conf" / f"{name}.yaml").is_file():
        sys.exit(0)  # the shell goes on with names of files
    os.environ["COMP_LINE"] = " ".join(["dynasindy", *rest]) if rest else "dynasindy "
    return [name, *words]
