"""What a config may hold: the annotations of what it builds are its schema, checked before anything is built.

A run folder may be anybody's: its config.yaml holds plain settings, and parts of the package or of a plug-in to build.
What a user composes himself, from conf/ or --config-dir, is his own, and may build anything.
"""

import inspect
import math
import os
import pkgutil
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml
from cli import CONF
from command import nodes, unknown_name
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError, InterpolationToMissingValueError
from pydantic import BeforeValidator, Field, PlainValidator, StrictBool, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from typing_extensions import is_typeddict

from dynasindy.envs.references import Signal
from dynasindy.identification.source import DataSource
from dynasindy.safe_io import read_text, reading
from dynasindy.sindy import WorldModel
from dynasindy.sindy.functions import register_function
from dynasindy.systems import System

SIZE, DEPTH = 250_000, 20
"""Size [bytes] and depth that a config.yaml may have; those of runs have 3000 and 6. Deep ones take YAML minutes."""
PARTS = re.compile(
    r"dynasindy\.((systems|envs|sindy|planning|agents|dyna\.experiment"
    r"|evaluation\.(scenarios|disturbances|ablation))\.(\w+\.)*[A-Z]\w*"
    r"|sindy\.named_libraries\.[a-z]\w*|evaluation\.scenarios\.step_references|envs\.references\.(target|wave))"
)
"""The classes and functions of the package that an experiment is made of."""
FOREIGN = (".Foreign", ".GymnasiumEnv")
"""Parts that look an environment up by its id."""
PLUGINS = "DYNASINDY_PLUGINS"
"""Environment variable that names packages of plug-ins, with commas or spaces between them."""
GIVEN = {"signature", "dt", "system", "task", "n_u", "n_obs", "env", "agent", "replay", "policy", "x", "u", "x_next"}
"""Arguments that an experiment hands to what a config builds with `_partial_`."""
Seconds = Annotated[float, Field(gt=0, le=1e5)]
LARGEST = 1e19
"""Squares of larger numbers, and of numbers smaller than its inverse, are no float32."""
TOP: dict[str, Any] = {
    "seed": Annotated[int, range(2**63)],
    "threads": Annotated[int, range(1, 8 * (os.cpu_count() or 1) + 1), "eight for each core"],
    **{"system": System | None, "world_model": Callable[..., WorldModel], "data": DataSource},
    **dict.fromkeys(("evaluation", "checkpoint", "scenario", "guard", "level", "plant"), dict[str, Any]),
    **dict.fromkeys(("run", "resume", "controller"), str | None),
    **dict.fromkeys(("folder", "results", "output", "device", "refinement", "error_shape"), str),
    **dict.fromkeys(("integral", "animate", "finish", "tensorboard"), bool),
    **dict.fromkeys(("evaluation.must_improve", "evaluation.must_control"), bool),
    **{"plugins": list[str], "scenarios": Annotated[list[str], Field(min_length=1)], "plant.outputs": list[str]},
    "formats": list[Literal["png", "svg", "pdf", "eps", "jpg", "jpeg", "tif", "tiff", "webp"]],
    **{"source": Literal["simulated", "logged"], "plant.libraries": dict[Literal["simulated", "logged"], str]},
    "longest_delay": Annotated[float, Field(ge=0)] | None,
    **{"evaluation.every": Annotated[int, Field(ge=1)], "checkpoint.every": Annotated[int, Field(ge=0)]},
    **{"evaluation.within": Annotated[float, Field(gt=0)], "dt": Seconds, "seconds": Seconds | None, "flights": int},
    **{"targets": Annotated[list[list[float]], Field(min_length=1)] | None, "planner": dict[str, Any] | None},
    **dict.fromkeys(("plant.low", "plant.high"), list[float]),
    **dict.fromkeys(("plant.known", "plant.functions"), dict[str, str] | None),
    **dict.fromkeys(("plant.amplitude", "plant.offset"), float | list[float]),
    **{"plant.start": dict[str, float | list[float]] | None, "plant.bounds": dict[str, float | list[float]]},
    **{"plant.initial": dict[str, dict[str, float]] | None, "plant.noise": dict[str, float] | None},
    **{"plant.rates": list[str | None], "plant.first": float},
    **{"plant.sensors": dict[str, dict[str, float]], "plant.signals.step": list[list[float]]},
    **{"plant.signals.sine": Signal, "plant.signals.square": Signal, "fmi": Literal[2, 3]},
}
"""Keys of any command's config, besides those of what it builds, and those whose types import TorchRL.

What a group copies from the plant is checked there first, and a mistake is named as the plant's by `command`.
"""
EXPORTING: dict[str, Any] = {"formats": list[Literal["c", "onnx", "fmu", "model"]]}
"""What keys of export allow beside those of other commands."""


