"""What a recording and a library show before the fit, which takes its time and may be spoilt by it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from dynasindy.data.columns import Column, as_map
from dynasindy.data.headings import in_radians
from dynasindy.data.rates import check_rates
from dynasindy.findings import Finding, note, weak
from dynasindy.identification.source import Source, rates_of
from dynasindy.sindy import SindyModel
from dynasindy.sindy.named_libraries import auto, auto_rig
from dynasindy.sindy.reconstruction import find_missing_rates
from dynasindy.sindy.shape_parameters import of_one_angle
from dynasindy.systems import Pendulum, System, Tras, Trms33, Xi
from dynasindy.systems.base import TURNS, Signature

PLANTS: Mapping[str, Callable[[], System]] = {"pendulum": Pendulum, "tras": Tras, "trms33": Trms33, "xi": Xi}
"""Plants whose library and known equations `system=NAME` takes."""
MANY, MANY_OF_KNOWN = 150, 50
"""Candidate functions from which on a library is said to be long: of any plant, and of one whose own list is known."""
FEW = 50
"""Rows below which little can be told from a recording."""


@dataclass(frozen=True)
class PrefitReview:
    """Hold what is found before the fit.

    Attributes:
        findings: What was read, what is wrong with it or costs the fit dearly.
        missing: Which rates a log lacks; none of other data.
    """

    findings: tuple[Finding, ...]
    missing: MissingRates


def before_fit(model: SindyModel, source: Source) -> PrefitReview:
    """Look at a model and its data before the fit.

    Args:
        model: A model of the data, not fitted yet.
        source: The data.
    """
    rates = check_rates(source.training, source.signature, rates_of(model))
    if not source.logged:
        return PrefitReview((*rates, *source.findings), MissingRates({}, {}))
    missing, rows = review_rates(model, source), len(source.training)
    findings = [
        *rates,
        *([weak("log.few_rows", rows=rows, least=FEW)] if rows < FEW else []),
        *source.findings,
        *_angles(model, source),
        *_many_functions(model, source),
        *missing_rates(model, missing),
    ]
    return PrefitReview(tuple(findings), missing)


def _angles(model: SindyModel, source: Source) -> list[Finding]:
    """Return which angles have no sine and cosine among the functions, because of their unit or that of their rate."""
    if _chosen(model, source.signature):
        return []
    units = dict(zip(source.signature.state_names, source.signature.state_units, strict=True))
    measured = source.training.x.isfinite().any(0).tolist()
    columns = {  # rates that no column has are left out: `plant.known` adds them, in the unit of their angle
        name: Column(name, *in_radians(unit, turns=False))
        for (name, unit), logged in zip(units.items(), measured, strict=True)
        if logged
    }
    states = as_map(columns)
    return [note("log.degrees", angle=n, unit=unit, states=states) for n, unit in units.items() if unit in TURNS]


def missing_rates(model: SindyModel, missing: MissingRates) -> list[Finding]:
    """Return which rates a log lacks or may lack, and the equations that give them, once for each state.

    Rates that a log clearly lacks are named where `with_missing_rates` has left them out.

    Args:
        model: A model of the log, not fitted yet.
        missing: What `review_rates` returned of it.
    """
    given, findings = rates_of(model), []
    if new := [name for name in missing.certain if name not in given]:
        findings.append(weak("fit.rates_missing", states=new, known=missing.certain))
    return findings + [
        note("fit.no_torque", angle=name, known={**given, name: rate})
        for name, rate in missing.possible.items()
        if name not in missing.certain
    ]


def with_missing_rates(
    build: Callable[..., SindyModel], source: Source, known: Mapping[str, str] | None
) -> tuple[Source, dict[str, str], list[Finding]]:
    """Add the rates of states that a log shows to be missing, so that they are estimated with the model.

    Nothing is added where equations are known or where somebody chose the functions: these may not have the rates.

    Args:
        build: Makes a model from a signature.
        source: The log.
        known: The rate of each state as it was given; None where the log has to tell, and then it may be empty.

    Returns:
        The log with the rates that it lacks; the rate of each state, given or found; and what was found, if
        anything.
    """
    if known is not None or not source.logged:
        return source, dict(known or {}), []
    model = build(signature=source.signature)
    found = {} if _chosen(model, source.signature) else review_rates(model, source).certain
    if not found:
        return source, {}, []
    return replace(source.with_rates(found), findings=source.findings), found, [note("fit.rates_added", known=found)]


@dataclass(frozen=True)
class MissingRates:
    """Hold the rate of each state, by its name: those that are known and those that are missing.

    Attributes:
        certain: With those that the log itself shows to be missing.
        possible: The same, and with one of each angle in rad where no state is in rad/s and nobody chose the
            functions.
    """

    certain: dict[str, str]
    possible: dict[str, str]


def review_rates(model: SindyModel, source: Source) -> MissingRates:
    """Return which rates a log lacks; to find them takes a regression of each state.

    Args:
        model: A model of the log, not fitted yet.
        source: The log.
    """
    signature, known = source.signature, rates_of(model)
    missing = find_missing_rates(model.library, source.training)
    angles = []
    if model.step is None and "rad/s" not in signature.state_units and not _chosen(model, signature):
        angles = [n for n, unit in zip(signature.state_names, signature.state_units, strict=True) if unit == "rad"]
    return MissingRates(
        *(
            known | {name: rate_name(name, signature) for name in names if name not in known}
            for names in (missing, [*missing, *angles])
        )
    )


def rate_name(name: str, signature: Signature) -> str:
    """Return a name that functions and words of the command line can hold, and that no state or input has."""
    rate = re.sub(r"\W", "_", name) + "_rate"
    while rate in (*signature.state_names, *signature.input_names):
        rate += "_"
    return rate


def _chosen(model: SindyModel, signature: Signature) -> bool:
    """Tell whether somebody chose the functions."""
    return all(set(model.library.names) != set(build(signature).names) for build in (auto, auto_rig))


def plants_with(signature: Signature) -> list[str]:
    """Return the plants known by name whose states and inputs these are, in their order."""
    wanted = signature.state_names, signature.input_names
    found = {name: build().signature for name, build in PLANTS.items()}
    return [name for name, own in found.items() if (own.state_names, own.input_names) == wanted]


def _many_functions(model: SindyModel, source: Source) -> list[Finding]:
    """Say how many functions the fit chooses from, if that is many."""
    rows, signature = len(source.training), source.signature
    each = of_one_angle(model.library).values()
    count = max((int(own.sum()) for own in each), default=len(model.library))
    plants = plants_with(signature)
    if count < (MANY_OF_KNOWN if plants else MANY) and 2 * count <= rows:
        return []
    return [note("fit.many_functions", count=count, rows=rows, plants=plants)]
