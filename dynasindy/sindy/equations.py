"""Write Xi for readers, as equations."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.library import Feature, Library, of, variable
from dynasindy.systems.base import Diverged

NEAR = 0.5
"""Part of the smaller of two numbers below which their sum shows that they nearly cancel."""
CANCELLED = 1e-9
"""Part of its own change that is left of a state, below which nothing is."""


def equations(library: Library, coefficients: Tensor, digits: int = 4) -> list[str]:
    """Write one equation per state.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`.
        digits: significant digits.

    Returns:
        Lines such as `Omega_p' = -0.414 Omega_p + 0.0013 omega_p`; of a difference equation such as
        `p[k+1] = p + v + 0.0015 force`, all on the right at k.
    """
    library, coefficients = mapping(library, coefficients)
    lines = []
    for i, state in enumerate(library.signature.state_names):
        groups: dict[str, list[tuple[str, float]]] = {}
        for feature, value in _without_cancelling(
            dict(zip(library.features, coefficients[:, i].tolist(), strict=True))
        ):
            if value:
                quotient = " ".join(f.text() for f in feature.factors if f.function in QUOTIENTS)
                above = " ".join(f.text() for f in feature.factors if f.function not in QUOTIENTS) or "1"
                groups.setdefault(quotient, []).append((above if quotient else feature.name(), value))
        written = format_sum(groups.pop("", []), digits)
        for quotient, terms in groups.items():
            # What is divided by the same is written over it once.
            above, sign = format_sum(terms, digits), ""
            if len(terms) > 1:
                above = f"({above})"
            elif above.startswith("-"):
                above, sign = above[1:], "-"
            joint = (" - " if sign else " + ") if written else sign
            written += f"{joint}{above} {quotient}"
        lines.append(f"{library.left_side(state)} = {written or '0'}")
    return lines


def _without_cancelling(terms: dict[Feature, float]) -> list[tuple[Feature, float]]:
    """Return terms of which none outside of a quotient nearly cancels one within: both as one, over the quotient.

    With q = 1 + k cos^2 a sum c f + d f / q is ((c + d) f + c k f cos^2) / q.
    """
    for feature, within in [*terms.items()]:
        for factor in [f for f in feature.factors if f.function in QUOTIENTS and f.power == 1]:
            rest = Feature(tuple(f for f in feature.factors if f != factor))
            outside = terms.get(rest, 0.0)
            if abs(within + outside) < NEAR * min(abs(within), abs(outside)):
                cosine = of(factor.function.replace("per_cos2", "cos"), *factor.variables, power=2)
                more = rest * cosine * Feature((factor,))
                terms |= {rest: 0.0, feature: within + outside}
                terms[more] = terms.get(more, 0.0) + outside * factor.frequency
    return [*terms.items()]


def mapping(library: Library, coefficients: Tensor) -> tuple[Library, Tensor]:
    """Return what stands on the right of the equations: of a difference equation x[k] + step Xi' Theta, as one sum.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`: rates of change.

    Returns:
        The library, with the states themselves where it is one of a difference equation, and the coefficients of the
        right sides.
    """
    step = library.step
    if step is None:
        return library, coefficients
    names = library.signature.state_names
    whole = Library(library.signature, [*map(variable, names), *library.features], step=step)
    table = torch.zeros(len(whole), len(names), dtype=coefficients.dtype)
    place = {feature.key: k for k, feature in enumerate(whole.features)}
    rows = [place[feature.key] for feature in library.features]
    table[rows] = step * coefficients
    for i, name in enumerate(names):
        own = place[variable(name).key]
        rate = float(table[own, i])
        table[own, i] = 1 + rate if abs(1 + rate) > CANCELLED * abs(rate) else 0.0
    return whole, table


def format_sum(terms: Sequence[tuple[str, float]], digits: int) -> str:
    """Write coefficients and functions as a sum."""
    written = ""
    for name, value in terms:
        sign = (" - " if written else "-") if value < 0 else (" + " if written else "")
        size = f"{abs(value):.{digits}g}"
        written += sign + (size if name == "1" else name if size == "1" else f"{size} {name}")
    return written


def require_finite(library: Library, coefficients: Tensor, source: str = "model") -> Tensor:
    """Return coefficients, `(n_features, n_x)`, as they are; `source` is what found them, for the message.

    Raises:
        Diverged: one of them is not finite.
    """
    if len(wrong := (~coefficients.isfinite()).nonzero()):
        k, i = wrong[0].tolist()
        place = f"{library.names[k]} in {library.change_of(library.signature.state_names[i])}"
        raise Diverged(
            f"model learning: the {source} has {len(wrong)} coefficients that are not finite, such as "
            f"{coefficients[k, i].item()} of {place}; leave that function out of the library, or check the data's units"
        )
    return coefficients