def read_config(file: Path) -> DictConfig:
    """Return the settings of a run's config.yaml: small and plain YAML, without tags, aliases and interpolations."""
    text, depth = read_text(file, SIZE), 0
    with reading(file):
        try:
            for event in yaml.parse(text, Loader=yaml.SafeLoader):
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                anchor, tag, value = (getattr(event, name, None) for name in ("anchor", "tag", "value"))
                if anchor or tag or "${" in (value or "") or depth > DEPTH:  # an alias has an anchor, too
                    raise ValueError(f"line {event.start_mark.line + 1} is no plain key and value, as runs write them")
            return OmegaConf.merge({}, OmegaConf.create(text))  # which takes keys and values alone
        except (yaml.YAMLError, AssertionError) as error:  # OmegaConf asserts that a text is no single number
            raise ValueError(str(error) or "it does not hold keys and values") from error


def plugins_of(cfg: DictConfig) -> tuple[str, ...]:
    """Return the word of a command line that names the packages of the user's own parts; none where there are none."""
    built = [node for _, node in nodes(OmegaConf.to_container(cfg, resolve=True)) if "_target_" in node]
    named = [name for node in built for name in (str(node["_target_"]), _module(node))]
    own = sorted({name.partition(".")[0] for name in named} - {"dynasindy", ""})
    return (f"plugins=[{','.join(own)}]",) if own else ()


def require_trusted(tree: Any, plugins: Sequence[str] = ()) -> None:
    """Refuse settings, as plain containers, that would build anything but a part of the package or of a plug-in.

    Plug-ins are packages that the user names, to the command and in the environment.
    """
    named = re.split(r"[,\s]+", ",".join([*plugins, os.environ.get(PLUGINS, "")]))
    for key, node in nodes(tree):
        if why := _distrust(node, ["dynasindy", *filter(None, named)], key):
            raise ValueError(f"{key and f'{key}.'}{why}")


def _distrust(node: Mapping[Any, Any], packages: Sequence[str], key: str) -> str:
    """Return what in a group no run writes, or what it would build that is not trusted, and what is allowed instead.

    Nothing outside of the packages is imported to find out.
    """
    for word, value in node.items():
        if str(word).startswith("_") and word != "_target_" and not (word == "_partial_" and isinstance(value, bool)):
            return f"{word}: {_shown(value)}, which no run writes: remove it"
    if "_target_" not in node:
        return ""
    by_name = f"plug-ins that you trust and name, as by plugins=[PACKAGE,OTHER] or {PLUGINS}=PACKAGE,OTHER"
    target, module = node["_target_"], _module(node)
    package = next((name for name in packages if str(target).startswith(f"{name}.")), "")
    plain = package and re.fullmatch(r"[^\W\d_]\w*(\.[^\W\d_]\w*)+", target)
    if not plain or not is_part(_builder(node, key), package):
        return f"_target_: {_shown(target)}, which is no part; allowed are parts of dynasindy, and of {by_name}"
    if module and module.partition(".")[0] not in packages:
        return f"id: {_shown(node['id'])}, which imports {module[:40]!r}; allowed are environments of {by_name}"
    options = node.get("options") or {} if target.endswith(FOREIGN) else {}
    for value in options.values() if isinstance(options, Mapping) else [options]:
        if not (value is None or isinstance(value, int | float)):  # it may be the name of a file to read
            return f"options with {_shown(value)}; allowed are numbers, true and false"
    return ""


def _module(node: Mapping[Any, Any]) -> str:
    """Return the module that Gymnasium imports for an environment, as `gymnasium.make("module:Name-v0")` does."""
    module, colon, _ = str(node.get("id")).partition(":")
    return module if colon and str(node.get("_target_")).endswith(FOREIGN) else ""


def is_part(part: Any, package: str) -> bool:
    """Return whether an object is a class or a function of the package itself, and one that experiments are made of."""
    if not (inspect.isclass(part) or inspect.isfunction(part)) or part.__qualname__ != part.__name__:
        return False
    place = f"{part.__module__}.{part.__name__}"
    return bool(PARTS.fullmatch(place)) if package == "dynasindy" else place.startswith(f"{package}.")


