"""Named libraries, built from a signature: the two of the paper, rotor, mechanics, polynomial."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, combinations_with_replacement
from typing import Annotated

from dynasindy.sentences import setting
from dynasindy.sindy.library import CONSTANT, Feature, Library, of, parse, variable
from dynasindy.systems.base import TURNS, Signature

COUPLING = -0.03
"""First guess of p; a fit goes 30 times as far at most, so 1 + p cos^2 a stays positive."""
LINKS = -0.3
"""Where the fit of p begins for links in a row; nearer to zero a force and its quotient can hardly be told apart."""


def is_speed(unit: str) -> bool:
    """Tell whether a unit is that of an angle or a length per time."""
    return bool(SPEED.fullmatch(unit) or TURNING.fullmatch(unit))


def _angles_of(signature: Signature) -> tuple[str, ...]:
    """Return the states in rad, if there is a state in rad/s; none without one."""
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    return tuple(name for name, unit in units.items() if unit == "rad" and "rad/s" in units.values())


def mechanical(signature: Signature, dry: Iterable[Feature] = ()) -> Library:
    """Build the functions of an equation of motion with angles: gravity, turned forces, centrifugal forces, quotients.

    They are linear functions; of one angle a: sin a, cos a, their product; every input and every rate times each of
    both; products of two angular rates times sin a, or sin a cos a. With two rates or more, which may be coupled, all
    forces with and without cos a are divided by 1 + p cos^2 a, too. With two angles or more, a is each of them, and the
    sum and the difference of two; all their sines and cosines pull, and forces are turned in the quotients alone.

    Args:
        signature: names and units of states and inputs; rates are the states whose unit is one per second.
        dry: dry friction of rates, which is a force like any other.
    """
    units = list(zip(signature.state_names, signature.state_units, strict=True))
    rates = [variable(name) for name, unit in units if unit.endswith("/s")]
    turning = [variable(name) for name, unit in units if unit == "rad/s"]
    spun = [one * other for one, other in combinations_with_replacement(turning, 2)]
    inputs = [variable(name) for name in signature.input_names]
    functions: list[Feature] = [CONSTANT, *(variable(n) for n in (*signature.state_names, *signature.input_names))]
    single: list[tuple[str, ...]] = [(name,) for name in _angles_of(signature)]
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


LIMIT = "the limit is arbitrary: more functions would hardly be told apart"
DRY = 10.0
"""First guess of the inverse of the rate at which dry friction is full [s/rad]."""
FULL = 20.0
"""First guess of the range of a rate, in those rates at which dry friction is full."""
PLACE = re.compile(
    "|".join(
        (
            *(f"{prefix}m" for prefix in ("", "k", "c", "d", "m", "u", "µ", "μ", "n")),
            "in",
            "ft",
            "px",
            "counts?",
            "rad",
            *TURNS,
        )
    )
)
TURNING = re.compile(r"rpm|rps|(?:1|U|r|rev|turns?)/min")
SPEED = re.compile(rf"(?!{TURNING.pattern})(?:{PLACE.pattern})/(?:h|min|s|ms)")
"""Units of angles and lengths, and of their rates: any of them per time, and turns per minute, as those of shafts."""
LibraryBuilder = Callable[[Signature], Library]
PITCH, ROTORS, RATES = "alpha_p", ("omega_a", "omega_p"), ("Omega_a", "Omega_p")
"""States of twin rotors: the pitch angle [rad], x2 of the paper, the speeds of the tail and the main rotor [rpm], and
the azimuth and the pitch rate [rad/s]."""


def _variables(signature: Signature) -> tuple[str, ...]:
    return (*signature.state_names, *signature.input_names)


def paper_table(signature: Signature) -> Library:
    """Build the library of the paper's Xi table: 1; z; z cos a; z^2 sin a; sin a; cos a, a the pitch angle [rad].

    Args:
        signature: names of states and inputs, z = (x, u); 27 functions for six states and two inputs.
    """
    z, c, s = [variable(n) for n in _variables(signature)], of("cos", PITCH), of("sin", PITCH)
    return Library(signature, [CONSTANT, *z, *(f * c for f in z), *(f * f * s for f in z), s, c])


def paper_equation(signature: Signature) -> Library:
    """Build the library of the paper's equation of Theta(X, U): z; z cos a; z^2 sin a; sin z; cos z.

    Args:
        signature: names of states and inputs, z = (x, u); 40 functions for six states and two inputs.
    """
    names = _variables(signature)
    z, c, s = [variable(n) for n in names], of("cos", PITCH), of("sin", PITCH)
    trigonometric = [of(f, n) for f in ("sin", "cos") for n in names]
    return Library(signature, [*z, *(f * c for f in z), *(f * f * s for f in z), *trigonometric])


def rotor(signature: Signature, reaction: bool = False, friction: bool = False, cable: bool = False) -> Library:
    """Build the library of a beam with two rotors, with the functions that each equation may use.

    A rotor's speed w is driven by its input against drag in w, |w|, w|w|, w^2 (two branches). The pitch rate has
    the thrust w|w|, w^2 of the main rotor, gravity, damping, the centrifugal torque and the tail rotor's reaction.
    In the azimuth rate everything is divided by the moment of inertia J_h(a) = J_0 (1 + k cos^2 a), whose k is fitted.

    Args:
        signature: names of states and inputs; the inputs are in the order of the rotors.
        reaction: whether the angles (a cable), the rotors' torques and their gyroscopic moments act on the beam too,
            as on the Feedback rig.
        friction: whether the beam's bearings have dry friction, tanh(rate / width), whose widths are fitted.
        cable: whether a cable pulls the azimuth to an angle of its own, as a spring.
    """
    c, s, rate_a, rate_p = of("cos", PITCH), of("sin", PITCH), *(variable(n) for n in RATES)
    thrust, drag = {}, {}
    for name, control in zip(ROTORS, signature.input_names, strict=True):
        w, size = variable(name), of("abs", name)
        # w|w| stands before w^2 and w before |w|: of functions that the data cannot tell apart the first one stays.
        thrust[name] = [w * size, w * w]
        drag[name] = [CONSTANT, variable(control), w, size, *thrust[name]]
    tail, main = ROTORS
    u_tail, u_main = (variable(n) for n in signature.input_names)
    pitch = [CONSTANT, c, s, rate_p, u_tail, *thrust[main], rate_a * rate_a * s * c]
    torques = [rate_a, s * c * rate_a * rate_p, u_main * c, *(f * c for f in thrust[tail])]
    dry_a, dry_p = ([of("tanh", rate, frequency=DRY, fitted=True)] if friction else [] for rate in RATES)
    pitch, torques = [*pitch, *dry_p], [*torques, *dry_a]
    inertia = of("per_cos2", PITCH, frequency=3.0, fitted=True)
    azimuth_angle = variable(signature.state_names[0])
    if cable:
        torques += [azimuth_angle, CONSTANT]
    if reaction:
        w_tail, w_main = variable(tail), variable(main)
        torques += [azimuth_angle, w_main * c, thrust[main][0] * c, rate_p * rate_p * c, rate_p * rate_p * s]
        torques += [w_main * rate_p * s, w_tail]
        pitch += [w_tail, thrust[tail][0], w_main * rate_a * s, rate_a, azimuth_angle, thrust[tail][0] * c, u_main * c]
        # The centres of mass are off the axes: part of the torques of one axis goes to the other, and to the rotors.
        swapped = [f * g * inertia for f in torques for g in (s, c)]
        torques += [f * g for f in pitch for g in (s, c)]
        pitch += swapped
        drag[tail] += pitch
        drag[main] += [f * c * inertia for f in torques]
    allowed = {RATES[0]: [f * inertia for f in torques], RATES[1]: pitch, **drag}
    basics = [CONSTANT, *(variable(n) for n in _variables(signature))]
    return Library(signature, [*basics, *(f for group in allowed.values() for f in group)], allowed)


def polynomial(
    signature: Signature, degree: Annotated[int, range(1, 11), LIMIT] = 2, variables: Iterable[str] | None = None
) -> Library:
    """Build all monomials of states and inputs, constant included.

    Args:
        signature: names of states and inputs.
        degree: highest total degree.
        variables: states and inputs to use; all by default.
    """
    names = tuple(variables) if variables is not None else _variables(signature)
    groups = (group for total in range(degree + 1) for group in combinations_with_replacement(names, total))
    return Library(signature, (Feature.of(f for n in group for f in variable(n).factors) for group in groups))


def auto(signature: Signature, dry: Iterable[Feature] = ()) -> Library:
    """Build what suits the units: quadratic polynomials, or for angles and their rates the functions of mechanics.

    A plant with an angle in rad and a rate in rad/s gets quadratic polynomials of its other states and inputs only.
    An angle in rad where no state is in rad/s, as the tilt of a beam that an actuator sets, has sine and cosine beside
    the polynomials: gravity acts on other states by them.

    Args:
        signature: names and units of states and inputs.
        dry: dry friction of rates, for a machine with several angles.
    """
    units = list(zip(signature.state_names, signature.state_units, strict=True))
    if not _angles_of(signature):
        tilts = [name for name, unit in units if unit == "rad"]
        pulls = [of(word, name) for name in tilts for word in ("sin", "cos")]
        return Library(signature, [*polynomial(signature).features, *pulls])
    others = [name for name, unit in units if unit not in ("rad", "rad/s")]
    powers = polynomial(signature, variables=[*others, *signature.input_names])
    return Library(signature, [*mechanical(signature, dry).features, *powers.features])


def auto_rig(signature: Signature) -> Library:
    """Build what suits the units of a real plant: `auto`, and dry friction of each rate of an angle or a place.

    Dry friction is tanh(v / width), which is full beyond a small rate v; the width is fitted. Of two rates or more it
    is there times cos a of each angle a, too: what rubs on a cart turns the pole on it. A shaft of which the turns per
    minute are known, and no angle, has bearings of its own, and rubs on nothing else.

    Args:
        signature: names and units of states and inputs; rates are the states in a unit of `SPEED` or `TURNING`.
    """
    units = [*zip(signature.state_names, signature.state_units, signature.x_scale, strict=True)]
    dry, shafts = (
        [of("tanh", name, frequency=FULL / scale, fitted=True) for name, unit, scale in units if kind.fullmatch(unit)]
        for kind in (SPEED, TURNING)
    )
    turned = [f * of("cos", angle) for f in dry for angle in _angles_of(signature)] if len(dry) > 1 else []
    return Library(signature, [*auto(signature, dry).features, *dry, *turned, *shafts])


NAMED: dict[str, LibraryBuilder] = {
    "paper_table": paper_table,
    "paper_equation": paper_equation,
    "rotor": rotor,
    "rotor_rig": partial(rotor, friction=True, cable=True),  # for logs of a real rig
    "rotor_reaction": partial(rotor, reaction=True, friction=True),  # for the Feedback rig
    "polynomial": polynomial,
    "mechanical": mechanical,
    "auto": auto,
    "auto_rig": auto_rig,
}
"""Libraries that a word selects."""
GENERAL = ("auto", "auto_rig", "mechanical", "polynomial")
"""Those for any plant, which hold more than a plant has: a fit takes what its data need."""


def build_library(library: str | Sequence[str] | Library | LibraryBuilder, signature: Signature) -> Library:
    """Make a library from a name, a list of functions in words, a builder or a library.

    Args:
        library: What it is made of.
        signature: States and inputs that its functions read.

    Returns:
        The library.

    Raises:
        ValueError: no library has that name, or a function cannot be read.
    """
    if isinstance(library, Library):
        return library
    if isinstance(library, str):
        if library not in NAMED:
            raise ValueError(
                f"library {library!r} does not exist; allowed are {', '.join(NAMED)}: choose one of them in "
                f"{setting('plant.library')}, or in {setting('plant.libraries')} for a source of data"
            )
        return NAMED[library](signature)
    if callable(library):
        return library(signature)
    return Library(signature, [parse(text) for text in library])
