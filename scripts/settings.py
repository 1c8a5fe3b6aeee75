"""What a config may hold: the annotations of what it builds are its schema, checked before anything is built."""

import inspect
import math
import os
import pkgutil
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    Required,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from errors import unknown
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError, InterpolationToMissingValueError
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    PlainValidator,
    StrictBool,
    TypeAdapter,
    ValidationError,
)
from typing_extensions import TypedDict

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.simulated import Simulated
from dynasindy.evaluation.ablation import Level
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.identification.identify import LoggedData
from dynasindy.rig import Guard
from dynasindy.sindy.functions import register_formula
from dynasindy.systems import System
from dynasindy.tasks.references import Signal

HYDRA = {"_target_", "_partial_", "_args_", "_convert_", "_recursive_"}
GIVEN = {"signature", "dt", "system", "task", "n_u", "n_obs", "env", "agent", "replay", "policy", "x", "u", "x_next"}
"""Arguments that an experiment hands to what a config builds with `_partial_`."""
LARGEST = 1e19
"""Squares of larger numbers, and of numbers smaller than its inverse, are no float32."""
PLANT: dict[str, Any] = {
    **{"outputs": list[str], "rates": list[str | None], "low": list[float], "high": list[float]},
    **{"start": dict[str, float | list[float]] | None, "bounds": dict[str, float | list[float]]},
    **{"known": dict[str, str] | None, "initial": dict[str, dict[str, float]] | None},
    **{"gain": list[list[float]] | None},
    **{"libraries": dict[Literal["simulated", "logged"], str], "first": float},
    **{"amplitude": float | list[float], "offset": float | list[float]},
    **{"sensors": dict[str, dict[str, float]], "noise": dict[str, float] | None, "functions": dict[str, str] | None},
}
"""Keys of `plant`, from which other groups copy; a mistake is named here rather than where it was copied to."""
SIGNALS: dict[str, Any] = {"step": list[list[float]], "sine": Signal, "square": Signal}
FIGURES = Literal["png", "svg", "pdf", "eps", "jpg", "jpeg", "tif", "tiff", "webp"]
THREADS = range(1, 8 * (os.cpu_count() or 1) + 1)
TOP: dict[str, Any] = {
    **get_type_hints(Recipe),
    **{
        "seed": Annotated[int, range(2**63)],
        "system": System | None,
        "threads": Annotated[int, THREADS, "eight for each core"],
    },
    **{"folder": str, "run": str | None, "resume": str | None, "results": str, "output": str, "controller": str | None},
    **{"save": str | None, "name": str | None, "settings": list[str], "slim": list[str], "scenarios": list[str]},
    **{"plugins": list[str], "formats": list[FIGURES]},
    **dict.fromkeys(("integral", "animate", "finish", "tensorboard", "any_commit"), bool),
    **{"refinement": str, "error_shape": str, "source": Literal["simulated", "logged"]},
    **{"longest_delay": Annotated[float, range(1001)] | None, "horizons": list[float] | None},
    **{"evaluation.every": int, "evaluation.must_improve": bool, "evaluation.must_control": bool},
    **{"evaluation.within": float, "checkpoint.every": int, "device": str},
    **{"scenario": Scenario, "data": LoggedData | Simulated, "level": Level},
    **{"dt": float, "targets": list[list[float]] | None, "seconds": float | None, "flights": int, "guard": Guard},
}
"""Keys of any command's config, besides those of what it builds."""
EXPORTING: dict[str, Any] = {
    **{"formats": list[Literal["c", "onnx", "fmu", "model"]], "folder": str | None, "fmi": Literal[2, 3]},
}
CHECKING: dict[str, Any] = {
    **{"low": list[float] | None, "high": list[float] | None, "folder": str | None, "reach": float},
    # Their number grows with the power of the outputs, and flights with the square of the grid.
    **{"points": Annotated[int, range(1, 51)], "grid": Annotated[int, range(2, 101)]},
    **{"draws": Annotated[int, range(10_001)]},
}
EXPERIMENT = {"task", "env", "agent", "replay", "planning", "gate"}


