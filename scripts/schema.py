"""What a config may hold: the annotations of what it builds are its schema, checked before anything is built."""

import inspect
import math
import os
import pkgutil
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, Literal, TypedDict, Union, get_args, get_origin, get_type_hints, is_typeddict

from mistakes import unknown
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationToMissingValueError

from dynasindy.dyna.experiment import Recipe
from dynasindy.evaluation.ablation import Level
from dynasindy.evaluation.identification import Logged, Simulated
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.systems import System

LARGEST = 1e19
"""Squares of larger numbers, and of numbers smaller than its inverse, are no float32."""
GIVEN = {"signature", "system", "task", "n_u", "n_obs", "env", "agent", "replay", "policy"}
"""Arguments that an experiment hands to what a config builds with `_partial_`."""


class Plant(TypedDict):
    """Keys of `plant`, from which other groups copy; a mistake is named here rather than where it was copied to."""

    outputs: list[str]
    rates: list[str]
    low: list[float]
    high: list[float]
    known: dict[str, str]
    amplitude: float | list[float]
    offset: float | list[float]


class Evaluation(TypedDict):
    """Keys of `evaluation`."""

    every: int


class Keys(TypedDict):
    """Keys at the top of any command's config, besides the parts of an experiment."""

    threads: Annotated[int, range(1, 8 * (os.cpu_count() or 1) + 1), "eight for each core of this computer"]
    folder: str
    formats: list[Literal["png", "svg", "pdf", "eps", "jpg", "jpeg", "tif", "tiff", "webp"]]
    run: str | None
    scenarios: list[str]
    integral: bool
    animate: bool
    animation: Literal["gif", "mp4"]
    results: str
    output: str
    save: str | None
    name: str | None
    settings: list[str]
    slim: list[str]
    refinement: str
    evaluation: Evaluation
    plant: Plant
    scenario: Scenario
    data: Logged | Simulated
    level: Level


TOP = get_type_hints(Keys, include_extras=True) | get_type_hints(Recipe)
TOP |= {"seed": Annotated[int, range(2**63)], "system": System | None}


def check(cfg: DictConfig, file: str = "") -> None:
    """Check every value of a composed config, and make numbers of those that were written as text.

    Args:
        cfg: The config of any command.
        file: Where it was read from, if it was not composed from the command line.

    Raises:
        ValueError: A value is not what its key allows, or an argument does not exist or is not given.
    """
    try:
        tree = OmegaConf.to_container(cfg, resolve=True)
    except InterpolationToMissingValueError:  # a log where a plant is wanted; the command says which plants there are
        return
    found: dict[str, Any] = {}
    try:
        _arguments(tree, TOP, "", found)
        _nodes(tree, "", found)
    except ValueError as error:
        raise ValueError(f"{file}: {error}" if file else str(error)) from error
    for key, value in found.items():
        OmegaConf.update(cfg, key, value, merge=False)


def _nodes(tree: Any, key: str, found: dict[str, Any]) -> None:
    """Check all groups with `_target_`, wherever they stand."""
    if isinstance(tree, list):
        for place, child in enumerate(tree):
            _nodes(child, f"{key}[{place}]", found)
    elif isinstance(tree, dict):
        if "_target_" in tree:
            _call(tree, key, found)
        for name, child in tree.items():
            _nodes(child, f"{key}.{name}".lstrip("."), found)


