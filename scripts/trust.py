"""What the config.yaml of a run folder may hold: plain settings, and parts of the package or of a plug-in to build.

A run folder may be anybody's. What a user composes himself, from conf/ or --config-dir, is his own and not looked at.
"""

import importlib
import inspect
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from dynasindy.safe_io import read_text, reading

LARGEST, DEEPEST = 250_000, 20
"""Size [bytes] and depth that a config.yaml may have; those of runs have 3000 and 6. Deep ones take YAML minutes."""
CLASSES = (
    *("systems", "tasks", "envs", "excitation", "sindy", "planning", "agents", "sensing"),
    *("evaluation.scenarios", "evaluation.disturbances", "evaluation.ablation", "dyna.experiment"),
)
BUILDERS = (
    *("sindy.named_libraries", "evaluation.scenarios.step_references"),
    *("tasks.references.target", "tasks.references.wave"),
)
"""Where the parts of an experiment are classes, and where they are functions."""
FOREIGN = (".Foreign", ".GymnasiumEnv")
"""Parts that look an environment up by its id."""
PLUGINS = "DYNASINDY_PLUGINS"
"""Environment variable that names packages of plug-ins, with commas or spaces between them."""


def read_config(file: Path) -> DictConfig:
    """Return the settings of a run's config.yaml: small and plain YAML, without tags, aliases and interpolations."""
    text, depth = read_text(file, LARGEST), 0
    with reading(file):
        try:
            for event in yaml.parse(text, Loader=yaml.SafeLoader):
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                anchor, tag, value = (getattr(event, name, None) for name in ("anchor", "tag", "value"))
                if anchor or tag or "${" in (value or "") or depth > DEEPEST:  # an alias has an anchor, too
                    line = event.start_mark.line + 1
                    raise ValueError(f"line {line} is no plain key and value, as a run writes them")
            config = OmegaConf.create(text)
        except (yaml.YAMLError, AssertionError) as error:  # OmegaConf asserts that a text is no single number
            raise ValueError(str(error) or "it does not hold keys and values") from error
        if not isinstance(config, DictConfig):
            raise TypeError("it does not hold keys and values")
    return config


def nodes(tree: Any, key: str = "") -> Iterator[tuple[str, Mapping[Any, Any]]]:
    """Yield all groups of settings, each with its key; a group comes before those in it."""
    if isinstance(tree, Mapping):
        yield key, tree
        for name, child in tree.items():
            yield from nodes(child, f"{key}.{name}".lstrip("."))
    elif isinstance(tree, list):
        for place, child in enumerate(tree):
            yield from nodes(child, f"{key}[{place}]")


def plugins_of(cfg: DictConfig) -> tuple[str, ...]:
    """Return the word of a command line that names the packages of the user's own parts; none where there are none."""
    built = [node for _, node in nodes(OmegaConf.to_container(cfg, resolve=True)) if "_target_" in node]
    named = [name for node in built for name in (str(node["_target_"]), _module(node))]
    own = sorted({name.partition(".")[0] for name in named} - {"dynasindy", ""})
    return (f"plugins=[{','.join(own)}]",) if own else ()


def require_trusted(tree: Any, plugins: Sequence[str] = (), where: str = "config.yaml") -> None:
    """Refuse settings, as plain containers, that would build anything but a part of the package or of a plug-in.

    Plug-ins are packages that the user names, to the command and in the environment.
    """
    named = re.split(r"[,\s]+", ",".join([*plugins, os.environ.get(PLUGINS, "")]))
    for key, node in nodes(tree):
        if why := _distrust(node, list(filter(None, named))):
            raise ValueError(f"{where} has {key and f'{key}.'}{why}")


def _distrust(node: Mapping[Any, Any], plugins: Sequence[str]) -> str:
    """Return what in a group no run writes, or what it would build that is not trusted, and what is allowed instead."""
    if words := [word for word in node if str(word).startswith("_") and word not in ("_target_", "_partial_")]:
        return f"{words[0]}, which no run writes: remove it"
    if not isinstance(node.get("_partial_", False), bool):
        return f"_partial_: {node['_partial_']!r}; allowed are true and false: correct it"
    if "_target_" not in node:
        return ""
    by_name = f"plug-ins that you trust and name, as by plugins=[PACKAGE,OTHER] or {PLUGINS}=PACKAGE,OTHER"
    if why := _no_part(node["_target_"], plugins):
        target = repr(node["_target_"])[:100]
        return f"_target_: {target}, which {why}; allowed are parts of dynasindy, and of {by_name}"
    if (module := _module(node)) and module.partition(".")[0] not in plugins:
        return f"id: {str(node['id'])[:60]!r}, which imports {module[:40]!r}; allowed are environments of {by_name}"
    options = node.get("options") or {} if str(node["_target_"]).endswith(FOREIGN) else {}
    for value in options.values() if isinstance(options, Mapping) else [options]:
        if not (value is None or isinstance(value, int | float)):  # it may be the name of a file to read
            return f"options with {str(value)[:40]!r}; allowed are numbers, true and false"
    return ""


def _module(node: Mapping[Any, Any]) -> str:
    """Return the module that Gymnasium imports for an environment, as `gymnasium.make("module:Name-v0")` does."""
    module, colon, _ = str(node.get("id")).partition(":")
    return module if colon and str(node.get("_target_")).endswith(FOREIGN) else ""


def _no_part(target: Any, plugins: Sequence[str]) -> str:
    """Return why a target is no part: nothing outside the admitted packages is imported to find out."""
    if not isinstance(target, str) or not re.fullmatch(r"[^\W\d_]\w*(\.[^\W\d_]\w*)+", target):
        return "is no name of a part"
    package = next((name for name in ("dynasindy", *plugins) if target.startswith(f"{name}.")), None)
    if package is None:
        return "is of another package"
    module, _, name = target.rpartition(".")
    try:
        part = getattr(importlib.import_module(module), name)
    except Exception as error:  # a plug-in may raise anything while it is imported
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return f"cannot be imported ({reason}); PYTHONPATH names the folder that a package lies in"
    return "" if is_part(part, package) else "is no part of an experiment"


def is_part(part: Any, package: str) -> bool:
    """Return whether an object is a class or a function of the package itself, and one that experiments are made of."""
    if not (inspect.isclass(part) or inspect.isfunction(part)) or part.__qualname__ != part.__name__:
        return False
    place = f"{part.__module__}.{part.__name__}."
    if package != "dynasindy":
        return place.startswith(f"{package}.")
    homes = CLASSES if inspect.isclass(part) else BUILDERS
    return not part.__name__.startswith("_") and place.startswith(tuple(f"dynasindy.{home}." for home in homes))