def check(cfg: DictConfig, file: str = "") -> None:
    """Check every value of a composed config, and make numbers of those that were written as text.

    Args:
        cfg: The config of any command.
        file: Where it was read from, if it is a finished run's, which has all parts of an experiment.

    Raises:
        ValueError: A value is not what its key allows, or an argument does not exist or is not given.
    """
    try:
        if not OmegaConf.is_dict(cfg) or not isinstance(plant := cfg.get("plant", {}), DictConfig | dict):
            chosen = f"; a plant is chosen by system={plant}" if OmegaConf.is_dict(cfg) else ""
            raise ValueError(f"plant is no group of keys; give them as conf/ does{chosen}")
        if (tree := _resolved(cfg)) is None:
            return
        for name in sorted(get_type_hints(Recipe).keys() - tree.keys() - {"sensors"}) if file else ():
            raise ValueError(f"'{name}' is not given; restore it, or train again")
        keys = TOP | (EXPORTING if "fmi" in tree else {}) | (CHECKING if "draws" in tree else {})
        if "train" not in tree and not file:  # a plant has words for the task of an experiment, which is not built
            keys = {name: hint for name, hint in keys.items() if name not in EXPERIMENT}
        found: dict[str, Any] = {}
        _check_group(tree.get("plant", {}), PLANT, "plant", found)
        _check_group((tree.get("plant") or {}).get("signals") or {}, SIGNALS, "plant.signals", found)
        _check_nodes(tree, "", found)
        for parent in {"", *(name.partition(".")[0] for name in keys if "." in name)}:
            place, prefix = (tree.get(parent), f"{parent}.") if parent else (tree, "")
            hints = {name[len(prefix) :]: hint for name, hint in keys.items() if name.startswith(prefix)}
            _check_group(place, {name: hint for name, hint in hints.items() if "." not in name}, parent, found)
    except ValueError as error:
        raise ValueError(f"{file}: {error}" if file else str(error)) from error
    for key, value in found.items():
        OmegaConf.update(cfg, key, value, merge=False)
    register_functions(tree)


def register_functions(tree: Any) -> None:
    """Register the functions of the user's own that the library of the plant is made of."""
    given = (tree.get("plant") or {}).get("functions") or {}
    if not isinstance(given, Mapping):
        raise ValueError(f"plant.functions is {_shown(given)}; give names with formulas, such as {{softened: '...'}}")
    for name, formula in given.items():
        register_formula(name, formula)


def _resolved(cfg: DictConfig) -> dict[Any, Any] | None:
    """Return a config as plain containers; None where it is a log's, which names no plant yet."""
    try:
        return OmegaConf.to_container(cfg, resolve=True)  # type: ignore[return-value]
    except InterpolationToMissingValueError:  # the command says which plants there are
        return None
    except InterpolationResolutionError as error:
        taken: Any = OmegaConf.to_container(cfg, resolve=False)
        for part in str(error.full_key).split("."):
            taken = taken[part]
        raise ValueError(
            f"{error.full_key} is taken from {str(taken).strip('${}')}, which is not given, or where a single value "
            "stands for a group of keys; give the keys as conf/ and docs/examples/conf do"
        ) from error


def _check_nodes(tree: Any, key: str, found: dict[str, Any]) -> None:
    """Check the arguments of all groups with `_target_`, wherever they stand, by the annotations of what they build."""
    if isinstance(tree, list):
        for place, child in enumerate(tree):
            _check_nodes(child, f"{key}[{place}]", found)
    elif isinstance(tree, dict):
        if "_target_" in tree:
            hints, required, free = _arguments(_builder(tree, key))
            given = {name: value for name, value in tree.items() if name not in HYDRA}
            for name in () if free else given.keys() - hints.keys():
                raise ValueError(unknown(str(name), hints.keys() - GIVEN, key))
            _check_group(given, hints, key, found, required - (GIVEN if tree.get("_partial_") else set()))
        for name, child in tree.items():
            _check_nodes(child, f"{key}.{name}".lstrip("."), found)


