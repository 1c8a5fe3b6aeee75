"""What the config.yaml of a run folder may hold: plain settings, and parts of the package or of a plug-in to build.

A run folder may be anybody's. What a user composes himself, from conf/ or --config-dir, is his own and not looked at.
"""

import importlib
import inspect
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from dynasindy.safe_io import DamagedFileError, read_text, reading

LARGEST, DEEPEST = 250_000, 20
"""Size [bytes] and depth that a config.yaml may have; those of runs have 3000 and 6."""
ROOMS = ("systems", "tasks", "envs", "excitation", "sindy", "planning", "agents", "sensing")
BESIDES = ("evaluation.scenarios", "evaluation.disturbances", "evaluation.ablation", "dyna.components")
BUILDERS = (
    "dynasindy.sindy.named_libraries",
    "dynasindy.evaluation.scenarios.step_references",
    "dynasindy.tasks.references.target",
    "dynasindy.tasks.references.wave",
)
"""Where the parts of an experiment are classes, and where they are functions."""
FOREIGN = ("Foreign", "GymnasiumEnv")
"""Parts that look an environment up by its id."""
PLUGINS = "DYNASINDY_PLUGINS"
"""Environment variable that names packages of plug-ins, with commas or spaces between them."""


def read_config(file: Path) -> DictConfig:
    """Return the settings of a run's config.yaml, in which nothing is named that would be looked up or built.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It is no plain YAML: too large or deep, with tags, aliases or interpolations, or not YAML.
    """
    text, depth = read_text(file, LARGEST), 0
    try:
        with reading(file):
            for event in yaml.parse(text, Loader=yaml.SafeLoader):
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                if depth > DEEPEST:
                    raise ValueError(f"it is nested more than {DEEPEST} deep")
                if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
                    raise ValueError("it has anchors and aliases, which a run does not write")
                if getattr(event, "tag", None):
                    raise ValueError(f"it has the tag {event.tag}, which a run does not write")
                if "${" in (getattr(event, "value", None) or ""):
                    raise ValueError(f"it has the interpolation {event.value!r}; a run writes resolved values")
            config = OmegaConf.create(text)
            if not isinstance(config, DictConfig):
                raise TypeError("it does not hold keys and values")
    except (yaml.YAMLError, DamagedFileError) as error:
        raise DamagedFileError(" ".join(f"{'' if str(file) in str(error) else f'{file}: '}{error}".split())) from error
    return config


def trusted(plugins: str | Sequence[str] = ()) -> list[str]:
    """Return the packages of plug-ins that the user names, in `plugins` and in the environment.

    Args:
        plugins: What the command was given.
    """
    named = [plugins] if isinstance(plugins, str) else list(plugins)
    return [name for name in re.split(r"[,\s]+", ",".join([*named, os.environ.get(PLUGINS, "")])) if name]


def packages(node: Any) -> list[str]:
    """Return the packages beside dynasindy of which settings name parts, which have to be trusted to read them again.

    Args:
        node: Settings as plain containers.
    """
    found: set[str] = set()
    if isinstance(node, Mapping) and not _is_dtype(node):
        found.add(str(node.get("_target_", "dynasindy")).partition(".")[0])
        if str(node.get("_target_")).rpartition(".")[2] in FOREIGN and ":" in str(node.get("id")):
            found.add(str(node["id"]).partition(":")[0].partition(".")[0])
    for value in node.values() if isinstance(node, Mapping) else node if isinstance(node, list) else ():
        found.update(packages(value))
    return sorted(found - {"dynasindy"})


def check(node: Any, plugins: Sequence[str] = (), where: str = "config.yaml") -> None:
    """Refuse settings that would build anything but a part of the package or of a plug-in.

    Args:
        node: Settings as plain containers, all that they hold included.
        plugins: Packages that the user names.
        where: Words for the file.

    Raises:
        ValueError: `_target_` is none of them, or another word of Hydra's is used.
    """
    if isinstance(node, Mapping):
        if words := [key for key in node if str(key).startswith("_") and key not in ("_target_", "_partial_")]:
            raise ValueError(
                f"{where} has {words[0]}, which no run writes; allowed are _target_ and _partial_: remove it"
            )
        if not isinstance(node.get("_partial_", False), bool):
            raise ValueError(f"{where} has _partial_: {node['_partial_']!r}; allowed are true and false: correct it")
        if "_target_" in node and not _is_dtype(node):
            _check_target(node["_target_"], plugins, where)
        if str(node.get("_target_")).rpartition(".")[2] in FOREIGN:
            _check_foreign(node, plugins, where)
    for value in node.values() if isinstance(node, Mapping) else node if isinstance(node, list) else ():
        check(value, plugins, where)


