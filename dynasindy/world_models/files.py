"""Save and load sparse models as JSON that a person can read."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.world_models.features import Feature
from dynasindy.world_models.library import Library
from dynasindy.world_models.tables import equations

FORMAT = "dynasindy sparse model 1"


def save(library: Library, coefficients: Tensor, path: str | Path) -> None:
    """Write signature, library, coefficients and the equations in words.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`.
        path: file to write.
    """
    signature, table = library.signature, coefficients.tolist()
    states = signature.state_names
    data = {
        "format": FORMAT,
        "equations": equations(library, coefficients),
        "signature": asdict(signature),
        "coefficients": {
            s: {n: table[k][i] for k, n in enumerate(library.names) if table[k][i]} for i, s in enumerate(states)
        },
        "library": {f.name(): f.to_list() for f in library.features},
    }
    Path(path).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def load(path: str | Path) -> tuple[Library, Tensor]:
    """Read a library and its coefficients, exact to the last digit.

    Args:
        path: file that `save` wrote.

    Returns:
        The library and Xi, `(n_features, n_x)` float64.

    Raises:
        ValueError: the file is not JSON, not of this format, or damaged.
        ValueError: the library uses a function that is not registered.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON ({error}); allowed is a file that SindyModel.save wrote") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f"{path} is not of the format {FORMAT!r}; allowed is a file that SindyModel.save wrote")
    try:
        return _model(data)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{path} is damaged ({type(error).__name__}: {error}); allowed is a file that "
            "SindyModel.save wrote: save it anew"
        ) from error


def _model(data: dict[str, Any]) -> tuple[Library, Tensor]:
    signature = Signature(**data["signature"])
    library = Library(signature, [_feature(f) for f in data["library"].values()])
    coefficients = torch.zeros(len(library), signature.n_x, dtype=torch.float64)
    for i, state in enumerate(signature.state_names):
        for name, value in data["coefficients"][state].items():
            coefficients[library.index(name), i] = value
    return library, coefficients


def _feature(factors: list[list[Any]]) -> Feature:
    if any(len(factor) != 4 for factor in factors):
        raise TypeError("a function has no variables, name, power and frequency")
    return Feature.from_list(factors)
