"""Save and load sparse models as JSON that a person can read."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.safe_io import write_json
from dynasindy.sindy.equations import equations
from dynasindy.sindy.functions import FunctionError, formula_texts, is_registered, register_formula, unregister_formulas
from dynasindy.sindy.library import Constraints, Feature, Library
from dynasindy.systems.base import Signature

FORMAT = "dynasindy sparse model 1"
LARGEST = 20_000_000
"""Size beyond which no model is read [bytes]; that of a plant here has 30 000."""
LARGEST_SYSTEM = 200
"""Number of states beyond which a model is taken for damaged."""
LARGEST_FACTOR = 1000
"""Numbers of a coefficient's correlations beyond which it is as well."""
Known = tuple[Tensor, Tensor, Tensor]
"""Places of coefficients in Xi, two `(P,)`, and a factor of their covariance, `(P, K)`."""
Model = tuple[Library, Tensor, Constraints, float, Known | None]


def save_model(
    library: Library,
    coefficients: Tensor,
    path: str | Path,
    constraints: Constraints | None = None,
    delay: float = 0.0,
    covariance: Known | None = None,
) -> None:
    """Write signature, library, coefficients, constraints, how well they are known, and the equations in words.

    Coefficients are of rates of change; a `step` [s] says that they are those of a difference equation.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`.
        path: file to write.
        constraints: what is known of the equations; nothing by default.
        delay: time between an input and its effect [s].
        covariance: which coefficients' covariance is known, and its factor.
    """
    data = model_record(library, coefficients, constraints, delay, covariance)
    write_json(path, data, indent=1, finite=False)


def model_record(
    library: Library,
    coefficients: Tensor,
    constraints: Constraints | None = None,
    delay: float = 0.0,
    covariance: Known | None = None,
) -> dict[str, Any]:
    """Return what `save_model` writes, as keys and values."""
    signature, table = library.signature, coefficients.tolist()
    states = signature.state_names
    data: dict[str, Any] = {
        "format": FORMAT,
        "equations": equations(library, coefficients),
        "signature": asdict(signature),
        "coefficients": {
            s: {n: table[k][i] for k, n in enumerate(library.names) if table[k][i]} for i, s in enumerate(states)
        },
        "library": {f.name(): f.to_list() for f in library.features},
    }
    if own := formula_texts(factor.function for feature in library.features for factor in feature.factors):
        data["functions"] = own
    if delay:
        data["delay"] = delay
    if library.step is not None:
        data["step"] = library.step
    if constraints is not None and not bool(constraints.free.all()):
        data["constraints"] = {s: _constraint(library, constraints, i) for i, s in enumerate(states)}
    if covariance is not None and len(covariance[0]):
        data["uncertainty"] = _uncertainty(library, *covariance)
    return data


def load_model(path: str | Path) -> Model:
    """Read a library, its coefficients and its constraints, exact to the last digit.

    Args:
        path: file that `save_model` wrote.

    Returns:
        The library, Xi, `(n_features, n_x)` float64, what is known of the equations, the delay of the inputs [s], and
        the covariance of coefficients; without a word of them in the file, nothing, 0 and None.

    Raises:
        FileNotFoundError: the file does not exist.
        ValueError: the file cannot be read, is too large, not JSON, not of this format, or damaged.
        FunctionError: the library uses a function that is not registered and of which the file has no formula, or one
            that is another function here.
    """
    try:
        if Path(path).stat().st_size > LARGEST or Path(path).is_fifo():
            raise ValueError(f"it is a pipe, or larger than {LARGEST} bytes")
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON ({error}); allowed is a file that SindyModel.save wrote") from error
    return parse_record(data, path)


