"""What a command takes: its settings as they are composed, in the sentences that stand above each key of conf/."""

import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import hydra
import yaml
from commands import called, purpose
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from mistakes import CONF
from omegaconf import DictConfig, OmegaConf

WIDEST = 110
"""Columns that a line takes at most, also where the terminal is wider."""
SILENT = ("defaults", "hydra")
"""Keys of a file that say how it is composed, which hardly anybody sets."""


def manual(name: str, words: Sequence[str]) -> str:
    """Return the help of a command.

    Args:
        name: Command, that of the file `conf/NAME.yaml`.
        words: The other words of the command line. `group` asks for its options and `group=option` for the keys of
            one; other settings are shown as they are given.
    """
    given, _ = get_args_parser().parse_known_args(words)
    words = [word for word in given.overrides if not word.startswith(("-", "~"))]
    overrides = [word for word in words if "=" in word]
    # A sweep has no single value to show.
    read = OverridesParser.create().parse_overrides(overrides)
    overrides = [word for word, override in zip(overrides, read) if not override.is_sweep_override()]
    if given.config_dir:
        overrides.append(f"hydra.searchpath=['file://{Path(given.config_dir).absolute()}']")
    asked = {group: option for group, _, option in (word.partition("=") for word in words) if (CONF / group).is_dir()}
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        config = hydra.compose(name, overrides, return_hydra_config=True)
        groups = list(_chosen(config))
        for word in words:
            if "=" not in word and word not in asked:
                there = f"the groups here are {', '.join(groups)}" if groups else "there are no groups here"
                raise ValueError(f"'{word}' is no group of options, and no setting of the form key=value; {there}")
        lines = [line for group, option in asked.items() for line in _group(group, option, config)]
        return "\n".join(lines or _command(name, config)).rstrip()


def options(group: str) -> list[str]:
    """Return the options of a group; those with a leading underscore are parts of others.

    Packages that are installed bring options of their own, such as launchers.
    """
    if not GlobalHydra.instance().is_initialized():
        with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
            return options(group)
    found = GlobalHydra.instance().config_loader().get_group_options(group)
    return sorted(option for option in found if not option.startswith("_"))


def heading(file: Path) -> str:
    """Return the sentences at the top of a file."""
    lines = file.read_text().splitlines()
    end = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return _joined(line for line in lines[:end] if not line.startswith("# @package"))


def sentences(file: Path) -> dict[str, str]:
    """Return what is said above each key of a file, and of those of its folder that it begins with.

    A key has dots, as a command line has them. What is said above several is said of the first.
    """
    text = file.read_text()
    found: dict[str, str] = {}
    for entry in (yaml.safe_load(text) or {}).get("defaults", ()):
        if isinstance(entry, str) and entry != "_self_" and "@" not in entry:
            found |= sentences(file.parent / f"{entry}.yaml")
    is_global = file.parent == CONF or text.startswith("# @package _global_")
    above: dict[str, str] = {}
    for key, value, said in entries(file):
        names = key.split(".")
        if any(name.startswith("_") for name in names) or (is_global and names[0] in SILENT):
            continue
        group = key.removesuffix(names[-1])
        said = f"{above.pop(group, '')} {said}".strip()  # what is said above a group is said of its first key
        if value is None:
            above[f"{key}."] = said
        else:
            place = key if is_global else f"{file.parent.name}.{key}"
            found[place] = said or found.get(place, "")
    return found


def entries(file: Path) -> Iterator[tuple[str, str | None, str]]:
    """Yield the keys of a file as a command line has them, each with its value as it is written and what is said above.

    The value of a group, whose keys follow, is None, that of a list whose parts stand below it empty.
    """
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
            yield f"{prefix}{key.value}", None if group else written, _sentences(lines, key.start_mark.line)
            if below:
                yield from walk(value, f"{prefix}{key.value}.")

    yield from walk(yaml.compose(text, Loader=yaml.SafeLoader), "")


def _sentences(lines: list[str], end: int) -> str:
    """Return the comment that ends above a line; one that begins at the top of the file is the file's own."""
    start = end
    while start and lines[start - 1].lstrip().startswith("#"):
        start -= 1
    return _joined(lines[start:end]) if start else ""


