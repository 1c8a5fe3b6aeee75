"""Write Xi for readers, as equations."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.library import Feature, Library, of

NEAR = 0.5
"""Part of the smaller of two numbers below which their sum shows that they nearly cancel."""


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
    library, coefficients = library.mapping(coefficients)
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


def format_sum(terms: Sequence[tuple[str, float]], digits: int) -> str:
    """Write coefficients and functions as a sum."""
    written = ""
    for name, value in terms:
        sign = (" - " if written else "-") if value < 0 else (" + " if written else "")
        size = f"{abs(value):.{digits}g}"
        written += sign + (size if name == "1" else name if size == "1" else f"{size} {name}")
    return written