def parse_record(data: object, path: str | Path) -> Model:
    """Return what `load_model` does, from keys and values.

    Args:
        data: what `model_record` returned.
        path: where it is from, for the message.

    Raises:
        ValueError: it is not of this format, or damaged.
        FunctionError: the library uses a function that is not registered and of which the data has no formula, or one
            that is another function here.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f"{path} is not of the format {FORMAT!r}; allowed is a file that SindyModel.save wrote")
    try:
        return _model(data)
    except FunctionError as error:
        why = f"{path} cannot be used here: {error}"
        if name := error.missing:
            why = (
                f"{path} uses the function {name!r}, which was saved without a formula and is not known here; in "
                f"Python, call register_function({name!r}, ...), or import the module that does, before loading. So "
                f"that commands can read it, too, save it again after register_function({name!r}, ..., formula=...)"
            )
        raise FunctionError(why, error.missing) from error
    except (ArithmeticError, AttributeError, IndexError, KeyError, RuntimeError, TypeError) as error:
        raise ValueError(
            f"{path} is damaged ({type(error).__name__}: {error}); allowed is a file that "
            "SindyModel.save wrote: save it anew"
        ) from error


def _constraint(library: Library, constraints: Constraints, state: int) -> dict[str, Any]:
    free, offset = constraints.free[:, state].tolist(), constraints.offset[:, state].tolist()
    return {
        "free": [name for name, may in zip(library.names, free, strict=True) if may],
        "given": {name: value for name, value in zip(library.names, offset, strict=True) if value},
    }


def _constraints(library: Library, data: dict[str, Any] | None) -> Constraints:
    shape = (len(library), library.signature.n_x)
    if data is None:
        return Constraints(torch.ones(shape, dtype=torch.bool), torch.zeros(shape, dtype=torch.float64))
    free, offset = torch.zeros(shape, dtype=torch.bool), torch.zeros(shape, dtype=torch.float64)
    for i, state in enumerate(library.signature.state_names):
        for name in data[state]["free"]:
            free[library.index(name), i] = True
        for name, value in data[state]["given"].items():
            offset[library.index(name), i] = _number(value)
    return Constraints(free, offset)


def _uncertainty(library: Library, features: Tensor, places: Tensor, factor: Tensor) -> dict[str, Any]:
    """Return standard errors, and rows of the factor of their correlations, a line of numbers each."""
    names, states = library.names, library.signature.state_names
    # The triangular factor of the same covariance has no more columns than there are coefficients.
    factor = torch.linalg.qr(factor.mT, mode="r")[1].mT
    factor = factor * factor.diagonal().sign().where(factor.diagonal() != 0, 1.0)
    errors = factor.norm(dim=-1)
    rows = (factor / errors.clamp_min(1e-300).unsqueeze(-1)).tolist()
    told: dict[str, Any] = {"standard_errors": {s: {} for s in states}, "correlation_factor": {s: {} for s in states}}
    each = zip(features.tolist(), places.tolist(), errors.tolist(), rows, strict=True)
    for k, (feature, state, error, row) in enumerate(each):
        told["standard_errors"][states[state]][names[feature]] = error
        told["correlation_factor"][states[state]][names[feature]] = " ".join(map(repr, row[: k + 1]))
    return told


def _covariance(library: Library, data: dict[str, Any] | None) -> Known | None:
    if data is None:
        return None
    features, states, errors, rows = [], [], [], []
    for i, state in enumerate(library.signature.state_names):
        for name, error in data["standard_errors"][state].items():
            features.append(library.index(name))
            states.append(i)
            errors.append(_number(error))
            rows.append(torch.tensor(_numbers(data["correlation_factor"][state][name]), dtype=torch.float64))
    if not rows or any(not 0 < len(row) <= LARGEST_FACTOR for row in rows) or min(errors) < 0:
        raise TypeError("its uncertainty has no standard errors of 0 or more, each with its correlations")
    sizes = torch.tensor(errors, dtype=torch.float64).unsqueeze(-1)
    return torch.tensor(features), torch.tensor(states), sizes * torch.nn.utils.rnn.pad_sequence(rows, batch_first=True)


def _model(data: dict[str, Any]) -> Model:
    new = [name for name in data.get("functions", {}) if not is_registered(name)]
    try:
        for name, formula in data.get("functions", {}).items():
            register_formula(name, formula)
        return _parts(data)
    except Exception:  # any: a file that is damaged leaves nothing behind
        unregister_formulas(new)
        raise


def _parts(data: dict[str, Any]) -> Model:
    signature = _signature(data["signature"])
    step = data.get("step")
    if step is not None and (step := _number(step)) < 0:
        raise TypeError(f"the step of its difference equation is {step} s, which is negative")
    library = Library(signature, [_feature(f) for f in data["library"].values()], step=step)
    coefficients = torch.zeros(len(library), signature.n_x, dtype=torch.float64)
    place = {name: k for k, name in enumerate(library.names)}
    for i, state in enumerate(signature.state_names):
        for name, value in data["coefficients"][state].items():
            coefficients[place[name] if name in place else library.index(name), i] = _number(value)
    with torch.no_grad():  # a function with other arguments than it takes fails here, not in the middle of a run
        library(torch.ones(1, signature.n_x, dtype=torch.float64), torch.ones(1, signature.n_u, dtype=torch.float64))
    if (delay := _number(data.get("delay", 0.0))) < 0:
        raise TypeError(f"its delay is {delay} s, which is negative")
    constraints = _constraints(library, data.get("constraints"))
    return library, coefficients, constraints, delay, _covariance(library, data.get("uncertainty"))


def _numbers(written: str) -> list[float]:
    try:
        return [_number(float(number)) for number in written.split()]
    except ValueError as error:
        raise TypeError(f"{written[:40]!r} stands where numbers belong") from error


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:40]!r} stands where a finite number belongs")
    return float(value)


def _signature(words: dict[str, Any]) -> Signature:
    if not all(isinstance(given, list) for given in words.values()) or len(words["state_names"]) > LARGEST_SYSTEM:
        raise TypeError(f"its signature is no lists of names, units and ranges of up to {LARGEST_SYSTEM} states")
    return Signature(**words)


def _feature(factors: list[list[Any]]) -> Feature:
    if any(len(factor) not in (4, 5) or not isinstance(factor[0], list) for factor in factors):
        raise TypeError("a function has no variables, name, power and frequency")
    return Feature.from_list([[*factor[:3], *map(_number, factor[3:])] for factor in factors])
