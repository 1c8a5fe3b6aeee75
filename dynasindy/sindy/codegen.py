"""A sparse model as code: torch, formulas with infix operators, machine code; it computes active functions only.

Words, numbers and equations are parts of other languages, too. Names of states and units come from files that anybody
wrote: none of them can become code, or end a comment. A comment holds neither end nor beginning of one, and a number is
a number before it is written.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from dynasindy.sindy.functions import TORCH_FUNCTIONS, function
from dynasindy.sindy.library import Factor, Library
from dynasindy.systems.integrators import moved
from dynasindy.systems.interpreter import MeasurementUpdate, simulate_program
from dynasindy.systems.machine import Program

if TYPE_CHECKING:
    from dynasindy.sindy.model import SindyModel

Field = Callable[[Tensor, Tensor], Tensor]


def generate(library: Library, coefficients: Tensor) -> Field:
    """Write and compile dx = Xi' Theta(x, u).

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

    Returns:
        `(x, u) -> dx`, `(*batch, n_x)`, with the library's `step` as an attribute.

    Raises:
        Diverged: a coefficient is not finite.
        ValueError: the model has more functions than can be written.
    """
    writer = _TorchWriter(library, library.require_finite(coefficients))
    source, values = writer.source(), writer.constants
    # As tensors of each dtype and device in use: an operation then need not make them each time.
    constants = cache(lambda dtype, device: tuple(torch.tensor(v, dtype=dtype, device=device) for v in values))
    scope: dict[str, Any] = {**TORCH_FUNCTIONS, "torch": torch, "constants": constants}
    exec(compile(source, "<field of a sparse model>", "exec"), scope)
    field: Field = scope["field"]
    field.__doc__ = source
    field.__dict__["step"] = library.step
    return field


Term = tuple[dict[Factor, int], float]  # powers of elementary functions, and the coefficient


class Writer:
    """Write sums of functions, in lines of code with infix operators; every value once, and formulas' own calls alone.

    Another language overrides how numbers and sums of two are written.

    Args:
        library: candidate functions of states and inputs, which are `x[0]`, ..., `u[0]`, ... in the code, as numbers
            are elements of `k`.
        coefficients: of each sum, `(n_features, n)`, as Xi; zeros cost nothing.

    Attributes:
        lines: names and formulas of values, each written once, in the order in which they are computed.
        results: the sums, in terms of these.

    Raises:
        ValueError: there are too many terms.
    """

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        signature, self.step = library.signature, library.step
        self.signature = signature
        self.lines, self.written, self.constants = list[tuple[str, str]](), dict[object, str](), list[float]()
        names = {"x": signature.state_names, "u": signature.input_names}
        self.variable = {name: f"{x}[{k}]" for x, of in names.items() for k, name in enumerate(of)}
        used = (coefficients != 0).any(-1).nonzero().flatten().tolist()
        table = zip(used, coefficients[used].tolist(), strict=True)
        terms = [({f.base: f.power for f in library.features[k].factors}, row) for k, row in table]
        sums = [[(powers, row[i]) for powers, row in terms if row[i]] for i in range(coefficients.shape[1])]
        try:
            self.results = [self._sum(each) if each else self._zero() for each in sums]
        except RecursionError as error:
            raise ValueError(
                f"the model has too many terms of {len(library)}; remove some: raise the threshold"
            ) from error

    def program(self) -> Program:
        """Return what was written, with the step of a difference equation."""
        text = tuple(self.lines), tuple(self.results)
        return Program(self.signature.n_x, self.signature.n_u, *text, tuple(self.constants), self.step)

    def _line(self, key: object, expression: str) -> str:
        if key not in self.written:
            self.written[key] = f"v{len(self.written)}"
            self.lines.append((self.written[key], expression))
        return self.written[key]

    def _constant(self, value: float) -> str:
        self.constants.append(value)
        return f"k[{len(self.constants) - 1}]"

    def _product(self, powers: dict[Factor, int]) -> str:
        value, key = "", frozenset[tuple[Factor, int]]()
        for factor, power in powers.items():
            key = key | {(factor, power)}
            one = self._power(factor, power)
            value = self._line(key, f"{value} * {one}") if value else one
        return value

    def _power(self, factor: Factor, power: int) -> str:
        if power < 0:
            return self._line((factor, power), f"1 / {self._power(factor, -power)}")
        if power == 1:
            return self._value(factor)
        half = power // 2
        return self._line((factor, power), f"{self._power(factor, power - half)} * {self._power(factor, half)}")

    def _value(self, factor: Factor) -> str:
        args = self._scaled(factor)
        if factor.function == "id":
            return args[0]
        return self._line(factor, function(factor.function).formula.format(*args))

    def _scaled(self, factor: Factor) -> list[str]:
        """Write the arguments of a factor's function."""
        args = [self.variable[v] for v in factor.variables]
        if function(factor.function).parametric:
            return [*args, self._constant(factor.frequency)]
        if factor.frequency == 1:
            return args
        frequency = self._constant(factor.frequency)
        return [self._line((a, factor.frequency), f"{a} * {frequency}") for a in args]

    def _sum(self, terms: list[Term]) -> str:
        """Write a sum; terms that share a function are summed before they are multiplied by it."""
        shared = self._shared(terms)
        if shared is None:
            return self._plain_sum(terms)
        group = [(p, c) for p, c in terms if shared in p]
        rest = [(p, c) for p, c in terms if shared not in p]
        power = min(p[shared] for p, _ in group)
        divided = [({f: left for f, n in p.items() if (left := n - power * (f == shared))}, c) for p, c in group]
        inner = self._sum(divided)
        factor = self._power(shared, power)
        if not rest:
            return self._line((inner, "*", factor), f"{inner} * {factor}")
        total = self._sum(rest)
        return self._line((total, inner, factor), self._plus_product(total, inner, factor))

    @staticmethod
    def _shared(terms: list[Term]) -> Factor | None:
        """Choose the function to take out of the brackets; none where a plain sum of powers is as short."""
        uses = Counter(f for p, _ in terms for f in p)
        if len(uses) < 2:
            return None
        # The most frequent function, cos(alpha_p) as a rule, stays inside: all brackets share its powers.
        powers = {f: len({p.get(f, 0) for p, _ in terms}) for f in uses}
        _, *others = sorted(uses, key=lambda f: (uses[f], powers[f]), reverse=True)
        repeated = [f for f in others if uses[f] > 1]
        return repeated[0] if repeated else None

    def _plain_sum(self, terms: list[Term]) -> str:
        constant = sum(c for p, c in terms if not p)
        products = [(self._product(p), c) for p, c in terms if p]
        if constant or not products:
            total = self._constant(constant)
            if not products:
                return self._line(("constant", constant), f"{self._zero()} + {total}")
        else:
            value, c = products.pop(0)
            total = value if c == 1 else self._line((value, c), f"{value} * {self._constant(c)}")
        for value, c in products:
            total = self._line((total, value, c), self._plus_scaled(total, value, c))
        return total

    def _zero(self) -> str:
        return "0.0"

    def _plus_product(self, total: str, a: str, b: str) -> str:
        return f"{total} + {a} * {b}"

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        return f"{total} + {self._constant(c)} * {value}"