def _check_foreign(node: Mapping[Any, Any], plugins: Sequence[str], where: str) -> None:
    """Refuse a Gymnasium environment whose id imports a module that is no plug-in, or whose options name files.

    `gymnasium.make("module:Name-v0")` imports the module, and an option may be the name of a file to read.
    """
    module, colon, _ = str(node.get("id", "")).partition(":")
    if colon and module.partition(".")[0] not in plugins:
        raise ValueError(
            f"{where} has env.id: {str(node['id'])[:60]!r}, which imports {module[:40]!r}; name it if you trust it, "
            f"as by plugins=[{module[:40]}] or {PLUGINS}={module[:40]}"
        )
    options = node.get("options") or {}
    values = options.values() if isinstance(options, Mapping) else [options]
    if wrong := [value for value in values if value is not None and not isinstance(value, int | float)]:
        raise ValueError(f"{where} has system.options with {str(wrong[0])[:40]!r}; allowed are numbers, true and false")


def _is_dtype(node: Mapping[Any, Any]) -> bool:
    """Return whether a node is the one helper of Hydra's that conf/ uses: a number type of torch, by name."""
    if set(node) != {"_target_", "path"} or node["_target_"] != "hydra.utils.get_object":
        return False
    import torch

    package, _, name = str(node["path"]).partition(".")
    return package == "torch" and isinstance(getattr(torch, name, None), torch.dtype)


def _check_target(target: Any, plugins: Sequence[str], where: str) -> None:
    """Refuse a target that is not written as a name, or is not what its name says.

    Nothing outside the admitted packages is imported to find out.
    """
    advice = (
        "allowed are parts of dynasindy, and of plug-ins that you trust and name, as by plugins=[PACKAGE,OTHER] or "
        f"{PLUGINS}=PACKAGE,OTHER" + (f"; named are {', '.join(plugins)[:100]}" if plugins else "")
    )
    shown = repr(target)[:100]
    if not isinstance(target, str) or not re.fullmatch(r"[^\W\d_]\w*(\.[^\W\d_]\w*)+", target):
        raise ValueError(f"{where} has _target_: {shown}, which is no name of a part; {advice}")
    package = next((name for name in ("dynasindy", *plugins) if target.startswith(f"{name}.")), None)
    if package is None:
        raise ValueError(f"{where} has _target_: {shown}, which is of another package; {advice}")
    module, _, name = target.rpartition(".")
    try:
        part = getattr(importlib.import_module(module), name)
    except Exception as error:  # a plug-in may raise anything while it is imported
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        absent = isinstance(error, ModuleNotFoundError) and f"{package}.".startswith(f"{error.name}.")
        found = f"; name the folder that {package} lies in by PYTHONPATH" if absent and package != "dynasindy" else ""
        raise ValueError(
            f"{where} has _target_: {shown}, which cannot be imported ({reason}){found}; {advice}"
        ) from error
    if not _is_part(part, package):
        raise ValueError(f"{where} has _target_: {shown}, which is no part of an experiment; {advice}")


def _is_part(part: Any, package: str) -> bool:
    """Return whether an object is a class or a function of the package itself, and one that experiments are made of."""
    if not (inspect.isclass(part) or inspect.isfunction(part)) or part.__qualname__ != part.__name__:
        return False
    place = f"{part.__module__}.{part.__name__}"
    if package != "dynasindy":
        return place.startswith(f"{package}.")
    homes = [f"dynasindy.{room}" for room in (*ROOMS, *BESIDES)] if inspect.isclass(part) else BUILDERS
    return not part.__name__.startswith("_") and any(f"{place}.".startswith(f"{home}.") for home in homes)