def _joined(comment: Iterable[str]) -> str:
    return " ".join(" ".join(line.strip().lstrip("#") for line in comment).split())


def _command(name: str, config: DictConfig) -> Iterator[str]:
    """Yield the help of a command: what it does, its groups, its own settings."""
    file = CONF / f"{name}.yaml"
    here = called(name)
    yield from _wrapped(purpose(name))
    yield from ["", *_wrapped(heading(file))]
    chosen = _chosen(config)
    if chosen:
        yield from ["", f"What it is made of; `{here} GROUP --help` says what the options are:"]
        width = max(len(f"{group}={option}") for group, option in chosen.items())
        for group, option in chosen.items():
            others = ", ".join(other for other in options(group) if other != option)
            text = f"{f'{group}={_written(option)}':<{width}}  or {others}"
            yield from textwrap.wrap(text, _width(), initial_indent="  ", subsequent_indent=" " * (width + 7))
    yield from ["", "Settings:", *_settings(sentences(file), config), ""]
    example = next((f"{group}={option}" for group, option in chosen.items() if option and "/" not in group), "")
    if example:
        yield f"Settings of an option:       {here} {example} --help"
    yield f"The whole config:            {here} --cfg job"
    if _sweeps(config):
        yield f"A sweep:                     {here} -m seed=0,1,2"
    yield f"What Hydra itself can do:    {here} --hydra-help"


def _chosen(config: DictConfig) -> dict[str, str]:
    """Return the groups that a command is made of with their options; what runs a sweep only where there is one."""
    order = reversed(config.hydra.runtime.choices.items())
    return {
        group: option
        for group, option in order
        if (_sweeps(config) if group == "hydra/launcher" else (CONF / group).is_dir())
    }


def _sweeps(config: DictConfig) -> bool:
    """Return whether a command makes something of the jobs of a sweep."""
    return OmegaConf.select(config, "hydra.callbacks.gathered") is not None


def _group(group: str, option: str, config: DictConfig) -> Iterator[str]:
    """Yield the options of a group, or the settings of one of them."""
    for choice in [option] if option else options(group):
        yield f"{group}={choice}"
        file = CONF / group / f"{choice}.yaml"
        if file.is_file():  # of the user's own, it may lie in another folder
            yield from _wrapped(heading(file), "    ")
            yield from ["", *(_settings(sentences(file), config) if option else ())]


def _settings(said: dict[str, str], config: DictConfig) -> Iterator[str]:
    """Yield each setting and the sentences about it; one without any stands beside its neighbour."""
    line, words, before = "", "", ""
    for key, sentence in said.items():
        parent, _, name = key.rpartition(".")
        node = OmegaConf.select(config, parent) if parent else config
        if not isinstance(node, DictConfig) or name not in node:
            continue
        value = OmegaConf.to_container(node, resolve=False)[name]
        if value == "${hydra:runtime.output_dir}":
            swept = str(config.hydra.mode).endswith("MULTIRUN")
            kind = OmegaConf.to_container(config.hydra.sweep if swept else config.hydra.run, resolve=False)
            value = f"{kind['dir']}/..." if swept else kind["dir"]
        setting = f"{key}={_written(value)}"
        if sentence or not line or parent != before:
            yield from _paragraph(line, words)
            line, words, before = setting, sentence, parent
        else:
            line = f"{line}  {setting}"
    yield from _paragraph(line, words)


def _paragraph(line: str, words: str) -> Iterator[str]:
    if line:
        yield f"  {line}"
    for group in re.findall(r"\bin conf/(\w+)\b(?!/)", words):
        words = f"{words} There are {', '.join(options(group))}."
    yield from _wrapped(words, "      ")


def _written(value: Any) -> str:
    """Return a value as a command line has it."""
    if isinstance(value, str):
        return re.sub(r"\$\{now:[^}]*\}", "DATE_TIME", value)
    return yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("\n").removesuffix("\n...")


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, _width(), initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _width() -> int:
    return min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST)
