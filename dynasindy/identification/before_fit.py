"""What a recording and a library show before the fit, which takes its time and may be spoilt by it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

from dynasindy.data.rates import check_rates
from dynasindy.findings import Finding, note, weak
from dynasindy.identification.source import Source, rates_of
from dynasindy.sindy import SindyModel
from dynasindy.sindy.named_libraries import auto, auto_rig
from dynasindy.sindy.reconstruction import find_missing_rates
from dynasindy.systems.base import Signature


def before_fit(model: SindyModel, source: Source) -> list[Finding]:
    """Return what was read, what is wrong with it or costs the fit dearly, before the fit.

    Args:
        model: A model of the data, not fitted yet.
        source: The data.
    """
    rates = check_rates(source.training, source.signature, rates_of(model))
    return [*rates, *source.findings, *missing_rates(model, source)]


def missing_rates(model: SindyModel, source: Source) -> list[Finding]:
    """Return that a log clearly lacks rates, and the equations that give them, where nobody has added them.

    Args:
        model: A model of the log, not fitted yet.
        source: The log.
    """
    known = lacking_rates(model, source)
    new = [name for name in known if name not in rates_of(model)]
    return [weak("fit.rates_missing", states=new, known=known)] if new else []


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
    found = {} if _chosen(model, source.signature) else lacking_rates(model, source)
    if not found:
        return source, {}, []
    return replace(source.with_rates(found), findings=source.findings), found, [note("fit.rates_added", known=found)]


def lacking_rates(model: SindyModel, source: Source) -> dict[str, str]:
    """Return the rate of each state, by its name: those that are known, and those that the log shows to be missing.

    Args:
        model: A model of the log, not fitted yet.
        source: The log; of others nothing is missing. To find it takes a regression of each state.
    """
    if not source.logged:
        return {}
    missing = find_missing_rates(model.library, source.training)
    return rates_of(model) | {n: rate_name(n, source.signature) for n in missing if n not in rates_of(model)}


def rate_name(name: str, signature: Signature) -> str:
    """Return a name that functions and words of the command line can hold, and that no state or input has."""
    rate = re.sub(r"\W", "_", name) + "_rate"
    while rate in (*signature.state_names, *signature.input_names):
        rate += "_"
    return rate


def _chosen(model: SindyModel, signature: Signature) -> bool:
    """Tell whether somebody chose the functions."""
    return all(set(model.library.names) != set(build(signature).names) for build in (auto, auto_rig))