def check(cfg: DictConfig, file: str = "", plugins: Sequence[str] = ()) -> None:
    """Check every value of a composed config, and make text of numbers where text belongs.

    One that was read from a `file`, a finished run's, has all parts of an experiment, and is not trusted.
    """
    raw: Any = OmegaConf.to_container(cfg, resolve=False)
    if isinstance(raw.get("system"), dict) and raw["system"].keys() & {"system", "plant"}:
        raise ValueError("the file of the plant lacks its header: let '# @package _global_' be its first line")
    if not file:  # settings of a plant that nothing reads are refused; what a run read is all that its file holds
        conf = repr(raw) + " ".join(file.read_text() for file in CONF.rglob("*.yaml"))
        read = {"plant.functions", "plant.libraries", *re.findall(r"\bplant(?:\.\w+)+", conf)}
        groups = dict(nodes({"plant": raw.get("plant")}))
        for group in ("plant", "plant.signals"):
            allowed = {key.split(".")[group.count(".") + 1] for key in read if key.startswith(f"{group}.")}
            for name in [str(name) for name in groups.get(group, ()) if name not in allowed]:
                raise ValueError(unknown_name(name, allowed, group))
    try:
        tree: Any = OmegaConf.to_container(cfg, resolve=True)
        if "train" not in tree and not file and (tree.get("data") or {}).get("path"):
            tree.pop("excitation", None)  # nothing is excited where there is a log, and its classes import TensorDict
        if file:
            require_trusted(raw, plugins)
        for key, value, hint in _values(tree, bool(file)):
            fit = _fit(value, hint, key)
            if repr(fit) != repr(value):  # 10 equals 10.0
                OmegaConf.update(cfg, key, fit, merge=False)
        for name, formula in ((tree.get("plant") or {}).get("functions") or {}).items():
            register_function(name, formula)  # of the user's own, which the library of the plant may hold
    except InterpolationToMissingValueError:  # a log's config names no plant yet, and the command says which there are
        return
    except InterpolationResolutionError as error:
        lacking = re.search(r"^Interpolation key '(.+)' not found$", str(error), re.M)
        what = lacking[1] if lacking else f"a group of keys, from which {error.full_key} is taken,"
        raise ValueError(f"{file}: {what} is not given; give it as conf/ does".removeprefix(": ")) from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}".removeprefix(": ")) from error


def _values(tree: Any, finished: bool) -> Iterator[tuple[str, Any, Any]]:
    """Yield the values of all groups, parts before what holds them, each with its key and with what it has to be.

    Of a group with a `_target_`, the annotations of what it builds say that. TorchRL is imported where it is needed.
    """
    top = TOP | (EXPORTING if "fmi" in tree else {}) | ({"folder": str | None} if "run" in tree else {})
    if "train" in tree or finished:  # elsewhere a plant has words for the task of an experiment, which is not built
        from dynasindy.dyna.experiment import Recipe

        parts = get_type_hints(Recipe)
        for name in sorted(parts.keys() - tree.keys() - {"sensors"}) if finished else ():
            raise ValueError(f"'{name}' is not given; restore it, or train again")
        top = parts | top
    for group, node in reversed([*nodes(tree)]):
        hints = {key.rpartition(".")[2]: hint for key, hint in top.items() if key.rpartition(".")[0] == group}
        if "_target_" in node:
            hints, required, free = parameters(_builder(node, group))
            given = [str(name) for name in node if not str(name).startswith("_")]
            for name in () if free else [name for name in given if name not in hints]:
                raise ValueError(unknown_name(name, hints.keys() - GIVEN, group))
            for name in sorted(required - {*given} - (GIVEN if node.get("_partial_") else set())):
                raise ValueError(f"{group}.{name} is not given; give it, as conf/ does")
        for name, value in node.items():
            if name in hints and value != "???":
                yield f"{group}.{name}".lstrip("."), value, hints[name]