class _TorchWriter(Writer):
    """Write torch code in as few operations as there can be."""

    def source(self) -> str:
        """Return the text of the function."""
        body = "".join(f"    {name} = {formula}\n" for name, formula in self.lines)
        return (
            "def field(x, u):\n"
            "    k, x, u = constants(x.dtype, x.device), x.unbind(-1), u.to(x.dtype).unbind(-1)\n"
            f"{body}    return torch.stack(({', '.join(self.results)},), 0).movedim(0, -1)\n"
        )

    def _zero(self) -> str:
        return "torch.zeros_like(x[0])"

    def _plus_product(self, total: str, a: str, b: str) -> str:
        return f"torch.addcmul({total}, {a}, {b})"

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        return f"torch.add({total}, {value}, alpha={c!r})"


@lru_cache(maxsize=4)
def _program_of(library: Library, coefficients: tuple[float, ...]) -> Program:
    """Return the program of a model; the same one is simulated from other states in turn."""
    xi = torch.tensor(coefficients, dtype=torch.float64)
    return Writer(library, xi.reshape(len(library), library.signature.n_x)).program()


def simulate(
    library: Library,
    coefficients: Tensor,
    x: Tensor,
    u: Tensor,
    dt: float,
    substeps: int,
    u_end: Tensor | None = None,
    update: MeasurementUpdate | None = None,
) -> Tensor:
    """Predict trajectories by instructions, so that nothing is compiled for a model; by torch code where they cannot.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`, finite.
        x: states at the start, `(rows, n_x)` float64.
        u: inputs at the start of each interval, `(rows, T, n_u)` float64.
        dt: length of an interval [s].
        substeps: Runge-Kutta steps in it.
        u_end: inputs at its end, see `Transitions`.
        update: what corrects the states after each interval.

    Returns:
        States at the end of each interval, `(rows, T, n_x)`, before they are corrected.
    """
    try:
        program = _program_of(library, tuple(coefficients.flatten().tolist()))
        return simulate_program(program, x, u, dt, substeps, u_end, update)[0]
    except (ValueError, OSError):
        pass  # there is no compiler, or a model of too many terms
    return advance(generate(library, coefficients), x, u, dt, substeps, u_end, update)


