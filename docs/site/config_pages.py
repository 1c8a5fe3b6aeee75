"""The page on every key of conf/: what the YAML files say of it, and what the annotations of the code allow.

Nothing is written here a second time. The sentence on a key is the comment above it in its file, or, where a file says
nothing, the sentence on the argument in the docstring of what `_target_` names. What a key may hold is the annotation
by which `scripts/settings.py` checks it before a command begins.
"""

import inspect
import math
import pkgutil
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml
from typing_extensions import is_typeddict

REPOSITORY = Path(__file__).parents[2]
sys.path += [str(REPOSITORY), str(REPOSITORY / "scripts")]  # MkDocs takes them back when this file is read
from cli import heading  # noqa: E402
from settings import EXPORTING, LARGEST, TOP, parameters  # noqa: E402

CONF = REPOSITORY / "conf"
GROUPS = {
    "commands": "Commands",
    "system": "Plants",
    "task": "Tasks",
    "excitation": "Excitations",
    "sensors": "Sensors",
    "world_model": "World models",
    "planning": "Planning",
    "agent": "Agents",
    "experiment": "Experiments",
    "scenario": "Scenarios of an evaluation",
    "setting": "Settings of the ablation",
    "data": "Data of an identification",
    "rig": "Rigs",
}
"""The top of conf/, and its folders, in the order of their sections, with titles."""
SILENT = {"_target_", "_partial_", "defaults", "hydra"}
"""Keys that configure Hydra, not dynasindy."""


@dataclass(frozen=True)
class Key:
    """A key of a file.

    Attributes:
        name: Its path within the file, such as `reward.bonus`.
        value: Its value as the file writes it; empty for a group of keys.
        comment: The sentences above it in the file.
        shared: Whether these sentences stand above another key, directly before it.
        target: What the group that it stands in builds, by its dotted path.
    """

    name: str
    value: str = ""
    comment: str = ""
    shared: bool = False
    target: str = ""


def page() -> str:
    """Return the page in Markdown: the commands, then the groups, each with all its files."""
    parts = ["# Settings", "The groups that stand below `defaults` of a command have sections of their own."]
    for group, title in GROUPS.items():
        command = group == "commands"
        files = sorted(
            (CONF if command else CONF / group).glob("*.yaml"), key=lambda file: (file.stem != "train", file)
        )
        about = "The keys at the top of each command."
        if not command:
            about = f"`{group}=NAME` on the command line chooses one of these files of `conf/{group}`."
        parts += [f"## {title} {{ #{group} }}", about]
        parts += [_section(file, f"scripts/{file.stem}.py" if command else f"{group}={file.stem}") for file in files]
    return "\n\n".join(parts) + "\n"


def anchor(path: Path) -> str:
    """Return where the page describes a folder or a file of conf/."""
    if path.parent != CONF:
        return f"{path.parent.name}-{path.stem.lstrip('_')}"
    return f"commands-{path.stem}" if path.suffix else path.name


def keys(file: Path) -> Iterator[Key]:
    """Yield the keys of a YAML file of conf/ with the comments above them, but for those that configure Hydra.

    The comment at the top of a file is about the whole file and so no key's.
    """
    latest, built = Key(""), _targets(yaml.safe_load(file.read_text()) or {})
    for name, value, said in entries(file):
        if not SILENT & set(name.split(".")):
            group = name.rpartition(".")[0]
            shared = not said and latest.name.rpartition(".")[0] == group and bool(latest.comment)
            latest = Key(name, value or "", latest.comment if shared else said, shared, built.get(group, ""))
            yield latest


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
            start = end = key.start_mark.line
            while start and lines[start - 1].lstrip().startswith("#"):
                start -= 1
            # A comment that begins at the top of the file is the file's own.
            yield (
                f"{prefix}{key.value}",
                None if group else written,
                " ".join(line.strip("# ") for line in lines[start:end]) if start else "",
            )
            if below:
                yield from walk(value, f"{prefix}{key.value}.")

    yield from walk(yaml.compose(text, Loader=yaml.SafeLoader), "")


def explained(file: Path) -> Iterator[Key]:
    """Yield the keys of a file that hold a value, each with a sentence and with what it belongs to.

    Where neither the file nor the docstring of what it builds has a sentence, it is that of another file on the same
    key, that on the group that it stands in, or the one at the top of the file.
    """
    above: dict[str, str] = {}
    for key in keys(file):
        known = _known().get(_whole(file, key.name), key)
        target = key.target or known.target
        comment = "" if key.shared else key.comment
        comment = comment or _described(key.name, target) or key.comment or known.comment
        if not comment and key.value.startswith("${"):
            comment = f"Copied from `{key.value.strip('${}').removeprefix('oc.select:').partition(',')[0]}`."
        above[key.name] = comment = comment or above.get(key.name.rpartition(".")[0], "")
        if key.value:
            yield replace(key, comment=comment or heading(file), target=target)


