"""Where a log mostly was, and the control period that suits it and the model that was fitted to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.evaluation.source import Source
from dynasindy.planning.oscillation import fastest_oscillation
from dynasindy.systems.transitions import Transitions
from dynasindy.tasks import Tracking
from dynasindy.world_models import SindyModel
from dynasindy.world_models.models.follower import begins

PERIOD = 0.05
"""Control period unless another is given [s]; with a log the multiple of its sampling time that is nearest."""
SAMPLES = 10
"""Samples of a log in a control period at most, if nobody asks for another one."""
PART = 5
"""Control periods in the fastest oscillation of the model at least, if nobody asks for another one."""


@dataclass(frozen=True)
class Period:
    """A control period that nobody asked for.

    Attributes:
        seconds: Its length [s].
        why: Why it is not `PERIOD`, in a line; empty where it is.
    """

    seconds: float
    why: str = ""


def suited_period(model: SindyModel, task: Tracking, log: Source | None) -> Period:
    """Return the control period that suits a model and its log, where nobody asks for one.

    It is what suits the log, but a fifth of the model's fastest oscillation at most, where the log mostly was; without
    a log where episodes begin. With a log it is a multiple of its sampling time, and one sample at least.

    Args:
        model: The fitted model.
        task: What is to be tracked.
        log: The log.
    """
    usual, step = nearest_period(log), log.training.dt if log else 0.0
    if log is None:
        x, u = task.start.double().mean(0), torch.zeros(model.signature.n_u)
    else:
        data = log.with_states_of(model).training
        x, u = typical(data, model).mean(0), data.u.double().median(0).values
    oscillation = fastest_oscillation(model, x, u, task.outputs)
    longest = oscillation / PART
    if step < usual and longest < usual * (1 - 1e-6):
        step = step or 10.0 ** (math.floor(math.log10(longest)) - 1)  # two digits
        samples = math.floor(longest / step + 1e-6)
        if samples:
            return _chosen(samples * step, f"a fifth of the model's fastest oscillation of {oscillation:.3g} s")
        return _chosen(step, f"one sample of the log, as the model's fastest oscillation takes {oscillation:.3g} s")
    if usual < PERIOD - step:
        return _chosen(usual, "ten samples of the log")
    return Period(usual, "" if math.isclose(usual, PERIOD, rel_tol=1e-6) else sampled_in_words(usual, PERIOD, step))


def _chosen(seconds: float, cause: str) -> Period:
    return Period(seconds, f"the control period is {seconds:g} s, {cause}; env.dt chooses another one")


def sampled_in_words(seconds: float, wanted: float, step: float) -> str:
    """Return why a control period is not the one that was wanted, in a line.

    Args:
        seconds: The control period [s].
        wanted: The one that was wanted [s].
        step: Sampling time of the log [s].
    """
    return f"the control period is {seconds:g} s and not env.dt={wanted:g}, as the log is sampled every {step:g} s"


def nearest_period(log: Source | None, wanted: float | None = None) -> float:
    """Return the control period that suits a log: the multiple of its sampling time nearest to the one wanted [s].

    Of two that are as near it is the shorter; without a log it is the one wanted. If none is wanted, it is 0.05 s, or
    ten samples of a log that is sampled faster: so is the log of a plant that is as fast.

    Raises:
        ValueError: The one wanted is not positive.
    """
    if wanted is not None and not wanted > 0:
        raise ValueError(f"env.dt must be a time > 0, got {wanted} s; the default is {PERIOD} s")
    if log is None:
        return wanted or PERIOD
    wanted = wanted or min(PERIOD, SAMPLES * log.training.dt)
    step = log.training.dt
    period = step * max(1, math.ceil(wanted / step - 0.5 - 1e-6))
    return wanted if math.isclose(period, wanted, rel_tol=1e-6) else period


def typical(data: Transitions, model: SindyModel) -> Tensor:
    """Return where a log mostly was, `(2, n_x)`: zero of states that pass through it, of others the median.

    A state that follows an input may be wherever the log had it, and zero, where inputs are before a flight; one that
    follows a measured state as far from that as in the log. Other states that were not measured are zero.
    """
    x = data.x.double()
    middle = x.nanmedian(0).values.nan_to_num(nan=0.0)
    middle[((x <= 0).any(0)) & ((x >= 0).any(0))] = 0.0
    ends = middle.expand(2, -1).clone()
    for place, (low, high) in begins(model, data).items():
        ends[:, place] = torch.tensor([low, high]).double()
    return ends
