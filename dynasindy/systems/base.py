"""What moves: a vector field in SI units, batched in torch."""

from __future__ import annotations

import math
import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from dynasindy.systems.machine import Machine
from dynasindy.systems.steps import Stops
from dynasindy.systems.tracing import program
from dynasindy.text import did_you_mean, unit_suffix

NAME = re.compile(r"[^\W\d][\w .'-]{0,59}")
PRECISIONS = (torch.float32, torch.float64)
"""Kinds of numbers that machine code computes in."""
WHOLE = (-1.0, 1.0)
"""Ends and limits of an input that has no others."""
UNIT = re.compile(r"[\w°%^*/().\- ²³·µ]{1,30}")
ALIKE = 1e-5
"""Part of an input's range by which ends may differ and still be the same, as those are that were written down."""
Ends = float | Sequence[float]
"""A number, or the two ends of a range."""


@dataclass(frozen=True)
class Signature:
    """Names, units and ranges of a system's states and inputs.

    A plant and the models fitted to it share one signature; tasks, libraries and figures find states by it.

    Attributes:
        state_names: One name per state, in the order of `x`.
        state_units: One unit per state, e.g. "rad".
        input_names: One name per input, in the order of `u`.
        x_scale: Typical range of each state, in its unit; observations are states divided by it.
        input_ends: What -1 and 1 are of each input in the unit of its actuator, e.g. `((-12, 12),)` of a motor in V;
            empty where inputs have no other unit.
        input_limits: Least and largest value of each input, within [-1, 1], e.g. `((0, 1),)` of a motor that takes 0 to
            12 V; empty where all go from -1 to 1.
        input_units: The unit of each actuator, in words, e.g. `("V",)`; empty where none is known.

    Raises:
        ValueError: The lengths disagree, a name is none or occurs twice, a unit is none, a range is not positive and
            finite, or ends or limits of an input are not finite and in order.
    """

    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_names: tuple[str, ...]
    x_scale: tuple[float, ...]
    input_ends: tuple[tuple[float, float], ...] = ()
    input_limits: tuple[tuple[float, float], ...] = ()
    input_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field in ("state_names", "state_units", "input_names", "x_scale", "input_units"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        if not len(self.state_names) == len(self.state_units) == len(self.x_scale):
            raise ValueError(
                f"a signature was given {len(self.state_names)} state names, {len(self.state_units)} units and "
                f"{len(self.x_scale)} ranges; give one unit and one range per state"
            )
        names: tuple[Any, ...] = self.state_names + self.input_names
        units: tuple[Any, ...] = self.state_units + self.input_units  # of files, which may hold anything
        if len(set(names)) != len(names):
            raise ValueError(f"state and input names must differ, got {names}; rename the repeated one")
        # Names and units come from files and end up in tables, figures and files: they are words, not text of any kind.
        for words, pattern, what, allowed in (
            (names, NAME, "name", "a letter or '_', then letters, digits, '_', ' ', '.', '-' and \"'\", 60 at most"),
            (units, UNIT, "unit", "up to 30 letters, digits and '°%^*/().- ', or '-' for none"),
        ):
            if wrong := [word for word in words if not isinstance(word, str) or not pattern.fullmatch(word)]:
                raise ValueError(
                    f"{str(wrong[0])[:60]!r} is no {what} of a state or an input; allowed are {allowed}: correct it"
                )
        if not all(0 < scale < math.inf for scale in self.x_scale):
            raise ValueError(
                f"x_scale must be positive and finite, got {self.x_scale}; give the typical range of each state"
            )
        for field, most in (("input_ends", math.inf), ("input_limits", 1.0)):
            pairs = tuple((float(low), float(high)) for low, high in getattr(self, field))
            object.__setattr__(self, field, pairs)
            sound = all(low < high and math.isfinite(high - low) and max(-low, high) <= most for low, high in pairs)
            if not sound or len(pairs) not in (0, len(self.input_names)):
                what = "ends" if field == "input_ends" else "limits"
                raise ValueError(
                    f"the {what} of the inputs are {pairs}; give a lower and a higher number for each of "
                    f"{', '.join(self.input_names)}{'' if most == math.inf else ', within [-1, 1]'}, or none at all"
                )
        if len(self.input_units) not in (0, len(self.input_names)):
            raise ValueError(
                f"the units of the inputs are {self.input_units}; give one for each of {', '.join(self.input_names)}, "
                "or none at all"
            )

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.state_names)

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return len(self.input_names)

    def alike(self, other: Signature) -> bool:
        """Return whether another signature has the same names and units; ranges may differ."""
        return replace(self, x_scale=other.x_scale) == other if self.n_x == other.n_x else False

    def with_state(self, name: str, unit: str, scale: float = 1.0) -> Signature:
        """Return the signature with one state more, behind the others.

        Args:
            name: Its name.
            unit: Its unit.
            scale: Its typical range [unit].

        Raises:
            ValueError: There is such a state or input already, or the unit or the range is none.
        """
        return replace(
            self,
            state_names=(*self.state_names, name),
            state_units=(*self.state_units, unit),
            x_scale=(*self.x_scale, scale),
        )

    def state_limits(self, given: Mapping[str, Ends], key: str = "plant.bounds") -> Tensor:
        """Return lower and upper limits of states, `(2, n_x)`, infinite where there is none.

        Args:
            given: Limits by state: one for both sides of zero, or both ends.
            key: Setting in which they were given.

        Raises:
            ValueError: One is of no state, or is no range.
        """
        both = {name: [-v, v] if isinstance(v, int | float) else v for name, v in given.items()}
        free = torch.tensor([[-math.inf], [math.inf]], dtype=torch.float64).expand(-1, self.n_x)
        return self._put(both, key, free.clone())

    def start_ranges(self, given: Mapping[str, Ends], key: str = "plant.start") -> Tensor:
        """Return the ends of the range in which states begin, `(2, n_x)`; those that are not named begin at zero.

        Args:
            given: Where they begin, by state: a value, or the two ends of a range.
            key: Setting in which that was given.

        Raises:
            ValueError: One is of no state, or is no range.
        """
        return self._put(given, key, torch.zeros(2, self.n_x))

    def require_start_within(
        self, start: Tensor, bounds: Tensor, names: Collection[str] | None = None, group: str = "plant"
    ) -> None:
        """Refuse limits that exclude where a plant begins: it would leave them with the first period of every try.

        Args:
            start: Ends of the range in which states begin, `(2, n_x)`.
            bounds: Their limits, `(2, n_x)`, infinite where there is none.
            names: States that are looked at; all if omitted.
            group: Group of settings in which `start` and `bounds` were given.

        Raises:
            ValueError: A state begins outside of its limits.
        """
        low, high = bounds.to(start)
        outside = ((start < low) | (start > high)).any(0).tolist()
        for name, out, begin, ends in zip(self.state_names, outside, start.T.tolist(), bounds.T.tolist(), strict=True):
            if out and (names is None or name in names):
                raise ValueError(
                    f"{group}.start has {name} at {' to '.join(f'{value:g}' for value in dict.fromkeys(begin))}, and "
                    f"{group}.bounds are {ends[0]:g} to {ends[1]:g}; allowed is a start within the bounds: "
                    "correct either"
                )

    def _put(self, given: Mapping[str, Ends], key: str, ends: Tensor) -> Tensor:
        for name, value in given.items():
            pair = [value, value] if isinstance(value, int | float) else list(value)
            if name not in self.state_names or len(pair) != 2 or not -math.inf < pair[0] <= pair[1] < math.inf:
                hint = "" if name in self.state_names else did_you_mean(name, self.state_names)
                raise ValueError(
                    f"{key} has {name}: {value}; name one of the states {', '.join(self.state_names)}, with a value or "
                    f"the two ends of a range{hint}"
                )
            ends[:, self.state_index(name)] = torch.tensor(pair).to(ends)
        return ends

    def rate_unit(self, name: str) -> str:
        """Return the unit of the rate of a state."""
        unit = self.state_units[self.state_index(name)]
        if power := re.fullmatch(r"(.*/s)(?:\^(\d))?", unit):
            return f"{power[1]}^{int(power[2] or 1) + 1}"
        return "1/s" if unit == "-" else f"{unit}/s"

    def with_rates(self, known: Mapping[str, str]) -> Signature:
        """Return the signature with rates that are known to belong to a state and are no states yet, behind the others.

        Args:
            known: The rate of each state, by its name; other equations add nothing.
        """
        signature = self
        for name, rate in known.items():  # a rate may be a state that has a rate
            if name in signature.state_names and rate not in signature.state_names and rate.isidentifier():
                signature = signature.with_state(rate, signature.rate_unit(name))
        return signature

    def own_inputs(self, ranged: bool = True) -> list[str]:
        """Say what each input is in the unit of its actuator, a line for each that has one.

        Args:
            ranged: Whether its range is said, too; it need not be that of a controller, which may stay within less.
        """
        limits = self.input_limits or (WHOLE,) * self.n_u
        units = [*map(unit_suffix, self.input_units or ("-",) * self.n_u)]
        lines = []
        for name, (low, high), unit, (least, most) in zip(
            self.input_names, self.input_ends, units, limits, strict=False
        ):
            if (low, high) == WHOLE:
                continue
            rest, one = 0.5 * (low + high), 0.5 * (high - low)
            zero = f"{rest:.6g}{unit} + " if rest else ""
            within = f", which is in [{least:.6g}, {most:.6g}]" if ranged else ""
            lines.append(f"the plant's {name} is {zero}{one:.6g}{unit} times the controller's{within}")
        return lines

    def headings(self, names: Sequence[str]) -> list[str]:
        """Return headings of a table over time: `time [s]`, `alpha_a [rad]`, `reference_alpha_a [rad]`, `u_a [-]`."""
        units = {"time": "s"}
        for name, unit in zip(self.state_names, self.state_units, strict=True):
            units = {f"reference_{name}": unit, f"predicted_{name}": unit} | units | {name: unit}
        return [f"{name} [{units.get(name, '-')}]" for name in names]

    def in_own_units(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return inputs of [-1, 1], `(*batch, n_u)`, in the units of their actuators."""
        low, high = np.array(self.input_ends or (WHOLE,) * self.n_u).T
        return 0.5 * (low + high) + 0.5 * (high - low) * np.asarray(u, dtype=np.float64)

    @property
    def input_ranges(self) -> NDArray[np.float64]:
        """What -1 and 1, and the limits, are of each input in its own unit, `(n_u, 4)`."""
        limits = np.array(self.input_limits or (WHOLE,) * self.n_u)
        return np.concatenate([np.array(self.input_ends or (WHOLE,) * self.n_u), self.in_own_units(limits.T).T], -1)

    def same_input_ranges(self, other: Signature) -> bool:
        """Tell whether inputs have the same ends as those of another plant, up to the digits in which a note tells."""
        count = min(self.n_u, other.n_u)
        mine, theirs = self.input_ranges[:count], other.input_ranges[:count]
        return bool((np.abs(mine - theirs) <= ALIKE * (mine[:, 1:2] - mine[:, :1])).all())

    def state_index(self, name: str, key: str = "a setting") -> int:
        """Return the position of a state in `x`.

        Args:
            name: Its name.
            key: Setting that has it, for the error.

        Raises:
            ValueError: No state has that name.
        """
        if name not in self.state_names:
            hint = did_you_mean(name, self.state_names)
            raise ValueError(f"{key} names '{name}', which is no state; they are {', '.join(self.state_names)}{hint}")
        return self.state_names.index(name)


def sample_states(ends: Tensor, batch: torch.Size, generator: torch.Generator) -> Tensor:
    """Return states between their ends `(2, n_x)`, `(*batch, n_x)`; nothing is drawn where every range is one value."""
    low, high = ends
    if torch.equal(low, high):
        return low.expand(*batch, -1).clone()
    return low + (high - low) * torch.rand(*batch, len(low), generator=generator)


class System(nn.Module, ABC):
    """A vector field dx/dt = f(x, u) under inputs normalised to [-1, 1].

    A system computes in the dtype and on the device of `x`. Constants are Python floats; tensors are buffers
    in float64, cast where they are used.

    Args:
        signature: Names, units and ranges of states and inputs.
        stops: Mechanical stops of the plant, if any.
    """

    known: bool = True
    """Whether it has equations; a simulator of another library has none."""
    machine_code: bool = False
    """Whether states are moved by machine code, where a C compiler is found. A class says so for itself, if `forward`
    can be read (`dynasindy.systems.tracing`) and the numbers in it change by setting its attributes alone."""

    def __init__(self, signature: Signature, stops: Stops | None = None) -> None:
        super().__init__()
        self.signature = signature
        self.stops = stops
        self._machines: dict[object, Machine | None] = {}

    def extra_repr(self) -> str:
        """Return its states and inputs, for `repr`."""
        states = self.signature.headings(self.signature.state_names)
        return f"{', '.join(states)} under {', '.join(self.signature.input_names)}"

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s], see `dynasindy.systems.steps`; None of dx/dt = f(x, u)."""
        return None

    @property
    def followers(self) -> dict[int, int]:
        """Places of states that no sensor sees and that follow another state, and of that; at rest they are equal."""
        return {}

    @abstractmethod
    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""

    def compiled(self, x: Tensor, u: Tensor) -> Machine | None:
        """Return machine code that does what `forward` does for such states and inputs; None where there is none."""
        if not (self.machine_code and "machine_code" in vars(type(self))) or x.dtype not in PRECISIONS:
            return None
        n_x, n_u = self.signature.n_x, self.signature.n_u
        return self._machine(
            x, u, lambda dtype: Machine(replace(program(self.forward, n_x, n_u), step=self.step), dtype)
        )

    def _machine(self, x: Tensor, u: Tensor, make: Callable[[torch.dtype], Machine]) -> Machine | None:
        """Return machine code for such states and inputs; what cannot be made is not tried again before a change."""
        if "forward" in vars(self) or self._forward_hooks or self._forward_pre_hooks:
            return None  # its class does not say what it does
        if x.dtype not in self._machines:
            code = None
            try:
                code = make(x.dtype)
            except FileNotFoundError:
                pass  # there is no compiler
            except TypeError as error:
                raise TypeError(
                    f"{type(self).__name__} says machine_code = True, but {error}; leave machine_code out of the "
                    "class, which then stays torch code, or write forward with what dynasindy.systems.tracing reads"
                ) from error
            except (ValueError, OSError) as error:
                warnings.warn(f"{type(self).__name__} stays torch code, which is slower: {error}", stacklevel=3)
            self._machines[x.dtype] = code
        found = self._machines[x.dtype]
        return found if found is not None and found.fits(x, u) else None

    def __getattr__(self, name: str) -> Any:
        """Return a part of the module; say what is missing where its class never began to build it.

        Raises:
            AttributeError: There is no such attribute.
            TypeError: The class does not call `super().__init__`.
        """
        if "_modules" not in self.__dict__ and not name.startswith("__"):
            raise TypeError(
                f"system {type(self).__name__} has no {name}, since its __init__ does not call super().__init__; begin "
                "it with super().__init__(signature), in which signature is a Signature of its states and inputs"
            )
        return super().__getattr__(name)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; machine code that another value was read into is forgotten."""
        super().__setattr__(name, value)
        if not name.startswith("_") and name != "training":
            self.__dict__["_machines"] = {}

    def __getstate__(self) -> dict[str, object]:
        """Leave machine code out of copies and pickles; it is made again when needed."""
        return {**self.__dict__, "_machines": {}}


class Altered(System):
    """A system made of another one, `system`, with its states, inputs and stops, that moves in steps where that does.

    Args:
        system: The other one.
    """

    def __init__(self, system: System) -> None:
        super().__init__(system.signature, system.stops)
        self.system = system

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s]; None of a differential equation."""
        return self.system.step


TURNS = {
    **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180),
    **{"mrad": 1e-3, "cdeg": math.pi / 18_000, "mdeg": math.pi / 180_000, "gon": math.pi / 200},
    **dict.fromkeys(("rev", "turn", "turns"), 2 * math.pi),
}
"""Units of angles that are not rad, in rad."""


def turn_of(unit: str) -> float:
    """Return how much one turn is in a unit of angles, such as 360 deg; infinite in any other unit."""
    return 2 * math.pi if unit == "rad" else 2 * math.pi / TURNS[unit] if unit in TURNS else math.inf


class Diverged(ArithmeticError):
    """Numbers that are not finite where a run cannot go on from them.

    The message is one line: the phase, what went wrong in it and with which numbers, and what to do. No setting is
    impossible in itself, as with a `ValueError`; it is how the run went that leaves no usable result. Whoever raises
    it leaves networks, models and storages as they were before, so that what was good may still be saved.
    """
