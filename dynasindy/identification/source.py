"""Data to identify from, and data to judge on."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from dynasindy.findings import Finding, note, weak
from dynasindy.sentences import lines, setting
from dynasindy.sindy import SindyModel
from dynasindy.sindy.lag_states import widened
from dynasindy.sindy.reconstruction import rate_states, reconstruct
from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions
from dynasindy.text import format_duration

if TYPE_CHECKING:
    from dynasindy.data.recording import Recording
    from dynasindy.envs import Excitation

VALIDATION_SHARE = 0.25
"""Part of a log, at its end, that is kept to judge on."""
PERIOD = 0.05
"""Control period unless another is given [s]; with a log the multiple of its sampling time that is nearest."""
USUAL = 0.99
"""Part of the samples that lie within the range of a rate: the others may be what noise and edges make of them."""
MOST = 100_000
"""Samples, about, that a range is told by."""
SAMPLES = 10
"""Samples of a log in a control period at most, if nobody asks for another one."""


@dataclass(frozen=True, repr=False)
class Source:
    """Hold data to identify from and data to judge on.

    Attributes:
        signature: names, units and ranges of states and inputs.
        training: transitions to fit.
        validation: transitions that the fit does not see; there may be none.
        findings: what was decided when they were read.
        logged: whether they are a log, so that nothing is known of the plant but what was measured.
        exact: whether its samples are the states themselves, as training has them of a plant without sensors.
        stride: sampling intervals from one sample that a fit reads to the next.
    """

    signature: Signature
    training: Transitions
    validation: Transitions
    findings: tuple[Finding, ...] = ()
    logged: bool = False
    exact: bool = False
    stride: int = 1

    @classmethod
    def of(cls, log: Recording, share: float = VALIDATION_SHARE) -> Source:
        """Keep the last part of a log to judge on.

        Args:
            log: the log.
            share: how much of it; with 0 nothing can be forecast.

        Raises:
            ValueError: the share is not at least 0 and below 1.
        """
        if not 0 <= share < 1:
            raise ValueError(f"validation_share is {share}; allowed is 0 to below 1, such as {VALIDATION_SHARE}")
        data = log.transitions
        early = torch.arange(len(data)) < int(len(data) * (1 - share))
        return cls(log.signature, data.select(early), data.select(~early), log.findings, True)

    def fit_data(self, rows: Tensor) -> Transitions:
        """Return the transitions of some rows of the training data, bool `(N,)`, as a fit reads them."""
        return self.training.select(rows).decimate(self.stride)

    @property
    def whole(self) -> Transitions:
        """All rows; what follows on each other is one stretch again."""
        if not len(self.validation):
            return self.training
        both, cut = Transitions.cat([self.training, self.validation]), len(self.training)
        end, begin = self.training.x_next[-1:], self.validation.x[:1]
        on = bool(((end == begin) | (end.isnan() & begin.isnan())).all())
        if on and both.u_end is not None:
            both.u_end[cut - 1] = torch.where(both.linear_inputs, both.u[cut], both.u_end[cut - 1])
        return replace(both, segment=both.segment - (on * (torch.arange(len(both)) >= cut)).long())

    def __repr__(self) -> str:
        """Say in a few lines what it holds."""
        data, signature = self.training, self.signature
        states, stretches = signature.headings(signature.state_names), len(data.segment.unique())
        many = f" in {stretches} stretches" if stretches > 1 else ""
        length, step = format_duration(len(data) * data.dt), format_duration(data.dt)
        head = f"Data of {len(data)} rows, {length} every {step}{many}: states {', '.join(states)}; inputs "
        judged = f"; {len(self.validation)} rows more to judge on"
        return "\n".join([f"{head}{', '.join(signature.input_names)}{judged}", *lines(self.findings)])

    def with_rates(self, known: Mapping[str, str]) -> Source:
        """Return the data with the rates that are known to belong to a state and were not logged.

        Whatever reads a log adds them here. Such a rate has the range in which its state moved.

        Args:
            known: the rate of each state, by its name.
        """
        found = self.with_unmeasured(self.signature.with_rates(known))
        signature = _with_rate_ranges(found.signature, found.whole, known)
        added = found.signature.state_names[self.signature.n_x :]
        findings = (note("log.unmeasured", state=name) for name in added)
        return replace(found, signature=signature, findings=(*found.findings, *findings))

    def named_rates(self, library: object) -> dict[str, str]:
        """Return the rates that functions in words name and that are no states yet, by their states.

        Args:
            library: functions in words; anything else names none.
        """
        words = set(re.findall(r"\w+", " ".join(map(str, library)))) if isinstance(library, list | tuple) else set()
        rates = {name: rate_name(name, self.signature) for name in self.signature.state_names}
        return {name: rate for name, rate in rates.items() if rate in words}

    def without(self, names: Collection[str]) -> Source:
        """Return the data without some of their states, which are said to be left out."""
        if not names:
            return self
        mine, kept = self.signature, [i for i, name in enumerate(self.signature.state_names) if name not in names]
        columns: dict[str, Any] = {
            key: tuple(getattr(mine, key)[i] for i in kept) for key in ("state_names", "state_units", "x_scale")
        }
        training, validation = (
            replace(data, x=data.x[:, kept], x_next=data.x_next[:, kept]) for data in (self.training, self.validation)
        )
        findings = (*self.findings, weak("log.left_out", why="unmoved", columns=list(names)))
        return replace(
            self, signature=replace(mine, **columns), training=training, validation=validation, findings=findings
        )

    def with_unmeasured(self, signature: Signature) -> Source:
        """Return the data with the states of a signature that come behind those of the data, which no sensor sees.

        Args:
            signature: names, units and ranges of all states.
        """
        more = signature.n_x - self.signature.n_x
        training, validation = widened(self.training, more), widened(self.validation, more)
        return replace(self, signature=signature, training=training, validation=validation)

    def with_states_of(self, model: SindyModel) -> Source:
        """Return the data with the states of a model that no sensor sees, and inputs that move as those of its log did.

        Args:
            model: a model that was fitted to them, or one of the same plant.

        Raises:
            ValueError: the model is of another plant, or its inputs have other ends.
        """
        source = self.with_unmeasured(self.signature.with_rates(rates_of(model)))
        names, states = source.signature.state_names, model.signature.state_names
        given = (model.constraints.offset != 0).any(-1).nonzero().flatten().tolist()
        # What no sensor sees has its scale by a coefficient that is given, or follows a signal.
        unseen = {*model.followed, *(name for k in given for name in model.library.features[k].variables)}
        alike = states[: len(names)] == names and unseen.issuperset(states[len(names) :])
        if not (alike and self.signature.same_input_ranges(model.signature)):
            both = (source.signature, model.signature)
            mine, theirs = ((", ".join(each.state_names), each.input_ranges[:, 2:].tolist()) for each in both)
            raise ValueError(
                f"the model has the states {theirs[0]} and ends of inputs {theirs[1]}, the log {mine[0]} and {mine[1]}"
                f"; give a model of the same plant, and low, high and rest in {setting('data.inputs')}"
            )
        source = source.with_unmeasured(model.signature)
        return source.with_linear_inputs([name in model.linear_inputs for name in model.signature.input_names])

    def with_linear_inputs(self, linear: Sequence[bool] | None = None) -> Source:
        """Return the data under inputs that move in straight lines between samples, all of them or those that do."""
        training, validation = (part.with_linear_inputs(linear) for part in (self.training, self.validation))
        return replace(self, training=training, validation=validation)


class DataSource(ABC):
    """Where data come from: a log, or a simulated plant."""

    @abstractmethod
    def load(self, system: System | None, excitation: Callable[..., Excitation] | None) -> Source:
        """Return data of a plant, None of one that nobody knows, which is moved by an excitation if it is simulated."""


def closest_period(log: Source | None, wanted: float | None = None) -> float:
    """Return the control period that suits a log: the multiple of its sampling time nearest to the one wanted [s].

    Of two that are as near it is the shorter; without a log it is the one wanted. If none is wanted, it is 0.05 s, or
    ten samples of a log that is sampled faster: so is the log of a plant that is as fast.
    """
    if log is None:
        return wanted or PERIOD
    wanted = wanted or min(PERIOD, SAMPLES * log.training.dt)
    step = log.training.dt
    period = step * max(1, math.ceil(wanted / step - 0.5 - 1e-6))
    return wanted if math.isclose(period, wanted, rel_tol=1e-6) else period


def rates_of(model: SindyModel) -> dict[str, str]:
    """Return the name of each state whose rate is known to be another state, and that state's name."""
    names = model.signature.state_names
    rates = sorted(rate_states(model.library, model.constraints).items())  # as they come in the model
    return {names[state]: names[rate] for rate, state in rates}


def _with_rate_ranges(signature: Signature, data: Transitions, known: Mapping[str, str]) -> Signature:
    """Return a signature in which rates that no sensor sees have the range in which their states moved."""
    names, ranges, blind = signature.state_names, list(signature.x_scale), data.x.isnan().all(0).tolist()
    pairs = {names.index(rate): names.index(name) for name, rate in known.items() if {name, rate} <= set(names)}
    rates = {rate: state for rate, state in pairs.items() if blind[rate] and not blind[state]}
    guess = reconstruct(data, rates) if rates else data
    for rate in rates:
        moves = guess.x[:: len(guess) // MOST + 1, rate].abs()
        ranges[rate] = float(torch.quantile(moves, USUAL)) or ranges[rate]
    return replace(signature, x_scale=tuple(ranges))


def rate_name(name: str, signature: Signature) -> str:
    """Return a name that functions and words of the command line can hold, and that no state or input has."""
    rate = re.sub(r"\W", "_", name) + "_rate"
    while rate in (*signature.state_names, *signature.input_names):
        rate += "_"
    return rate
