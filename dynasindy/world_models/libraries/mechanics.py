"""Libraries of machines with angles: what an equation of motion M(q) q'' = f(q, q', u) holds, solved for q''.

Of two coupled axes whose mass matrix depends on an angle a, the inverse of the matrix is a quotient,

    M = [m1, m2 cos a; m2 cos a, m3],   M^-1 = [m3, -m2 cos a; -m2 cos a, m1] / (m1 m3 (1 + p cos^2 a)),

with p = -m2^2 / (m1 m3) between -1 and 0, as of a pole on a cart or of a pendulum on an arm. So every force, with and
without cos a, may stand over 1 + p cos^2 a, whose p is fitted.

Of two links in a row it is the same with a the angle between them: the elbow's, or the difference of two angles that
are both measured against the vertical, or their sum, if one of them is counted the other way. Gravity then pulls by the
sines of both angles and of their sum or difference. Which of these angles the matrix depends on is not known before the
data: the library has the quotients of all, and a fit keeps those of one, see `one_quotient`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, combinations_with_replacement

from dynasindy.systems.base import Signature
from dynasindy.world_models.libraries.features import CONSTANT, Feature, of, variable
from dynasindy.world_models.libraries.library import Library

COUPLING = -0.03
"""First guess of p; a fit goes 30 times as far at most, so 1 + p cos^2 a stays positive."""
LINKS = -0.3
"""Where the fit of p begins for links in a row; nearer to zero a force and its quotient can hardly be told apart."""


def angles_of(signature: Signature) -> tuple[str, ...]:
    """Return the states in rad, if there is a state in rad/s; none without one."""
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    return tuple(name for name, unit in units.items() if unit == "rad" and "rad/s" in units.values())


def mechanical(signature: Signature, angles: Iterable[str] | None = None, dry: Iterable[Feature] = ()) -> Library:
    """Build the functions of an equation of motion with angles: gravity, turned forces, centrifugal forces, quotients.

    They are linear functions; of one angle a: sin a, cos a, their product; every input and every rate times each of
    both; products of two angular rates times sin a, or sin a cos a. With two rates or more, which may be coupled, all
    forces with and without cos a are divided by 1 + p cos^2 a, too. With two angles or more, a is each of them, and the
    sum and the difference of two; all their sines and cosines pull, and forces are turned in the quotients alone.

    Args:
        signature: names and units of states and inputs; rates are the states whose unit is one per second.
        angles: states that are angles; by default those in rad, where there is a state in rad/s.
        dry: dry friction of rates, which is a force like any other.
    """
    units = list(zip(signature.state_names, signature.state_units, strict=True))
    rates = [variable(name) for name, unit in units if unit.endswith("/s")]
    turning = [variable(name) for name, unit in units if unit == "rad/s"]
    spun = [one * other for one, other in combinations_with_replacement(turning, 2)]
    inputs = [variable(name) for name in signature.input_names]
    functions: list[Feature] = [CONSTANT, *(variable(n) for n in (*signature.state_names, *signature.input_names))]
    single: list[tuple[str, ...]] = [(name,) for name in (angles_of(signature) if angles is None else angles)]
    pairs = [(*pair, word) for pair in combinations([angle[0] for angle in single], 2) for word in ("sum", "gap")]
    pulls = [_turned(name, *angle) for angle in (*single, *pairs) for name in ("sin", "cos")] if pairs else []
    functions += pulls
    for angle in (*single, *pairs):
        s, c = (_turned(name, *angle) for name in ("sin", "cos"))
        over = _over(LINKS if pairs else COUPLING, *angle)
        functions += [] if pairs else [s, c, s * c, *(f * g for f in (*inputs, *rates) for g in (s, c))]
        functions += [f * g for f in spun for g in (s, s * c)]
        if len(rates) > 1:
            forces = [CONSTANT, *(pulls or [s]), *inputs, *rates, *(dry if pairs else ()), *(f * s for f in spun)]
            functions += [f * g * over for f in forces for g in (CONSTANT, c)]
    return Library(signature, functions)


def _turned(name: str, *angle: str) -> Feature:
    """Return a function of an angle, `(a,)`, or of the sum or the difference of two, `(a, b, "sum")`."""
    full = name if len(angle) == 1 else f"{name}_{angle[-1]}"
    return of(full, *angle[:2])


def _over(number: float, *angle: str) -> Feature:
    """Return the quotient of an angle, whose fit begins at a number."""
    (factor,) = _turned("per_cos2", *angle).factors
    return Feature((replace(factor, fitted=COUPLING).with_number(number),))