def _call(node: dict[str, Any], key: str, found: dict[str, Any]) -> None:
    """Check the arguments of one `_target_` by its annotations."""
    function = _made(node, key)
    try:
        hints = get_type_hints(function.__init__ if isinstance(function, type) else function, include_extras=True)
        parameters = inspect.signature(function).parameters.values()
    except (NameError, TypeError, ValueError, AttributeError):  # another library's, that does not say
        return
    given = {name: value for name, value in node.items() if not str(name).startswith("_")}
    allowed = {p.name: hints.get(p.name, Any) for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    needed = {p.name for p in parameters if p.name in allowed and p.default is p.empty}
    for rest in (hints.get(p.name) for p in parameters if p.kind is p.VAR_KEYWORD):
        # Unpack[a TypedDict], or Annotated[Any, a dataclass], say what else is taken; others take anything.
        inner = get_args(rest)
        allowed |= get_type_hints(inner[-1], include_extras=True) if inner else dict.fromkeys(given, Any)
    for name in given.keys() - allowed.keys():
        raise ValueError(unknown(str(name), allowed.keys() - GIVEN, key))
    for name in sorted(needed - given.keys() - (GIVEN if node.get("_partial_") else set())):
        raise ValueError(f"{key}.{name} is not given; allowed is {_words(allowed[name])}: give it, as conf/ does")
    _arguments(given, allowed, key, found)


def _made(node: Mapping[str, Any], key: str) -> Any:
    """Return the class or function that a group names."""
    target = node["_target_"]
    try:
        return pkgutil.resolve_name(target)
    except Exception as error:  # importing runs whatever module is named
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(
            f"{key}._target_ is {_shown(target)}, which cannot be imported ({reason}); allowed is the dotted path of "
            "a class or function: correct it, or install the package that it is in"
        ) from error


def _arguments(given: Mapping[str, Any], hints: Mapping[str, Any], key: str, found: dict[str, Any]) -> None:
    """Fit the values that are given, and note those that change."""
    for name in hints.keys() & given.keys():
        whole = f"{key}.{name}".lstrip(".")
        if (value := _fit(given[name], hints[name], whole)) != given[name]:
            found[whole] = value


def _fit(value: Any, hint: Any, key: str) -> Any:
    """Return a value as its annotation wants it; one that does not fit raises, with what is allowed."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    fits, inner = False, value
    if value == "???" or kind in (Any, object):
        return value
    if isinstance(value, dict) and "_target_" in value:
        fits = _builds(value, hint, key)
    elif kind in (Union, types.UnionType):
        return _one_of(value, hint, key)
    elif kind is Annotated:
        endless = math.inf in options and str(value).lstrip(".") == "inf"
        with suppress(ValueError):
            inner = math.inf if endless else _fit(value, options[0], key)
            fits = all(inner in limit for limit in options if isinstance(limit, range))
    elif kind is Literal:
        fits = value in options
    elif kind in LEAVES:
        inner = LEAVES[kind](value)
        fits = inner is not None
    elif kind is types.NoneType:
        fits = value is None
    elif kind in (dict, Mapping) or is_typeddict(kind):
        if fits := isinstance(value, dict):
            hints = (
                get_type_hints(kind) if is_typeddict(kind) else dict.fromkeys(value, options[-1] if options else Any)
            )
            inner = value | {k: _fit(value[k], h, f"{key}.{k}") for k, h in hints.items() if k in value}
    elif kind in (list, tuple, Sequence, Collection, Iterable):
        fixed = kind is tuple and Ellipsis not in options
        if fits := isinstance(value, list) and (not fixed or len(value) == len(options)):
            hints = options if fixed else [options[0] if options else Any] * len(value)
            inner = [_fit(v, h, f"{key}[{i}]") for i, (v, h) in enumerate(zip(value, hints))]
    else:
        fits = not isinstance(kind, type)  # a class or a callable wants a group with `_target_`
    if not fits:
        raise ValueError(f"{key} is {_shown(value)}; allowed is {_words(hint)}: correct it")
    return inner


def _one_of(value: Any, hint: Any, key: str) -> Any:
    """Fit a value to the first option of a union that takes it."""
    for option in get_args(hint):
        with suppress(ValueError):
            return _fit(value, option, key)
    others = [option for option in get_args(hint) if option is not types.NoneType]
    if len(others) == 1 and isinstance(value, (list, dict)):
        _fit(value, others[0], key)  # names the place in the list that is wrong
    raise ValueError(f"{key} is {_shown(value)}; allowed is {_words(hint)}: correct it")


def _builds(node: Mapping[str, Any], hint: Any, key: str) -> bool:
    """Return whether a group with `_target_` may build what an annotation wants."""
    made, kind = _made(node, key), get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return any(_builds(node, option, key) for option in get_args(hint))
    if node.get("_partial_") or not isinstance(made, type):
        return kind is Callable if node.get("_partial_") else not isinstance(made, type)
    return isinstance(kind, type) and issubclass(made, kind)


def _number(value: Any) -> float | None:
    """Return a number that calculations stand, also from text; None for all else."""
    if isinstance(value, str):
        with suppress(ValueError):
            value = int(value)
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return value if value == 0 or 1 / LARGEST <= abs(value) <= LARGEST else None


def _whole(value: Any) -> int | None:
    number = _number(value)
    return int(number) if number is not None and number == int(number) else None


def _text(value: Any) -> str | None:
    return str(value) if isinstance(value, str | int) and not isinstance(value, bool) else None


LEAVES = {
    int: _whole,
    float: _number,
    bool: lambda value: value if isinstance(value, bool) else None,
    str: _text,
}


def _shown(value: Any) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _words(hint: Any) -> str:
    """Say what an annotation allows."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return " or ".join(_words(option) for option in options)
    if kind is Annotated:
        notes = [f"{limit.start} to {limit.stop - 1}" for limit in options if isinstance(limit, range)]
        notes += [".inf too" for limit in options if limit == math.inf] + [o for o in options if isinstance(o, str)]
        return f"{_words(options[0])} ({', '.join(notes)})"
    if kind is Literal:
        return ", ".join(map(str, options))
    if kind in (dict, Mapping) or is_typeddict(kind):
        return "a group of keys"
    if kind in (list, tuple, Sequence, Collection, Iterable):
        inner = [_words(option) for option in options if option is not Ellipsis]
        return f"a list, each {inner[0]}" if len(inner) < 2 else f"a list of {len(inner)}: {', '.join(inner)}"
    names = {int: "a whole number", float: f"a finite number up to {LARGEST:g}", bool: "true or false", str: "text"}
    names |= {types.NoneType: "null"}
    return names.get(kind) or f"a group with _target_, a {getattr(kind, '__name__', kind)}"
