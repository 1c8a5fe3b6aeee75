"""What is known of the equations before the data: rows, coefficients, and functions that may not occur."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.sindy.library import Library
from dynasindy.text import did_you_mean


@dataclass(frozen=True)
class Constraints:
    """Hold prior knowledge as tensors.

    Attributes:
        free: coefficients to estimate, bool `(n_features, n_x)`.
        offset: coefficients that are given, float64 `(n_features, n_x)`, zero where free.
    """

    free: Tensor
    offset: Tensor

    @classmethod
    def build(
        cls,
        library: Library,
        known: Mapping[str, str],
        allowed: Mapping[str, Sequence[str]],
        fixed: Mapping[str, Mapping[str, float]],
        stated_in: str = "world_model.fixed",
    ) -> Constraints:
        """Translate names into tensors.

        Args:
            library: candidate functions.
            known: state to the function that is its rate, coefficient 1, e.g. `{"alpha_a": "Omega_a"}`.
            allowed: state to the functions that may occur in its equation; it goes before the library's own.
            fixed: state to functions with given coefficients.
            stated_in: key of the settings in which `fixed` stands, for messages.

        Raises:
            ValueError: a state or a function does not exist.
        """
        states = library.signature
        named: dict[str, Mapping[str, Iterable[str]]] = {
            "world_model.allowed": allowed,
            stated_in: fixed,
            "world_model.known": {state: [name] for state, name in known.items()},
        }
        for key, stated in named.items():
            if absent := sorted(map(str, set(stated) - set(states.state_names))):
                raise ValueError(
                    f"{key} names {', '.join(absent)}, which is no state; the states are "
                    f"{', '.join(states.state_names)}: correct the name{did_you_mean(absent[0], states.state_names)}"
                )
            for state, functions in stated.items():
                for name in functions:
                    _require(library, name, f"{key}.{state}")
        free = torch.ones(len(library), states.n_x, dtype=torch.bool)
        offset = torch.zeros(len(library), states.n_x, dtype=torch.float64)
        for state, names in {**library.allowed, **allowed}.items():
            free[:, states.state_index(state)] = False
            for name in names:
                free[library.index(name), states.state_index(state)] = True
        for state, given in fixed.items():
            for name, value in given.items():
                place = library.index(name), states.state_index(state)
                free[place], offset[place] = False, float(value)
        for state, name in known.items():
            i = states.state_index(state)
            free[:, i], offset[:, i] = False, 0.0
            offset[library.index(name), i] = 1.0
        return cls(free, offset)


def _require(library: Library, name: str, key: str) -> None:
    """Refuse a function that the library lacks, with the key of the settings that names it."""
    try:
        library.index(name)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
