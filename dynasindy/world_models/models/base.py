"""A world model is a system that is fitted."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from dynasindy.systems.base import System
from dynasindy.systems.transitions import Transitions

Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def whole(*names: str) -> Callable[[Callable[Given, Returned]], Callable[Given, Returned]]:
    """Return a decorator of methods that succeed as a whole: where one raises, named attributes are as before it.

    Args:
        names: attributes that the method replaces by others. What it changes inside of them stays changed.
    """

    def _of(method: Callable[Given, Returned]) -> Callable[Given, Returned]:
        @wraps(method)
        def _called(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
            before = {name: getattr(args[0], name) for name in names}
            try:
                return method(*args, **kwargs)
            except BaseException:
                for name, value in before.items():
                    setattr(args[0], name, value)
                raise

        return _called

    return _of


class WorldModel(System):
    """A vector field with the signature of the plant whose transitions it is fitted to.

    Attributes:
        delay: Time between an input of the plant and its effect [s]. The field itself is that of the inputs as they
            take effect.
    """

    delay: float = 0.0

    @property
    def additive(self) -> bool:
        """Whether `update` with new transitions equals `fit` to all of them, and `absorb` is known."""
        return False

    def update(self, transitions: Transitions) -> Any:
        """Fit anew to all earlier data and to new transitions, and return a report.

        Raises:
            NotImplementedError: The model keeps no sums of earlier data.
        """
        raise NotImplementedError(f"{type(self).__name__} is fitted to all transitions at once; use fit")

    def absorb(self, transitions: Transitions) -> None:
        """Add transitions to the data of the next `update`, and leave the model as it is.

        Raises:
            NotImplementedError: The model keeps no sums of earlier data.
        """
        raise NotImplementedError(f"{type(self).__name__} is fitted to all transitions at once; use fit")

    def kept(self) -> Callable[[], object]:
        """Return what takes the model back to what it has learnt so far, its `state_dict`, when called."""
        return partial(self.load_state_dict, copy.deepcopy(self.state_dict()))

    @abstractmethod
    def fit(self, transitions: Transitions) -> Any:
        """Fit to transitions, forgetting earlier data, and return a report."""

    @abstractmethod
    def equations(self, digits: int = 4) -> list[str]:
        """Return one readable equation per state."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write the model to a readable file."""