def advance(
    field: Field,
    x: Tensor,
    u: Tensor,
    dt: float,
    substeps: int,
    u_end: Tensor | None = None,
    update: MeasurementUpdate | None = None,
) -> Tensor:
    """Predict trajectories of a vector field by torch code, otherwise as `simulate`."""
    states = []
    for k in range(u.shape[1]):
        x = moved(field, x, u[:, k], dt, substeps, None if u_end is None else u_end[:, k])
        states.append(x)
        x = x if update is None else update.corrected(x, k)
    return torch.stack(states, 1)


PLAIN = str.maketrans({"°": "deg", "²": "^2", "³": "^3", "·": "*", "µ": "u"})


def comment(words: str) -> str:
    """Return words as they may stand within a comment of C or Python: ASCII, on one line, no end of a comment."""
    plain = words.translate(PLAIN).encode("ascii", "replace").decode()
    plain = re.sub(r"[\x00-\x1f\x7f\\?]", "_", plain)
    return re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)", " ", plain)


def number(value: float) -> str:
    """Return a number of double precision as C and Python write it, in brackets if it is negative.

    Raises:
        ValueError: It is not finite, or no number.
    """
    written = repr(float(value))
    if not math.isfinite(float(value)):
        raise ValueError(f"{written} stands where a finite number belongs; restore the file, or make it again")
    return f"({written})" if written.startswith("-") else written


def formulas(model: SindyModel) -> Program:
    """Return the rates of change of a model as formulas.

    Raises:
        ValueError: The model has too many terms.
    """
    return _FormulaWriter(model.library, model.coefficients).program()


def right_sides(model: SindyModel) -> Program:
    """Return the right sides of the equations as formulas: rates of change, or of a difference equation next states.

    Raises:
        ValueError: The model has too many terms.
    """
    return _FormulaWriter(*model.library.mapping(model.coefficients)).program()


class _FormulaWriter(Writer):
    """Write numbers where they are used."""

    def _constant(self, value: float) -> str:
        return number(value)

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        sign = "-" if c < 0 else "+"
        return f"{total} {sign} {number(abs(c))} * {value}" if abs(c) != 1 else f"{total} {sign} {value}"
