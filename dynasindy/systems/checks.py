"""Whether a vector field is one: its rates have the shape of the states, keep the rows of a batch apart, are finite."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.limits import raise_if_memory
from dynasindy.systems.base import WHOLE, System
from dynasindy.text import unit_suffix

ALONG, INSIDE = 5, 32
"""Places that are tried along the range of each state, and at random within all ranges."""
APART = 1e-4
"""Share of the largest rate by which rows may differ when a batch is turned round, which is rounding."""
INNER = 0.98
"""Share of each range that is tried; a plant may end at its very ends."""


def rates_at_start(system: System, begins: Callable[[torch.Size], Tensor]) -> list[Tensor]:
    """Return the rates, `(*batch, n_x)`, of batches of states in which a system begins; see `rates` for errors.

    Neither shape is taken for states or inputs: `x[0]` fails where `x[..., 0]` was meant.
    """
    n_x, n_u = system.signature.n_x, system.signature.n_u
    starts = [begins(torch.Size(shape)) for shape in ((n_x + n_u + 3,), (2, 3))]
    return [_rates(system, x, x.new_zeros(*x.shape[:-1], n_u)) for x in starts]


def _rates(system: System, x: Tensor, u: Tensor) -> Tensor:
    """Return the rates of change, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""
    name = type(system).__name__
    wanted = (
        f"{tuple(x.shape)} of {x.dtype} for states of that shape and type and inputs {tuple(u.shape)}, each state as "
        "x[..., 0] and each input as u[..., 0]"
    )
    try:
        dx = system(x, u)
    except (RuntimeError, IndexError, ValueError, TypeError, AttributeError) as error:
        raise_if_memory(error)
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(f"system {name} failed ({reason}); it has to return {wanted}: mend it") from error
    given = f"{tuple(dx.shape)} of {dx.dtype}" if isinstance(dx, Tensor) else f"a {type(dx).__name__}"
    if not isinstance(dx, Tensor) or dx.shape != x.shape or dx.dtype != x.dtype:
        raise ValueError(f"system {name} returned {given}; it has to return {wanted}: mend it")
    return dx


def require_plant(system: System, begins: Callable[[torch.Size], Tensor], bounds: Tensor | None = None) -> None:
    """Refuse a plant whose rates of change are wrong, or are not finite where it begins; warn where they are not later.

    Args:
        system: The plant.
        begins: Returns states in which it begins, `(*batch, n_x)`, for a batch.
        bounds: Limits of its states, `(2, n_x)`, infinite where there is none; none is asked about beyond them. Of a
            state without limits the range is asked about, to both sides of zero, or of where it begins far from that.

    Raises:
        ValueError: The plant fails, returns another shape or type, mixes the rows of a batch, or is not finite in any
            place where it begins or in all places of its ranges.
    """
    _ = system.stops  # a system that was never built says so here
    with torch.no_grad():
        for dx in rates_at_start(system, begins):
            finite = dx.isfinite().flatten(0, -2).all(0).tolist()
            if bad := [name for name, ok in zip(system.signature.state_names, finite, strict=True) if not ok]:
                raise ValueError(
                    f"system {type(system).__name__} gives rates of change that are not finite, of {', '.join(bad)}, "
                    "where episodes begin; they have to be finite: mend the system or its constants"
                )
        x, u = sample_places(system, begins(torch.Size((1,)))[0], bounds)
        dx = _rates(system, x, u)
        turned = _rates(system, x.flip(0), u.flip(0)).flip(0)
    apart, largest = (of.nan_to_num(0.0, 0.0, 0.0).abs().amax(0) for of in (dx - turned, dx))
    if not (torch.equal(dx.isfinite(), turned.isfinite()) and bool((apart <= APART * largest).all())):
        raise ValueError(
            f"system {type(system).__name__} gives a row of a batch other rates of change when the rows change places; "
            "the rates of a row may depend on that row alone: write x[..., 0] and u[..., 0] for the first state and "
            "input, and draw nothing at random"
        )
    signature, lost = system.signature, ~dx.isfinite()
    rows = lost.any(-1)
    if not bool(rows.any()):
        return
    row = int(rows.int().argmax())
    which = ", ".join(name for name, here in zip(signature.state_names, lost[row].tolist(), strict=True) if here)
    states = zip(signature.state_names, x[row].tolist(), signature.state_units, strict=True)
    place = [f"{name} is {value:.3g}{unit_suffix(unit)}" for name, value, unit in states]
    place += [f"{name} is {value:.3g}" for name, value in zip(signature.input_names, u[row].tolist(), strict=True)]
    told = (
        f"system {type(system).__name__} gives rates of change that are not finite, of {which}, where "
        f"{', '.join(place)}, and at {int(rows.sum())} of {len(rows)} places that were tried within plant.bounds "
        "and the ranges of the states"
    )
    if bool(rows.all()):
        raise ValueError(f"{told}; they have to be finite: mend the system or its constants")
    warnings.warn(
        f"{told}; if the plant cannot be there, leave it out by plant.bounds, and if it can, mend the system",
        stacklevel=1,  # which names this package: where it is called from says nothing of the plant
    )


def sample_places(system: System, begin: Tensor, bounds: Tensor | None) -> tuple[Tensor, Tensor]:
    """Return states `(N, n_x)` within the ranges of a plant and inputs `(N, n_u)`: along each state, and at random."""
    n_x, n_u = system.signature.n_x, system.signature.n_u
    scale = torch.tensor(system.signature.x_scale, dtype=begin.dtype)
    home = begin.where(begin.abs() > scale, 0.0)
    low, high = home - scale, home + scale
    if bounds is not None:
        low, high = (torch.where(g.isfinite(), g.to(begin), e) for g, e in zip(bounds, (low, high), strict=True))
    middle, half = 0.5 * (low + high), 0.5 * INNER * (high - low)
    ways = torch.linspace(-1, 1, ALONG, dtype=begin.dtype).reshape(-1, 1, 1)
    along = torch.where(torch.eye(n_x, dtype=torch.bool), middle + half * ways, begin)
    generator = torch.Generator().manual_seed(0)
    inside = middle + half * (2 * torch.rand(INSIDE, n_x, generator=generator, dtype=begin.dtype) - 1)
    least, most = torch.tensor(system.signature.input_limits or (WHOLE,) * n_u, dtype=begin.dtype).mT
    drawn = least + (most - least) * torch.rand(INSIDE, n_u, generator=generator, dtype=begin.dtype)
    still = torch.zeros(n_x * ALONG, n_u, dtype=begin.dtype)
    return torch.cat([along.flatten(0, 1), inside]), torch.cat([still, drawn])
