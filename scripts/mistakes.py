"""A user's mistake in one line: what was given, what is allowed, what to do."""

import argparse
import errno
import os
import re
import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path

os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us instead of Hydra's printer

import hydra
import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dynasindy.limits import is_memory_error, memory_wanted

CONF = Path(__file__).resolve().parents[1] / "conf"
MENDABLE = (
    yaml.YAMLError,
    ValueError,
    TypeError,
    KeyError,
    OSError,
    ModuleNotFoundError,
    HydraException,
    OmegaConfBaseException,
)
EXTRAS = {
    "joblib": "sweep",
    "submitit": "slurm",
    "ray": "ray",
    "optuna": "tune",
    "casadi": "export",
    "control": "export",
    "onnx": "export",
    "tensorboard": "tensorboard",
}
"""Optional packages by the first word of a launcher, sweeper or module, and the extra of ours that installs them."""
MISSPELT = r"(Could not override|An item is already at) '([^']+)'"
"""What Hydra says of a key that is misspelt, or given with a + and there."""
MEANINGS = (
    {"lr", "actor_lr", "critic_lr", "learning_rate", "learningrate", "step_size"},
    {"episodes", "n_episodes", "num_episodes", "epochs"},
    {"seed", "random_seed", "random_state", "rng"},
    {"updates", "updates_per_step", "iterations", "n_iter", "gradient_steps", "utd_ratio"},
    {"dt", "sample_time", "sampling_time", "time_step", "timestep", "control_period", "period"},
    {"max_steps", "episode_length", "max_episode_steps"},
    {"gamma", "discount", "discount_factor"},
    {"tau", "polyak"},
    {"hidden", "hidden_sizes", "hidden_layers", "layers", "net_arch"},
    {"batch_size", "batch", "minibatch_size"},
    {"capacity", "buffer_size", "replay_size"},
    {"horizon", "window", "lookahead", "rollout_length"},
    {"duration", "length", "excitation_length"},
    {"threads", "n_jobs", "jobs", "workers", "num_workers", "cores"},
    {"folder", "output_dir", "out", "output", "dir"},
    {"device", "gpu", "cuda"},
    {"low", "lower", "min"},
    {"high", "upper", "max"},
    {"threshold", "sparsity"},
    {"max_grad_norm", "clip", "grad_clip", "gradient_clip"},
    {"parameters", "uncertainty"},
    {"outputs", "targets", "controlled"},
    {"path", "file", "csv", "log"},
)
"""Names of settings that mean the same, in other tools or in ours."""
LOWERED = {
    "train": "replay.capacity, planning.rollouts, planning.horizon or agent.hidden, or give shorter logs",
    "identify": "excitation.duration, or the terms of the library, or give a shorter log or a larger data.dt",
    "check": "grid, draws, points or seconds",
    "evaluate": "the number of scenarios, or their episodes",
    "export": "the number of formats",
    "report": "the number of saved runs and formats",
    "rig": "excitation.duration or seconds, or what planner gives for rollouts",
}
"""What takes less memory, by the command; a sweep's jobs are those of train."""
HINTS = 3
"""Settings that are offered at most in the place of one that does not exist."""
SWEEPING = ("train", "ablation")
"""Commands of which a sweep makes several jobs."""
CAUSES = {
    errno.ENOSPC: "the disk is full: free some of it, or choose a folder on another",
    errno.EDQUOT: "your quota of the disk is used up: free some of it, or choose a folder on another",
    errno.EROFS: "the disk is read-only: choose another folder",
    errno.EACCES: "permission is denied: choose a folder or file that you may read and write",
    errno.EPERM: "permission is denied: choose a folder or file that you may read and write",
    errno.EISDIR: "it is a folder: give a file",
    errno.ENOTDIR: "part of it is a file: give the path of a folder",
    errno.EEXIST: "a file is in the way: choose another name, or move that file",
    errno.ENOENT: "it does not exist: correct the path",
    errno.ENAMETOOLONG: "the name is too long: shorten it",
    errno.EFBIG: "the file would be larger than the system or your limit allows (ulimit -f): choose another folder",
}