@cache
def _known() -> Mapping[str, Key]:
    """Return what is known of each key by its whole path, from whichever file says most; the main one comes first."""
    found: dict[str, Key] = {}
    for file in [CONF / "train.yaml", *sorted(CONF.rglob("*.yaml"))]:
        for key in keys(file):
            name = _whole(file, key.name)
            before = found.get(name, key)
            comment = before.comment or ("" if key.shared else key.comment)
            found[name] = replace(before, comment=comment, target=before.target or key.target)
    return found


def _whole(file: Path, name: str) -> str:
    """Return the path of a key in a composed config."""
    everywhere = file.parent == CONF or "@package _global_" in file.read_text()
    return name if everywhere else f"{file.parent.name}.{name}"


def _section(file: Path, title: str) -> str:
    rows = [
        f"| `{key.name}` | {_code(key.value)} | {_cell(_allowed(key, file))} | {_cell(key.comment)} |"
        for key in explained(file)
    ]
    table = ["| key | value | allowed | meaning |", "| --- | --- | --- | --- |", *rows] if rows else []
    return "\n\n".join(filter(None, [f"### `{title}` {{ #{anchor(file)} }}", _cell(heading(file)), "\n".join(table)]))


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|") if text else ""


def _cell(text: str) -> str:
    """Return a sentence of a YAML file or a docstring as Markdown that stands in a table."""
    plain = text.replace("|", "\\|")
    return plain if "`" in plain else plain.replace("<", "&lt;").replace("[", "\\[")


def _allowed(key: Key, file: Path) -> str:
    """Return what a key may hold, in the words of the messages that refuse another value."""
    group, _, name = key.name.rpartition(".")
    hints = _hints(key.target) if key.target else _top(file.stem)
    if group and not key.target:
        hints = _typed(hints.get(group))
    hint = hints.get(name) or hints.get(key.name)
    allowed = "" if hint in (None, Any) else words(hint)
    return re.sub(r"\d+ to \d+, (?=eight for)", "up to ", allowed.replace(f" up to {1e19:g}", ""))


def words(hint: Any) -> str:
    """Say what an annotation allows."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return " or ".join(words(option) for option in options)
    if kind is Annotated:
        notes = [f"{limit.start} to {limit.stop - 1}" for limit in options if isinstance(limit, range)]
        notes += [".inf too" for limit in options if limit == math.inf] + [o for o in options if isinstance(o, str)]
        return f"{words(options[0])} ({', '.join(notes)})"
    if kind is Literal:
        return ", ".join(map(str, options))
    if kind in (dict, Mapping) or is_typeddict(kind):
        return "a group of keys"
    if kind in (list, tuple, Sequence, Collection, Iterable):
        inner = [words(option) for option in options if option is not Ellipsis]
        return f"a list, each {inner[0]}" if len(inner) < 2 else f"a list of {len(inner)}: {', '.join(inner)}"
    names = {int: "a whole number", float: f"a finite number up to {LARGEST:g}", bool: "true or false", str: "text"}
    return names.get(kind) or (
        "null" if kind is NoneType else f"a group with _target_, a {getattr(kind, '__name__', kind)}"
    )


def _top(command: str) -> Mapping[str, Any]:
    """Return the annotations of the keys at the top of a command's config."""
    return TOP | (EXPORTING if command == "export" else {})


def _typed(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind, include_extras=True) if is_typeddict(kind) else {}


def _hints(target: str) -> Mapping[str, Any]:
    """Return the annotations of what a group builds, with those of the settings that it passes on."""
    return parameters(pkgutil.resolve_name(target))[0] if target.startswith("dynasindy.") else {}


def _built(target: str) -> Any:
    if not target.startswith("dynasindy."):
        return None
    named = pkgutil.resolve_name(target)
    return named.__init__ if isinstance(named, type) and not is_dataclass(named) else named


def _described(name: str, target: str) -> str:
    """Return what the docstring of what its group builds says of a key."""
    return _argument(target, name.rpartition(".")[2]) if target else ""


@cache
def _argument(target: str, name: str) -> str:
    """Return what a docstring says of an argument, or of an attribute of the settings that a class passes on."""
    if _built(target) is None:
        return ""
    named = pkgutil.resolve_name(target)
    sources = [*getattr(named, "__mro__", [named])]
    for hint in get_type_hints(_built(target), include_extras=True).values():
        sources += [inner for inner in get_args(hint) if isinstance(inner, type) and inner.__module__ != "builtins"]
    return next(filter(None, (_sentence(source, name) for source in sources)), "")


def _sentence(source: Any, name: str) -> str:
    found = re.search(rf"^( +){name}: (.*(?:\n\1 +.*)*)", inspect.getdoc(source) or "", re.M)
    said = " ".join(found[2].split()) if found else ""
    return said[:1].upper() + said[1:]


def _targets(tree: Any, place: str = "") -> dict[str, str]:
    """Return the `_target_` of each group of a file by the group's path."""
    if not isinstance(tree, dict):
        return {}
    found = {place: str(tree["_target_"])} if "_target_" in tree else {}
    for name, child in tree.items():
        found |= _targets(child, f"{place}.{name}".lstrip("."))
    return found
