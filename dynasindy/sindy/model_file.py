"""Sparse models as keys and values, which a person can read in their JSON file."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.safe_io import reading
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.equations import equations
from dynasindy.sindy.functions import FunctionError, formula_texts, is_registered, register_formula, unregister_formulas
from dynasindy.sindy.library import Constraints, Feature, Library
from dynasindy.systems.base import Signature

FORMAT = "dynasindy sparse model 1"
LARGEST_SYSTEM = 200
"""Number of states beyond which a model is taken for damaged."""
LARGEST_FACTOR = 1000
"""Numbers of a coefficient's correlations beyond which it is as well."""
Model = tuple[Library, Tensor, Constraints, float, Covariance | None]
"""The library, Xi `(n_features, n_x)`, what is known of it before the data, the delay [s], and how well it is known."""


def model_record(
    library: Library, coefficients: Tensor, constraints: Constraints, delay: float, covariance: Covariance | None
) -> dict[str, Any]:
    """Return signature, library, coefficients, constraints, how well they are known, and the equations in words.

    Coefficients are of rates of change; a `step` [s] says that they are those of a difference equation.
    """
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
    if not bool(constraints.free.all()):
        rows = zip(states, constraints.free.mT.tolist(), constraints.offset.mT.tolist(), strict=True)
        data["constraints"] = {
            s: {
                "free": [name for name, may in zip(library.names, free, strict=True) if may],
                "given": {name: value for name, value in zip(library.names, offset, strict=True) if value},
            }
            for s, free, offset in rows
        }
    if covariance is not None:
        data["uncertainty"] = _uncertainty(library, *covariance)
    return data


def parse_record(data: object, source: str | Path) -> Model:
    """Return the parts of a model, exact to the last digit, from what `model_record` returned.

    Args:
        data: the record.
        source: where it is from, for the message.

    Raises:
        DamagedFileError: it is not of this format, or damaged.
        FunctionError: the library uses a function that is not registered and of which the data has no formula, or one
            that is another function here.
    """
    with reading(source):
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise ValueError(f"it is not of the format {FORMAT!r} that SindyModel.save writes")
        new = [name for name in data.get("functions", {}) if not is_registered(name)]
        try:
            for name, formula in data.get("functions", {}).items():
                register_formula(name, formula)
            return _parts(data)
        except BaseException as error:  # any: a file that is damaged leaves nothing behind
            unregister_formulas(new)
            if isinstance(error, RuntimeError):  # of torch, or of too many brackets
                raise ValueError(str(error)) from error
            if not isinstance(error, FunctionError):
                raise
            why = f"{source} cannot be used here: {error}"
            if name := error.missing:
                why = (
                    f"{source} uses the function {name!r}, which was saved without a formula and is not known here; in "
                    f"Python, call register_function({name!r}, ...), or import the module that does, before loading. "
                    f"So that commands can read it, too, save it again after register_function({name!r}, ..., "
                    "formula=...)"
                )
            raise FunctionError(why, error.missing) from error


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


def _covariance(library: Library, data: dict[str, Any] | None) -> Covariance | None:
    if data is None:
        return None
    features, states, errors, rows = [], [], [], []
    for i, state in enumerate(library.signature.state_names):
        for name, error in data["standard_errors"][state].items():
            features.append(library.index(name))
            states.append(i)
            errors.append(_number(error))
            numbers = data["correlation_factor"][state][name].split()
            rows.append(torch.tensor([_number(float(number)) for number in numbers], dtype=torch.float64))
    if not rows or any(not 0 < len(row) <= LARGEST_FACTOR for row in rows) or min(errors) < 0:
        raise TypeError("its uncertainty has no standard errors of 0 or more, each with its correlations")
    sizes = torch.tensor(errors, dtype=torch.float64).unsqueeze(-1)
    factor = sizes * torch.nn.utils.rnn.pad_sequence(rows, batch_first=True)
    return Covariance(torch.tensor(features), torch.tensor(states), factor)


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