def in_words(error: BaseException, config_name: str, settings: object = None) -> str:
    """Return the innermost message of an error on one line, with what is allowed where it names a key.

    Args:
        error: The error.
        config_name: The command.
        settings: Its settings as they were given, which say of a key that takes its value from another from which one;
            the message then names that one, where the value was given.

    Raises:
        BrokenPipeError: The error is that, which is nobody's mistake.
    """
    part = ""
    while isinstance(error, InstantiationException) and error.__cause__ is not None:
        part = str(error).rpartition("full_key: ")[2].strip()
        error = error.__cause__
    if isinstance(error, BrokenPipeError):
        raise error
    if is_memory_error(error):
        return _exhausted(error, config_name)
    if isinstance(error, OSError) and error.errno is not None:
        cause = CAUSES.get(error.errno, error.strerror or "it cannot be read or written")
        if error.filename is None and error.errno not in CAUSES and error.strerror:
            return cause  # of a connection, which is no file
        return f"{'a file' if error.filename is None else error.filename}: {cause}"
    if isinstance(error, yaml.MarkedYAMLError) and (mark := error.problem_mark) is not None:
        where = f"{mark.name}, line {mark.line + 1}"
        return f"{where}: {error.problem}; mend the file, in which blanks tell what belongs where"
    if isinstance(error, OverrideParseException):
        return (
            f"'{error.override}' cannot be read; write key=value, close all brackets and quotes, and put a word with "
            "brackets, quotes, commas or blanks between quotes of the shell, such as 'plant.outputs=[angle]'"
        )
    if missing := _missing_package(error):
        return missing
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        choices = {choice for choice in error.options if not choice.startswith("_")}  # the others are parts of them
        return unknown(option, choices, group)
    if part and not isinstance(error, ValueError):
        return f"{part} got a setting of the wrong type or name ({' '.join(str(error).split())}); compare it with conf/"
    words = str(error).strip("'\"") if isinstance(error, KeyError) else str(error)
    text = " ".join(words.split()).partition(" Config search path:")[0]
    if merged := re.match(r"Error merging override (.+)", text):
        return (
            f"'{merged[1]}' gives a group of keys where one value is wanted, or one value where a group of keys "
            "stands; give it in a file of its own, as conf/ has it"
        )
    if text.startswith("Config group override must be") and (chosen := _no_choice()):
        return chosen
    several = re.match(r"Ambiguous value for argument '(.+?)' 1\. ", text)
    misspelt = re.search(MISSPELT, text)
    # Hydra says first that there are several values, which is no mistake in a command that sweeps.
    if (several or misspelt) and (wrong := _wrong_word(config_name)):
        return wrong
    if several:
        key, _, value = several[1].partition("=")
        more = "add -m for a job with each of them" if config_name in SWEEPING else "give one of them"
        return f"{several[1]} gives several values; {more}, or write '{key}=[{value}]' for a list"
    if text == "No trials are completed yet.":  # Optuna's
        return "no trial came to an end, so none of them is the best; error.txt in the folder of each says why"
    # Where the key itself exists, what it holds cannot be extended.
    whole = "; replace the whole of a group's keys in a file of its own, as conf/ has them"
    return as_given(text, settings) + whole * bool(misspelt and misspelt[1] == "Could not override")


def mendable(error: BaseException) -> bool:
    """Tell whether the user can mend an error, and so is told in a line, without a traceback."""
    return isinstance(error, MENDABLE) or is_memory_error(error)


def _exhausted(error: BaseException, config_name: str) -> str:
    """Return that memory ran out, and how to go on."""
    wanted = memory_wanted(error)
    words = wanted and f"{wanted} more were wanted"
    if str(error) and type(error) is MemoryError and not words:  # of a run, which says where it was
        words = " ".join(str(error).split())
    larger = "end what else takes memory, or allow this command more (ulimit -v)"
    return f"memory ran out{words and f': {words}'}; lower {LOWERED.get(config_name, LOWERED['train'])}; or {larger}"


def _no_choice() -> str:
    """Return what may be chosen in the group of a word that chooses no file, as `sensors=null`; '' if there is none."""
    for group, sign, option in (word.partition("=") for word in sys.argv[1:] if not word.startswith("-")):
        choices = {file.stem for file in (CONF / group).glob("[!_]*.yaml")} if sign else set()
        if choices and not isinstance(yaml.safe_load(option), str):  # a name may be that of a file of the user
            return unknown(option, choices, group)
    return ""


def as_given(text: str, settings: object) -> str:
    """Return a text whose keys that take their values from others are those: `task.outputs` is `plant.outputs`."""
    return re.sub(r"\b[a-z_]+(?:\.[a-z_]+)+\b", lambda key: _taken_from(key[0], settings) or key[0], text)


def _missing_package(error: BaseException) -> str:
    """Return how to install what an error misses, nothing if it misses no optional package."""
    engine = re.search(r"Could not find '(hydra/(?:launcher|sweeper))/((\w+?)(_\w+)?)'", str(error))
    name = engine[3] if engine else str(getattr(error, "name", None)).partition(".")[0]
    if name not in EXTRAS:
        return ""
    wanted = f"{engine[1]}={engine[2]}" if engine else f"what was asked for needs {name}, which"
    instead = f", or choose {engine[1]}=basic" if engine else ""
    return f"{wanted} is not installed; install it by pip install 'dynasindy[{EXTRAS[name]}]'{instead}"


