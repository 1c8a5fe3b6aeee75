"""What a recording and a library tell before the fit, which takes its time and may be spoilt by it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from dynasindy.data.rates import contradicted, mismatched
from dynasindy.evaluation.source import Source
from dynasindy.sindy import SindyModel
from dynasindy.sindy.named_libraries import auto, auto_rig
from dynasindy.sindy.reconstruction import find_missing_rates, rate_states
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
class _Before:
    """Hold what is told before the fit.

    Attributes:
        lines: What was read, what is wrong with it or costs the fit dearly, a line each, what is worst first.
        lacking: Which rates a log lacks; none of other data.
    """

    lines: tuple[str, ...]
    lacking: _Lacking


def before_fit(model: SindyModel, source: Source) -> _Before:
    """Look at a model and its data before the fit.

    Args:
        model: A model of the data, not fitted yet.
        source: The data.
    """
    notes = [f"note: {note}" for note in source.notes]
    if not source.logged:
        return _Before((*wrong_units(model, source), *notes), _Lacking({}, {}))
    lacking = rates_lacking(model, source)
    lines = [
        *wrong_units(model, source),
        *_few_rows(source),
        *notes,
        *_angles(model, source),
        *_many_functions(model, source),
        *missing_rates(model, lacking),
    ]
    return _Before(tuple(lines), lacking)


def wrong_units(model: SindyModel, source: Source) -> list[str]:
    """Say which measured rates are not those of their states, or not the slopes of these, a line for each."""
    data, signature, known = source.training, source.signature, _known(model)
    wrong = contradicted(data, signature, known)
    units = mismatched(data, signature, known)
    told = [*wrong.values(), *(found for found in units if found.state not in wrong)]
    return [f"warning: {found}" for found in told]


def _few_rows(source: Source) -> list[str]:
    """Say that there are so few rows that nothing can be told of units; notes say what was left out."""
    rows = len(source.training)
    if rows >= FEW:
        return []
    return [
        f"warning: the fit has {rows} rows only, so few that wrong units or missing rates would not be noticed; "
        f"record longer, or mend what was left out: {FEW} rows are the least, some hundreds are usual"
    ]


def _angles(model: SindyModel, source: Source) -> list[str]:
    """Say which angles have no sine and cosine among the functions, because of their unit or that of their rate."""
    signature = source.signature
    if _chosen(model, signature):
        return []
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    turned = {name: TURNS[unit] for name, unit in units.items() if unit in TURNS}
    lines = [
        f"note: {name} is in {units[name]}, so sin({name}) and cos({name}) are not among the candidate functions; "
        f"angles in rad and rates in rad/s have them: give {_in_rad(source)}"
        for name in turned
    ]
    return lines


def missing_rates(model: SindyModel, lacking: _Lacking) -> list[str]:
    """Say which rates a log lacks or may lack, and the words that give them, once for each state.

    Rates that a log clearly lacks are named where `with_missing_rates` has left them out.

    Args:
        model: A model of the log, not fitted yet.
        lacking: What `rates_lacking` returned of it.
    """
    given, lines = _known(model), []
    if new := [name for name in lacking.shown if name not in given]:
        its = "its rate, which is" if len(new) == 1 else "their rates, which are"
        lines.append(
            f"hint: what {' and '.join(new)} will do depends on {its} no state yet. Give "
            f"'{rate_setting(lacking.shown)}': a column of that name is read as the rate; without one, the rate "
            "is estimated"
        )
    return lines + [
        f"hint: of {name} only sin({name}) and cos({name}) are tried, and no forces that {name} turns, as no state is "
        f"in rad/s. If a torque moves {name}, give its rate in rad/s, or "
        f"'{rate_setting({**given, name: f'{name}_rate'})}' if none was logged"
        for name in lacking.with_angles
        if name not in lacking.shown
    ]


def with_missing_rates(
    build: Callable[..., SindyModel], source: Source, known: Mapping[str, str] | None
) -> tuple[Source, dict[str, str], list[str]]:
    """Add the rates of states that a log shows to be missing, so that they are estimated with the model.

    Nothing is added where equations are known or where somebody chose the functions: these may not have the rates.

    Args:
        build: Makes a model from a signature.
        source: The log.
        known: The rate of each state as it was given; None where the log has to tell, and then it may be empty.

    Returns:
        The log with the rates that it lacks; the rate of each state, given or found; and what is told of it, a line
        at most.
    """
    if known is not None or not source.logged:
        return source, dict(known or {}), []
    model = build(signature=source.signature)
    found = {} if _chosen(model, source.signature) else rates_lacking(model, source).shown
    if not found:
        return source, {}, []
    its, are = ("its rate", "It is") if len(found) == 1 else ("their rates", "They are")
    told = (
        f"note: what {' and '.join(found)} will do depends on {its}, which the log lacks. {are} estimated with the "
        f"model, as if '{rate_setting(found)}' had been given; 'plant.known={{}}' leaves that out"
    )
    return replace(source.with_rates(found), notes=source.notes), found, [told]


@dataclass(frozen=True)
class _Lacking:
    """Hold the rate of each state, by its name: those that are known and those that are missing.

    Attributes:
        shown: With those that the log itself shows to be missing.
        with_angles: The same, and with one of each angle in rad where no state is in rad/s and nobody chose the
            functions.
    """

    shown: dict[str, str]
    with_angles: dict[str, str]


def rates_lacking(model: SindyModel, source: Source) -> _Lacking:
    """Return which rates a log lacks; to find them takes a regression of each state.

    Args:
        model: A model of the log, not fitted yet.
        source: The log.
    """
    signature, known = source.signature, _known(model)
    missing = find_missing_rates(model.library, source.training)
    angles = []
    if model.step is None and "rad/s" not in signature.state_units and not _chosen(model, signature):
        angles = [n for n, unit in zip(signature.state_names, signature.state_units, strict=True) if unit == "rad"]
    return _Lacking(
        *(
            known | {name: _name_of_rate(name, signature) for name in names if name not in known}
            for names in (missing, [*missing, *angles])
        )
    )


def _name_of_rate(name: str, signature: Signature) -> str:
    """Return a name that functions and words of the command line can hold, and that no state or input has."""
    rate = re.sub(r"\W", "_", name) + "_rate"
    while rate in (*signature.state_names, *signature.input_names):
        rate += "_"
    return rate


def rate_setting(known: Mapping[str, str]) -> str:
    """Return the word of the command line that says which state is the rate of which."""
    return f"plant.known={{{', '.join(f'{name}: {rate}' for name, rate in known.items())}}}"


def _known(model: SindyModel) -> dict[str, str]:
    names = model.signature.state_names
    return {names[i]: names[rate] for rate, i in rate_states(model.library, model.constraints).items()}


def _chosen(model: SindyModel, signature: Signature) -> bool:
    """Tell whether somebody chose the functions."""
    return all(set(model.library.names) != set(build(signature).names) for build in (auto, auto_rig))


def _in_rad(source: Source) -> str:
    """Return the words of the command line that read all angles and their rates in rad and rad/s.

    Rates that no column has are left out: `plant.known` adds them, in the unit of their angle.
    """
    signature, states = source.signature, []
    unseen = source.training.x.isnan().all(0).tolist()
    for name, unit, missing in zip(signature.state_names, signature.state_units, unseen, strict=True):
        if missing:
            continue
        whole, per, second = unit.partition("/")
        if whole in TURNS and (per + second) in ("", "/s"):
            states.append(f"{name}: {{name: {name}, unit: rad{per}{second}, scale: {TURNS[whole]:.7g}}}")
        else:
            states.append(f"{name}: {name}" if unit == "-" else f"{name}: {{name: {name}, unit: {unit}}}")
    return f"'data.states={{{', '.join(states)}}}'"


def plants_with(signature: Signature) -> list[str]:
    """Return the plants known by name whose states and inputs these are, in their order."""
    wanted = signature.state_names, signature.input_names
    found = {name: build().signature for name, build in PLANTS.items()}
    return [name for name, own in found.items() if (own.state_names, own.input_names) == wanted]


def _many_functions(model: SindyModel, source: Source) -> list[str]:
    """Say how many functions the fit chooses from, if that is many, and how they become fewer."""
    rows, signature = len(source.training), source.signature
    each = of_one_angle(model.library).values()
    count = max((int(own.sum()) for own in each), default=len(model.library))
    known = plants_with(signature)
    if count < (MANY_OF_KNOWN if known else MANY) and 2 * count <= rows:
        return []
    told = f"note: the fit chooses from {count} candidate functions by {rows} rows"
    if known:
        which = f"system={known[0]} takes" if len(known) == 1 else f"system=NAME, NAME one of {', '.join(known)}, takes"
        ours = f"{told}; the columns are named as the states of a plant in this package"
        return [f"{ours}. If your log is of such a plant, {which} a shorter list made for it"]
    return [
        f"{told}, which takes long and lets functions in that do not belong; if you know what moves your plant, name "
        'it, as in \'plant.library=["1",angle,rate,u,"sin(angle)"]\''
    ]