@cache
def _arguments(builder: Any) -> tuple[dict[str, Any], set[str], bool]:
    """Return the annotations of a class or function by argument, which it needs, and whether it takes others."""
    function = builder.__init__ if isinstance(builder, type) else builder  # a class may hide its own in a metaclass
    try:
        hints = get_type_hints(function, include_extras=True)
        parameters = list(inspect.signature(function).parameters.values())[isinstance(builder, type) :]
    except (NameError, TypeError, ValueError, AttributeError):  # another library's, that does not say
        return {}, set(), True
    named = [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    found, free = {p.name: hints.get(p.name, Any) for p in named}, False
    for rest in (hints.get(p.name) for p in parameters if p.kind is p.VAR_KEYWORD):
        # Unpack[a TypedDict], or Annotated[Any, a dataclass], say what else is taken; others take anything.
        inner = get_args(rest)
        found |= get_type_hints(inner[-1], include_extras=True) if inner else {}
        free = free or not inner
    return found, {p.name for p in named if p.default is p.empty}, free


def _check_group(
    given: Any, hints: Mapping[str, Any], key: str, found: dict[str, Any], required: Collection[str] = ()
) -> None:
    """Check the values of a group by annotations, and note those that become other ones."""
    if given is None:
        return
    if not isinstance(given, Mapping):
        raise ValueError(f"{key} is {_shown(given)}; allowed is a group of keys: correct it")
    try:
        asked = {name for name in hints if given.get(name, "???") != "???"} | {*required}
        adapter = _adapter(tuple((name, hint) for name, hint in hints.items() if name in asked), frozenset(required))
        values = adapter.validate_python(given)
    except ValidationError as error:
        raise ValueError(_in_words(error, given, key)) from None
    for name, fit in values.items():
        value = list(fit) if isinstance(fit, tuple) else fit
        if repr(value) != repr(given[name]):  # 10 equals 10.0
            found[f"{key}.{name}".lstrip(".")] = value


@cache
def _adapter(hints: tuple[tuple[str, Any], ...], required: frozenset[str]) -> TypeAdapter[dict[str, Any]]:
    fields = {name: (Required if name in required else NotRequired)[_checked(hint)] for name, hint in hints}
    group = TypedDict("group", fields)  # type: ignore[operator]
    group.__pydantic_config__ = ConfigDict(extra="ignore", coerce_numbers_to_str=True)
    return TypeAdapter(group)


def _checked(hint: Any) -> Any:
    """Return an annotation as pydantic is to read it: numbers that float32 holds, lists, groups with `_target_`."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    if kind in (int, float):
        return Annotated[int, BeforeValidator(_number)] if kind is int else Annotated[Any, PlainValidator(_number)]
    if kind is Annotated:
        if math.inf in options:
            return Annotated[Any, PlainValidator(partial(_number, endless=True))]
        limits = [AfterValidator(partial(_within, limit)) for limit in options if isinstance(limit, range)]
        return Annotated[(_checked(options[0]), *limits)] if limits else _checked(options[0])
    if kind in (Union, UnionType):
        return Union[tuple(map(_checked, options))]  # noqa: UP007
    if kind in (dict, Mapping) and options:
        return dict[_checked(options[0]), _checked(options[1])]  # type: ignore[misc]
    if kind in (list, Sequence, Collection, Iterable):
        return list[_checked(options[0])] if options else list  # type: ignore[misc]
    if kind is tuple:
        return tuple[tuple(option if option is Ellipsis else _checked(option) for option in options)]
    if is_typeddict(kind):
        made = TypedDict("group", {k: NotRequired[_checked(h)] for k, h in get_type_hints(kind).items()})  # type: ignore[operator]
        made.__pydantic_config__ = ConfigDict(extra="forbid")
        return made
    if kind in (bool, str, NoneType, Any, Literal, dict, object):
        return StrictBool if kind is bool else hint
    return Annotated[Any, PlainValidator(partial(_require_builder, hint))]


def _number(value: Any, endless: bool = False) -> Any:
    """Return a number that calculations stand, also from text."""
    if isinstance(value, str):
        with suppress(ValueError):
            value = int(value) if value.strip("+-").isdigit() else float(value.replace(".inf", "inf"))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("Input should be a number")
    if value != 0 and not (endless and value == math.inf) and not 1 / LARGEST <= abs(value) <= LARGEST:
        raise ValueError(f"Input should be a finite number, 0 or of size {1 / LARGEST:g} to {LARGEST:g}")
    return value


def _within(limits: range, value: float) -> float:
    if not limits.start <= value < limits.stop:
        raise ValueError(f"Input should be a number from {limits.start} to {limits.stop - 1}")
    return value


def _require_builder(hint: Any, value: Any) -> Any:
    """Return a group with `_target_` that builds what an annotation wants."""
    wanted = get_origin(hint) or hint
    if value == "???":
        return value
    if isinstance(value, Mapping) and "_target_" in value:
        builder = _builder(value, "")
        if value.get("_partial_"):
            result = get_args(hint)[-1] if get_args(hint) else None
            other = isinstance(builder, type) and isinstance(result, type) and not issubclass(builder, result)
            if wanted is Callable and not other:
                return value
        elif not isinstance(builder, type) or (isinstance(wanted, type) and issubclass(builder, wanted)):
            return value
    raise ValueError(f"Input should be a group with _target_ that makes a {getattr(wanted, '__name__', wanted)}")


def _builder(node: Mapping[str, Any], key: str) -> Any:
    """Return the class or function that a group names."""
    target = node["_target_"]
    try:
        if callable(found := pkgutil.resolve_name(target)):
            return found
        raise TypeError("it is nothing that can be called")
    except Exception as error:  # importing runs whatever module is named
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(
            f"{key}._target_ is {_shown(target)}, which cannot be imported ({reason}); allowed is the dotted path of "
            "a class or function: correct it, or install the package that it is in, or name its folder by PYTHONPATH"
        ) from error


def _in_words(error: ValidationError, given: Any, key: str) -> str:
    """Return the first place that is wrong, what stands there, and what is allowed, in one line."""
    found: dict[str, tuple[int, Any, list[str]]] = {}
    for each in error.errors(include_url=False):
        place, value, depth = key, given, 0
        for step in each["loc"]:  # among them are the options of a union, which are no keys
            if step in value if isinstance(value, Mapping) else isinstance(value, list) and isinstance(step, int):
                value, depth = value[step], depth + 1
                place = f"{place}[{step}]" if isinstance(step, int) else f"{place}.{step}".lstrip(".")
        if each["type"] == "missing" and depth < len(each["loc"]):
            return f"{place}.{each['loc'][-1]} is not given; give it, as conf/ does"
        if each["type"] == "extra_forbidden":
            return f"{place} does not exist; leave it out"
        words = re.sub(r"^(Value error, )?(Input should be )?", "", each["msg"])
        found.setdefault(place, (depth, value, []))[2].append(words)
    first = error.errors(include_url=False)[0]["loc"][0]
    own = {place: each for place, each in found.items() if re.match(rf"{re.escape(key)}\.?{first}\b", place)} or found
    place = max(own, key=lambda name: own[name][0])
    _, value, allowed = own[place]
    copied = isinstance(value, str) and re.fullmatch(r"[A-Z]{2,}", value)
    mend = f"{value} stands for a value of yours, so write that in its place" if copied else "correct it"
    return f"{place} is {_shown(value)}; allowed is {' or '.join(dict.fromkeys(allowed))}: {mend}"


def _shown(value: Any) -> str:
    """Return a value as a message shows it, in one short line."""
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