def _wrong_word(config_name: str) -> str:
    """Return what is wrong with the words of the command, '' if nothing is found.

    Of a word that gives several values the first is looked at. Of several keys that are misspelt the first is told.
    """
    words, first = _first_values(sys.argv[1:]), ""
    while True:
        GlobalHydra.instance().clear()
        try:
            with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
                node = hydra.compose(config_name, overrides=words)
        except MENDABLE as error:
            if not (misspelt := re.search(MISSPELT, str(error))):
                return "" if first else in_words(error, config_name)
            others = [word for word in words if not word.lstrip("+~").startswith(f"{misspelt[2]}=")]
            if others == words:
                return ""
            words, first = others, first or misspelt[2]
        else:
            return _allowed_keys(first, node) if first else ""


def _first_values(arguments: Sequence[str]) -> list[str]:
    """Return the settings among the arguments of a command, each with the first of its values."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    own, rest = parser.parse_known_args(arguments)
    found = [f"hydra.searchpath=[file://{Path(own.config_dir).absolute()}]"] if own.config_dir else []
    for word in rest:
        if word.startswith("-") or not ("=" in word or word.startswith("~")):
            continue
        override = OverridesParser.create().parse_override(word)
        if not override.is_sweep_override():
            found.append(word)
        elif override.is_choice_sweep() or override.is_range_sweep():  # others have no first value
            found.append(f"{override.get_key_element()}={next(override.sweep_string_iterator())}")
    return found


def _allowed_keys(key: str, node: DictConfig) -> str:
    """Return which keys stand where a misspelt one was given, '' if it exists."""
    if source := _taken_from(key, OmegaConf.to_container(node)):
        return f"'{key}' follows another key; give {source} instead"
    given, parent = key.split("."), []
    elsewhere = _keys(OmegaConf.to_container(node))
    for step in given[:-1]:
        if not (step in node and OmegaConf.is_dict(node[step])):
            break
        node = node[step]
        parent.append(step)
    name = ".".join(given[len(parent) :])
    names = sorted(str(k) for k in node if not str(k).startswith("_"))
    return "" if name in names else unknown(name, names, ".".join(parent), elsewhere)


def _taken_from(key: str, node: object) -> str:
    """Return the key that another one takes its value from, as `sensors.channels` does from `plant.sensors`, or ''."""
    steps = key.split(".")
    for place, step in enumerate(steps):
        if not isinstance(node, dict) or step not in node:
            return ""
        node = node[step]
        if isinstance(node, str) and (source := re.fullmatch(r"\$\{(?:oc\.select:)?([\w.]+)(,.*)?\}", node)):
            return ".".join([source[1], *steps[place + 1 :]])
    return ""


def _keys(node: object, parent: str = "") -> list[str]:
    """Return all keys of a config with the groups that they stand in, the shallowest first."""
    if not isinstance(node, dict):
        return []
    own = {f"{parent}{step}": child for step, child in node.items() if not str(step).startswith("_")}
    deeper = [key for step, child in own.items() for key in _keys(child, f"{step}.")]
    return sorted([*own, *deeper], key=lambda key: key.count("."))


def meant(name: str, names: Iterable[str], elsewhere: Iterable[str] = ()) -> list[str]:
    """Return what may be meant by a name that does not exist: what is written or means alike, or stands elsewhere.

    Args:
        name: The name, the last word of which counts.
        names: Those that exist in its place.
        elsewhere: All keys that exist, with their groups.
    """
    word = name.rpartition(".")[2].lower()
    alike = set().union({word}, *(words for words in MEANINGS if word in words))
    known = [*elsewhere]
    same = [key for key in known if key.rpartition(".")[2] == word]
    if found := [other for other in names if other in alike] or (not same and get_close_matches(name, names, 1)):
        return found[:HINTS]
    places = same or [key for key in known if key.rpartition(".")[2] in alike]
    return [key for key in places if key.count(".") == places[0].count(".")][:HINTS]


def unknown(name: str, names: Iterable[str], where: str, elsewhere: Iterable[str] = ()) -> str:
    """Return which names are allowed instead of one that does not exist in a group.

    Args:
        name: The one that does not exist.
        names: Those that are allowed.
        where: The group.
        elsewhere: All keys that exist, with their groups.
    """
    names = sorted(names)
    guess = " or ".join(f"'{each}'" for each in meant(name, names, elsewhere))
    hint = f"; did you mean {guess}?" if guess else ""
    place = f" in '{where}'" if where else ""
    return f"'{name}' does not exist{place}; allowed are {', '.join(names)}{hint}"
