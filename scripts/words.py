"""The words of a command line as Hydra is to read them: none is misspelt, and what they imply stands among them."""

import hashlib
import re
from argparse import Namespace
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import hydra
from cli import CONF, config_dir, group_options
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from trust import nodes

from dynasindy.text import did_you_mean


def read_words(config_name: str, words: list[str]) -> list[str]:
    """Return the settings of a command line and then its options, which Hydra reads in this order only.

    A value that Hydra cannot read is text, `run=latest` is a folder, and a setting of a plant that no file gives is
    added to those that one does.
    """
    settings = [as_text(resolve_latest(word)) for word in words if word[:1] != "-" and re.search("=|^~", word)]
    options = [word for word in words if word[:1] == "-" or not re.search("=|^~", word)]
    parser = get_args_parser()  # which would print all options that there are
    parser.error = _refuse_option  # type: ignore[method-assign]
    given = parser.parse_args([*settings, *options])
    if not given.config_path:
        settings = require_keys(given.config_name or config_name, settings)
    return [*settings, *implied(settings, given), *options]


def _refuse_option(said: str) -> NoReturn:
    raise ValueError(f"{said}; settings are written key=value, and --hydra-help lists the options")


def resolve_latest(word: str) -> str:
    """Return a word of a command line: `run=latest` is the newest run of runs/, `run=latest~1` the one before it."""
    asked = re.fullmatch(r"(run|resume)=latest(?:~(\d+))?", word)
    if asked is None:
        return word
    files = sorted(Path("runs").glob("**/config.yaml"), key=lambda file: file.stat().st_mtime, reverse=True)
    place = int(asked[2] or 0)
    if place >= len(files):
        raise ValueError(f"{word} is none of the {len(files)} runs in runs/ of this folder; give {asked[1]}=FOLDER")
    print(f"{asked[1]}={files[place].parent}", flush=True)
    return f"{asked[1]}={_quoted(files[place].parent)}"


def as_text(word: str) -> str:
    """Return a word of a command line as Hydra reads it: a value or an item of a list that it cannot read is text.

    The shell takes away the quotation marks of `data.time="Time [ms]"`, and a bracket within a value is none that Hydra
    knows. A bracket that is not closed is left as it is, to be refused.
    """
    key, _, value = word.partition("=")
    if not value or _parses(word):
        return word
    made = word if value[0] in "[{('\"" else f"{key}={_quoted(value)}"
    if value[0] == "[" and value[-1] == "]":
        items = [item.strip() for item in re.split(r",(?![^\[({]*[\])}])", value[1:-1])]
        made = f"{key}=[{','.join(item if _parses(f'{key}={item}') else _quoted(item) for item in items)}]"
    return made if _parses(made) else word


def _parses(word: str) -> bool:
    """Tell whether Hydra can read a word."""
    with suppress(HydraException):
        return bool(OverridesParser.create().parse_override(word))
    return False


def _quoted(text: object) -> str:
    """Return what Hydra's grammar takes as text."""
    escaped = str(text).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def require_keys(config_name: str, settings: list[str]) -> list[str]:
    """Refuse a key that the config of a command does not have, and let one of a plant be added to it."""
    if not settings:
        return []
    folders, chosen, keys = [CONF, Path(config_dir() or CONF)], [], {}
    for word, override in zip(settings, OverridesParser.create().parse_overrides(settings)):
        key, glob = override.key_or_group, "=glob(" in word
        many = (override.is_choice_sweep() and not glob) or override.is_range_sweep()
        first = next(override.sweep_string_iterator(), None) if many else word.partition("=")[2].strip("'\"")
        if first is None:
            raise ValueError(f"the sweep has no job, as {word} is empty; give values, such as 'seed=range(0,5)'")
        group = key.startswith("hydra/") or any((folder / key).is_dir() for folder in folders)
        if group and not glob:  # of several options the first stands for all, and null is one that there is not
            text = not first.startswith("[") and word[0] != "~"
            chosen.append(f"{override.get_key_element()}='{first}'" if text else word)
        elif key == "hydra.searchpath":
            chosen.append(word)
        elif not group and not key.startswith("hydra."):
            keys[word] = key
    whole: Any = OmegaConf.to_container(compose(config_name, chosen))
    names = [f"{group}.{name}".lstrip(".") for group, node in nodes(whole) for name in node]
    added = []
    for word, key in keys.items():
        group, _, name = key.rpartition(".")
        if source := taken_from(group, whole):
            raise ValueError(f"'{key}' follows another key; give {source}.{name} instead")
        if key in names or word[0] in "+~":
            continue
        if "plant" not in names or not key.startswith("plant."):
            raise ValueError(_misspelt(key, names))
        added.append(word)
    return [f"++{word}" if word in added else word for word in settings]


def _misspelt(key: str, names: list[str]) -> str:
    """Return which keys stand where one was given that does not exist."""
    public = (each for each in dict.fromkeys(names) if not re.search(r"\[|(^|\.)_", each))
    known = sorted(public, key=lambda name: name.count("."))
    group = key.rpartition(".")[0]
    while group not in ("", *known):
        group = group.rpartition(".")[0]
    own = [each.rpartition(".")[2] for each in known if each.rpartition(".")[0] == group]
    return unknown_name(key.removeprefix(f"{group}."), own, group, known)


def compose(config_name: str | None, settings: list[str]) -> DictConfig:
    """Return a config as Hydra composes it of settings, with the folder of the user's own as the command names it."""
    own = config_dir()
    folder = [f"hydra.searchpath=[file://{Path(own).absolute()}]"] if own else []
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra.compose(config_name, overrides=[*folder, *settings])


def implied(settings: list[str], options: Namespace) -> list[str]:
    """Return what settings imply: the folder that Hydra is to use, and the plant of a model.

    The same sweep has the same folder, so that the same command goes on with it; a resumed run keeps its own. A model
    that is given without data and without a plant, `model=model.json`, stands in the place of a log's.
    """
    given = dict(word.split("=", 1) for word in settings if "=" in word)
    found = []
    if given.get("model", "null") not in ("null", "") and not {"data", "system", "resume"} & set(given):
        found.append("system=logged")
    folder = given.get("resume", "null").strip("'\"")
    if folder not in ("null", ""):
        if not (Path(folder) / "config.yaml").is_file():
            raise FileNotFoundError(
                f"resume={folder} is no run folder, it has no config.yaml; give the folder that train.py printed"
            )
        found.append(f"hydra.run.dir={_quoted(folder)}")
    elif options.multirun and "hydra.sweep.dir" not in given:
        own = [word for word in settings if not word.startswith("hydra")]
        digest = hashlib.blake2b(" ".join(own).encode(), digest_size=3).hexdigest()
        readable = re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(own)).strip("-.")
        found.append(f"hydra.sweep.dir='runs/{readable[:80]}_{digest}'")
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
