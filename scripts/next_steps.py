"""What a command says to do next: commands that can be copied, each with what comes of it."""

import argparse
import re
import shlex
import sys
from collections.abc import Mapping, Sequence

from cli import called

from dynasindy.sentences import command_word

NEXT = {
    "evaluate": "flies it to steps, along sines and along squares, and draws that",
    "check": "tells its margins and worst cases, on the model",
    "export": "writes the controller as C, for a microcontroller",
}
"""What a command shows or makes of a run."""
SMOKE = ("experiment=smoke", "experiment=gradient_smoke")
"""What tries every part of a training once."""
OWN = ("folder", "formats", "horizons", "hydra")
"""Words of `identify` that other commands do not have."""


IDENTIFYING = ("system", "data", "plant", "world_model", "refinement", "source", "longest_delay", "threads")
"""Words of `train` that say how a log is identified; `identify` has them too."""


def listed(*lines: str) -> str:
    """Return commands, each with what comes of it, under their heading."""
    return "\n".join(["next:", *(f"  {line}" for line in lines)])


def following(folder: object, *names: str, trusting: Sequence[str] = ()) -> str:
    """Return what to do next with a run: a command a line, which can be copied, and what comes of it.

    Args:
        folder: Run folder.
        names: Commands.
        trusting: Word that names the packages of the user's own parts, for the command that builds them.
    """
    words = {"evaluate": "".join(f" {shlex.quote(word)}" for word in trusting)}
    return listed(*(f"{_of_run(name, folder)}{words.get(name, '')}  # {NEXT[name]}" for name in names))


def after_flights(folder: object, words: Sequence[str]) -> str:
    """Return what to do next with the folder of a session on a rig: look at its controller, take it away, fly again.

    Args:
        folder: Folder of the session.
        words: What the user gave.
    """
    more = _command("rig", [*_without(words, ("folder",)), f"folder={folder}"])
    own = [word for word in words if word.partition("=")[0].partition(".")[0] in ("system", "plant")]
    log = _command("identify", [*own, "data=csv", f"data.path={folder}/excitation.csv"])
    lines = (f"{_of_run(name, folder)}  # {NEXT[name]}" for name in ("check", "export"))
    return listed(
        f"{log}  # draws equations against the log",
        *lines,
        f"{more}  # learns from all logs in the folder and flies again",
    )


def mending(folder: object, words: Sequence[str], episodes: int | None = None, checked: bool = True) -> str:
    """Return what helps where the plant is not controlled: where the loop is weak, and more or better data.

    Args:
        folder: Run folder.
        words: What the user gave.
        episodes: Real episodes of the run; None of a plan from a log.
        checked: Whether there is a controller to look at.
    """
    if tried := next((word for word in words if word in SMOKE), None):
        whole = _command("train", _without(words, ("experiment", "train.episodes", "folder", "finish")))
        return listed(
            f"{whole}  # trains in earnest; {tried} only tries whether every part runs, and learns too little"
        )
    lines = [f"{_of_run('check', folder)}  # tells at which targets the loop is weak, and how"] if checked else []
    if episodes is not None and not any(word.startswith("resume=") for word in words):
        kept = _without(words, ("train.episodes", "folder", "finish"))
        more = f"{_command('train', [*kept, f'train.episodes={max(3, 2 * episodes)}'])}"
        lines.append(f"{more}  # flies more episodes, whose data mend the model")
    if episodes is None and any(word.startswith("data.path=") for word in words):
        kept = [word for word in words if re.split(r"[=./]", word.lstrip("+~"))[0] in IDENTIFYING]
        lines.append(f"{_command('identify', kept)}  # tells what the log lacks: what to record, or which functions")
    return listed(*lines) if lines else ""


def planning(words: Sequence[str], logged: bool, plant: str | None, targets: Mapping[str, Sequence[object]]) -> str:
    """Return the command that plans on what `identify` was called for, with the words that it was called with.

    Args:
        words: What the user gave.
        logged: Whether the data are a log; if not, what is said of the data is not for `train`.
        plant: The option of `system`, if a plant was named or taken.
        targets: What stands for keys of `plant` that nobody has given yet.
    """
    kept = _without(words, (*OWN, *(() if logged else ("data", "refinement", "source"))))
    if not logged and plant and not any(word.lstrip("+~").startswith("system=") for word in words):
        kept.insert(0, f"system={plant}")
    kept += [f"plant.{key}=[{','.join(map(str, values))}]" for key, values in targets.items()]
    return _command("train", kept)


def planning_on(model: object, words: Sequence[str]) -> str:
    """Return the command that goes on with a plan from a log whose equations were found, with what the user gave.

    Args:
        model: File of the equations.
        words: What the user gave.
    """
    return _command("train", [*_without(words, ("model",)), f"model={model}"])


def with_plant(words: Sequence[str], plant: str) -> str:
    """Return the command that identifies the same log with the library of a plant that is known by name."""
    return _command("identify", [f"system={plant}", *_without(words, ("folder", "hydra", "system"))])


def with_rates(words: Sequence[str], known: Mapping[str, str]) -> str:
    """Return the command that identifies the same log again, with the rates that it lacks.

    Args:
        words: What the user gave.
        known: The rate of each state, those that were given too.
    """
    return _command(
        "identify", [*_without(words, ("folder", "hydra", "plant.known")), command_word("plant.known", known)]
    )


def with_ends(words: Sequence[str], ends: Mapping[str, object]) -> str:
    """Return the command that identifies the same log again, with the ends of its actuators, which are to be corrected.

    Args:
        words: What the user gave.
        ends: Column map of the inputs with the ends as the log shows them.
    """
    kept = _without(words, ("folder", "hydra", "data.inputs"))
    asked = "are these the ends of the actuators? They are guessed from the log; put in the true ones"
    return f"{_command('identify', [*kept, command_word('data.inputs', ends)])}  # {asked}"


def _without(words: Sequence[str], keys: Sequence[str]) -> list[str]:
    """Return the words that give no such key, nor one of such a group."""
    given = {word: word.lstrip("+~").partition("=")[0] for word in words}
    return [word for word, key in given.items() if key not in keys and re.split(r"[./]", key)[0] not in keys]


def _command(name: str, words: Sequence[str]) -> str:
    """Return a command with its words as a shell takes them, and the folder of the user's own settings."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    folder = parser.parse_known_args(sys.argv[1:])[0].config_dir
    own = ["--config-dir", folder] if folder else []
    return " ".join([called(name), *map(shlex.quote, [*own, *words])])


def _of_run(name: str, folder: object) -> str:
    return f"{called(name)} {shlex.quote(f'run={folder}')}"
