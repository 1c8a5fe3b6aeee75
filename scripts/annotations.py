"""Whether a value of a config fits an annotation of the constructor that it goes to, and what would."""

import math
import pkgutil
import re
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

LARGEST = 1e19
"""Squares of larger numbers, and of numbers smaller than its inverse, are no float32."""


def made(node: Mapping[str, Any], key: str) -> Any:
    """Return the class or function that a group names."""
    target = node["_target_"]
    try:
        if not isinstance(target, str):
            raise TypeError("it is no text")
        if callable(found := pkgutil.resolve_name(target)):
            return found
        raise TypeError("it is nothing that can be called")
    except Exception as error:  # importing runs whatever module is named
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(
            f"{key}._target_ is {shown(target)}, which cannot be imported ({reason}); allowed is the dotted path of "
            "a class or function: correct it, or install the package that it is in, or name its folder by PYTHONPATH"
        ) from error


def fit(value: Any, hint: Any, key: str) -> Any:
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
            inner = math.inf if endless else fit(value, options[0], key)
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
            inner = value | {k: fit(value[k], h, f"{key}.{k}") for k, h in hints.items() if k in value}
    elif kind in (list, tuple, Sequence, Collection, Iterable):
        fixed = kind is tuple and Ellipsis not in options
        if fits := isinstance(value, list) and (not fixed or len(value) == len(options)):
            hints = options if fixed else [options[0] if options else Any] * len(value)
            inner = [fit(v, h, f"{key}[{i}]") for i, (v, h) in enumerate(zip(value, hints))]
    else:
        fits = not isinstance(kind, type)  # a class or a callable wants a group with `_target_`
    if not fits:
        raise _misfit(value, hint, key)
    return inner


def _one_of(value: Any, hint: Any, key: str) -> Any:
    """Fit a value to the first option of a union that takes it."""
    for option in get_args(hint):
        with suppress(ValueError):
            return fit(value, option, key)
    others = [option for option in get_args(hint) if option is not types.NoneType]
    if len(others) == 1 and isinstance(value, (list, dict)):
        fit(value, others[0], key)  # names the place in the list that is wrong
    raise _misfit(value, hint, key)


def _misfit(value: Any, hint: Any, key: str) -> ValueError:
    """Return the error of a value that an annotation does not allow; one in capitals was copied from an example."""
    copied = isinstance(value, str) and re.fullmatch(r"[A-Z]{2,}", value)
    mend = f"{value} stands for a value of yours, so write that in its place" if copied else "correct it"
    return ValueError(f"{key} is {shown(value)}; allowed is {words(hint)}: {mend}")


def _builds(node: Mapping[str, Any], hint: Any, key: str) -> bool:
    """Return whether a group with `_target_` may build what an annotation wants."""
    builder, kind = made(node, key), get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return any(_builds(node, option, key) for option in get_args(hint))
    if node.get("_partial_"):
        wanted = get_args(hint)[-1] if get_args(hint) else None
        other = isinstance(builder, type) and isinstance(wanted, type) and not issubclass(builder, wanted)
        return kind is Callable and not other
    if not isinstance(builder, type):
        return True
    return isinstance(kind, type) and not is_typeddict(kind) and issubclass(builder, kind)


def _number(value: Any) -> float | None:
    """Return a number that calculations stand, also from text; None for all else."""
    if isinstance(value, str):
        with suppress(ValueError):
            value = int(value) if value.strip("+-").isdigit() else float(value)
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


def shown(value: Any) -> str:
    """Return a value as a message shows it, in one short line, of a group first what it builds."""
    if isinstance(value, dict) and "_target_" in value:
        value = {"_target_": value["_target_"], **value}
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def words(hint: Any) -> str:
    """Say what an annotation allows."""
    kind, options = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
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
    names |= {types.NoneType: "null"}
    return names.get(kind) or f"a group with _target_, a {getattr(kind, '__name__', kind)}"