@cache
def parameters(builder: Any) -> tuple[dict[str, Any], set[str], bool]:
    """Return the annotations of a class or function by argument, which it needs, and whether it takes others."""
    # A class may hide its own in a metaclass, or inherit those of a dataclass of pydantic, whose `__init__` has none.
    hidden = isinstance(builder, type) and "__pydantic_fields__" not in vars(builder)
    function = builder.__init__ if hidden else builder
    try:
        # Fields of a dataclass may be inherited from another module, whose names are known to the class alone.
        hints = get_type_hints(builder if is_dataclass(builder) else function, include_extras=True)
        parameters = list(inspect.signature(function).parameters.values())[hidden:]
    except (NameError, TypeError, ValueError, AttributeError):  # another library's, that does not say
        return {}, set(), True
    named = [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    found = {p.name: hints.get(p.name, Any) for p in named}
    # Unpack[a TypedDict], or Annotated[Any, a dataclass], say what else is taken; others take anything.
    rest = [get_args(hints.get(p.name)) for p in parameters if p.kind is p.VAR_KEYWORD]
    for *_, inner in filter(None, rest):
        found |= get_type_hints(inner, include_extras=True)
    return found, {p.name for p in named if p.default is p.empty}, () in rest


def _fit(value: Any, hint: Any, key: str) -> Any:
    """Return a value as an annotation wants it; one that is wrong is named, with what is allowed, in one line."""
    try:
        fit = ADAPTER(hint).validate_python(value)
        return list(fit) if isinstance(fit, tuple) else fit
    except ValidationError as error:
        found: dict[tuple[Any, ...], tuple[Any, list[str]]] = {}
        for each in error.errors(include_url=False):
            place, at = (), value
            for step in each["loc"]:  # among them are the options of a union, which are no keys
                if step in at if isinstance(at, Mapping) else isinstance(at, list) and step in range(len(at)):
                    place, at = (*place, step), at[step]
            plain = re.sub("Value error, |Input should be |List should have | after validation, .*", "", each["msg"])
            words = {"extra_forbidden": "no such key", "missing": "one value more", "dict_type": "a group of keys"}
            found.setdefault(place, (at, []))[1].append(words.get(each["type"], plain))
        place, (at, allowed) = max(found.items(), key=lambda item: len(item[0]))
        where = key + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
        raise ValueError(
            f"{where}={_shown(at)}; allowed is {' or '.join(dict.fromkeys(allowed))}: correct it"
        ) from None


def _checked(hint: Any) -> Any:
    """Return an annotation as pydantic is to read it: numbers that float32 holds, lists, groups with `_target_`."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    kind = {Mapping: dict, Sequence: list, Collection: list, Iterable: list, UnionType: Union}.get(kind, kind)
    if kind is Annotated:
        inner = Endless if math.inf in options else _checked(options[0])
        limits = [Field(ge=each.start, lt=each.stop) for each in options if isinstance(each, range)]
        limits += [each for each in options if isinstance(each, FieldInfo)]
        return Annotated[(inner, *limits)] if limits else inner
    if kind in (Union, dict, list, tuple) and options:
        return kind[tuple(each if each is Ellipsis else _checked(each) for each in options)]
    if kind in (NoneType, Any, Literal, object, dict, list, tuple) or is_typeddict(kind):
        return hint
    return PLAIN.get(kind, Annotated[Any, PlainValidator(partial(_require_builder, hint))])


def _number(value: Any, endless: bool = False) -> Any:
    """Return a number that calculations stand."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("Input should be a number")
    if value != 0 and not (endless and value == math.inf) and not 1 / LARGEST <= abs(value) <= LARGEST:
        raise ValueError(f"Input should be a finite number, 0 or of size {1 / LARGEST:g} to {LARGEST:g}")
    return value


Endless = Annotated[Any, PlainValidator(partial(_number, endless=True))]
PLAIN: dict[Any, Any] = {
    int: Annotated[int, BeforeValidator(_number)],
    float: Annotated[Any, PlainValidator(_number)],
    str: Annotated[str, Field(coerce_numbers_to_str=True)],
    bool: StrictBool,
}
"""Types of values, and how pydantic is to read them."""
ADAPTER = cache(lambda hint: TypeAdapter(_checked(hint)))


def _require_builder(hint: Any, value: Any) -> Any:
    """Return a group with `_target_` that builds what an annotation wants."""
    wanted = get_origin(hint) or hint
    if isinstance(value, Mapping) and "_target_" in value:
        builder, later = _builder(value, ""), bool(value.get("_partial_"))
        made = (get_args(hint) or (Any,))[-1] if later else wanted
        differs = isinstance(builder, type) and isinstance(made, type) and not issubclass(builder, made)
        if not differs and (wanted is Callable or not later):
            return value
    raise ValueError(f"Input should be a group with _target_ that makes a {getattr(wanted, '__name__', wanted)}")


def _builder(node: Mapping[str, Any], key: str) -> Any:
    """Return the class or function that a group names."""
    try:
        if callable(found := pkgutil.resolve_name(str(node["_target_"]))):
            return found
        raise TypeError("it is nothing that can be called")
    except Exception as error:  # importing runs whatever module is named
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        hint = "give the dotted path of a class or function, install its package, or name its folder by PYTHONPATH"
        if str(node["_target_"]).startswith("dynasindy."):  # a run of an earlier version may name what is gone
            hint = "it is no part of this version: correct it, or give what CHANGELOG.md says of it"
        raise ValueError(f"{key}._target_={_shown(node['_target_'])} cannot be imported ({reason}); {hint}") from error


def _shown(value: Any) -> str:
    """Return a value as a message shows it, in one short line."""
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
