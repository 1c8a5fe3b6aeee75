"""What a command says to do next: commands that can be copied, each with what comes of it."""

import re
import shlex
from collections.abc import Sequence

from cli import config_dir, program

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
