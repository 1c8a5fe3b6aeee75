"""Trajectories and slopes of formulas that change with each call, as those of a fit do: nothing is compiled for them.

`dynasindy.systems.machine` compiles a vector field, which takes the time of thousands of its steps. Here formulas are a
list of instructions, each of which is done for many rows at once.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.systems.compiler import addresses, c_text, load_library
from dynasindy.systems.machine import Program
from dynasindy.systems.steps import steps_of
from dynasindy.systems.tangents import OPERATIONS, ExpressionGraph

WIDTH = 8
"""Rows that are handled at once."""


class MeasurementUpdate(NamedTuple):
    """Correct predicted states by what was measured, with a constant gain (as of a stationary Kalman filter).

    Attributes:
        measured: what was measured at the end of each period, `(rows, T, n_x)`, NaN where nothing was.
        gain: of what an end misses of it, `(n_x, n_x)`, which is added before the next period.
        free: row and column of each element of the gain by which to differentiate, too, `(2, G)`; None of none.
    """

    measured: Tensor
    gain: Tensor
    free: Tensor | None = None

    def corrected(self, x: Tensor, period: int) -> Tensor:
        """Return states after a period, `(rows, n_x)`, as the next one begins with them."""
        return x + (self.measured[:, period] - x).nan_to_num() @ self.gain.mT


def simulate_program(
    program: Program,
    x: Tensor,
    u: Tensor,
    dt: float,
    substeps: int,
    u_end: Tensor | None = None,
    update: MeasurementUpdate | None = None,
    xi: Tensor | None = None,
    shapes: Sequence[int | None] | None = None,
    parameters: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, Tensor]:
    """Advance states over periods that follow each other, by a vector field or a model that is sparse in functions.

    Args:
        program: formulas of the vector field; with coefficients those of the functions of dx/dt = Xi' Theta(x, u).
        x: states at the start of the first period, `(rows, n_x)` float64.
        u: inputs at the start of each period, `(rows, T, n_u)` float64.
        dt: length of a period [s].
        substeps: Runge-Kutta steps in it; a difference equation has its own.
        u_end: inputs at the end of each period, see `Transitions`.
        update: what corrects the states after each period.
        xi: coefficients, `(n_functions, n_x)`.
        shapes: places among the program's constants of the numbers by which to differentiate, None of one that it
            lacks.
        parameters: function and state of each coefficient by which to differentiate, `(P,)` int64 both; without them
            nothing is differentiated.

    Returns:
        States at the end of each period, `(rows, T, n_x)`, before they are corrected, and their derivatives by the
        states x, the fitted elements of the gain, the shapes and the coefficients, `(rows, T, n_x, n_x + G + S + P)`.

    Raises:
        ValueError: a formula holds something that is none, or the compiler refuses the instructions' text.
        FileNotFoundError: there is no compiler.
    """
    xi = torch.eye(program.n_x, dtype=torch.float64) if xi is None else xi
    own_shapes = None if shapes is None else (*shapes,)
    listing = _Listing(replace(program, constants=(), step=None), len(program.constants), own_shapes)
    steps = steps_of(program.step, dt, substeps)
    n_x, n_shapes, (rows, periods, n_u) = program.n_x, listing.shapes, u.shape
    features, states = (xi != 0).nonzero(as_tuple=True)
    rates = torch.stack([states, listing.functions[features]]).int(), xi[features, states]
    by_state, state_places = _summed(xi, listing.by_state, n_x)
    by_shape, shape_places = _summed(xi, listing.by_shape, max(n_shapes, 1))
    sums = [part for to, by in (rates, by_state, by_shape) for part in (to.shape[1], to, by)]
    sums += [part for places in (state_places, shape_places) for part in (places.shape[1], places)]
    constants = torch.tensor([*program.constants, *listing.numbers], dtype=torch.float64)
    fitted = torch.zeros(2, 0) if update is None or update.free is None else update.free
    own = torch.zeros(2, 0).int() if parameters is None else torch.stack(parameters).int()
    columns = 0 if parameters is None else n_x + fitted.shape[1] + n_shapes + own.shape[1]
    sizes = (n_x, n_u, len(constants), listing.values, len(xi), n_shapes, own.shape[1])
    stages = 4 * (len(xi) + state_places.shape[1] + shape_places.shape[1] + 3 * n_x)
    room = x.new_empty((listing.values + stages + n_x * (steps.number + 1 + 3 * columns)) * WIDTH)
    ends, slopes = x.new_empty(rows, periods, n_x), x.new_empty(rows, periods, n_x, columns)
    whole = [None if part is None else part.contiguous() for part in (x, u, u_end)]
    correction = [None, None] if update is None else [v.double().contiguous() for v in (update.measured, update.gain)]
    arguments = [
        *(*map(ctypes.c_long, (rows, periods)), *sizes, *map(ctypes.c_long, (listing.first, len(listing.code)))),
        *(listing.code, listing.functions.int(), *sums, own, constants, ctypes.c_double(steps.h), steps.number),
        *(int(steps.difference), *whole, ends, slopes if columns else None, room, *correction),
        *(fitted.shape[1], fitted.int()),
    ]
    _library().simulate(*(addresses(part)[0] if torch.is_tensor(part) else part for part in arguments))
    return ends, slopes


def _summed(xi: Tensor, slopes: Tensor, width: int) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Return how slopes of rates are sums of `slopes` of functions, and the rates and variables of those not zero."""
    if not slopes.numel():  # as of trajectories alone, which are many and short
        none = torch.zeros(2, 0, dtype=torch.int32)
        return (none, xi.new_zeros(0)), none
    function, variable, place = slopes
    each, state = (xi[function] != 0).nonzero(as_tuple=True)
    keys, to = (state * width + variable[each]).unique(return_inverse=True)
    places = torch.stack([keys // width, keys % width]).int()
    return (torch.stack([to, place[each]]).int(), xi[function[each], state]), places


@cache
def _library() -> ctypes.CDLL:
    text = c_text("systems", "interpreter.c")
    return load_library(text.replace("@width@", str(WIDTH)), fast=True)


@lru_cache(maxsize=512)
class _Listing:
    """Instructions of functions and, unless `shapes` is None, of their slopes, which stand last; each value once.

    `code` is `(N, 4)`: operation, operands and result; the `first` ones compute the `functions`. `by_state` and
    `by_shape` are function, variable and place of each slope that is not zero, `(3, n)`.
    """

    def __init__(self, program: Program, constants: int, shapes: tuple[int | None, ...] | None) -> None:
        n_x, known = program.n_x, [f"x[{i}]" for i in range(program.n_x)] + [f"u[{j}]" for j in range(program.n_u)]
        variables: dict[str, int | None] = dict.fromkeys(known)
        if shapes is not None:
            variables |= {f"x[{i}]": i for i in range(n_x)}
            variables |= {f"k[{k}]": n_x + s for s, k in enumerate(shapes) if k is not None}
        graph = ExpressionGraph(variables, program.lines, program.results)
        values, slopes = graph.needed(graph.results), graph.needed(place for *_, place in graph.entries)
        leaves = [graph.nodes[place][0] for place in dict.fromkeys((*values, *slopes)) if not graph.nodes[place][1]]
        self.numbers = tuple(float(text) for text in leaves if text[0] not in "xuk")
        known += [*(f"k[{k}]" for k in range(constants)), *map(repr, self.numbers)]
        places, code = {graph.node(text): k for k, text in enumerate(known)}, list[tuple[int, int, int, int]]()
        for place in (*values, *slopes):
            operation, operands = graph.nodes[place]
            if place not in places:
                code.append((OPERATIONS.index(operation), places[operands[0]], places[operands[-1]], len(places)))
                places[place] = len(places)
        self.first, self.values = sum(bool(graph.nodes[place][1]) for place in values), len(places)
        self.functions = torch.tensor([places[place] for place in graph.results])
        table = torch.tensor([(k, v, places[place]) for k, v, place in graph.entries]).reshape(-1, 3).long()
        self.by_state = table[table[:, 1] < n_x].mT
        self.by_shape = (table[table[:, 1] >= n_x] - torch.tensor([0, n_x, 0])).mT
        self.shapes, self.code = len(shapes or ()), torch.tensor(code, dtype=torch.int32).reshape(-1, 4)
