"""An input that acts through a state that no sensor sees: a motor, a propeller, a valve that follows slowly.

The state a follows the command u by a' = (u - a) / T, and the equations read a in the place of u. The time T is found
by regressions on commands that were led through such a lag, then with all else by trajectories.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.told import tell
from dynasindy.world_models.libraries.features import of
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.models.sindy import SindyModel
from dynasindy.world_models.refinement.actuator import Actuator
from dynasindy.world_models.refinement.delay import unexplained
from dynasindy.world_models.refinement.measured import Seen, has_gaps, rates_known, reconstruct
from dynasindy.world_models.writers.fast_field import generate

TIMES = (2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Times of the lag that regressions try [samples]."""


def lag_of(model: SindyModel, data: Transitions, place: int) -> float:
    """Return the lag with which all functions together explain the rates of change best [s]; 0 if none does better.

    What comes through a lag is not known at the begin of a stretch. Lags that leave less than half of the samples known
    are not tried.

    Args:
        model: what was fitted to the recording.
        data: the recording, NaN where a state was not measured.
        place: which input.
    """
    data, rates = data.to(torch.float64), rates_known(model.library, model.constraints)
    noisy = not bool(has_gaps(data))
    guess = reconstruct(data, rates, noisy)
    free, fixed = model.constraints.free, torch.where(model.constraints.free, 0.0, model.coefficients)
    enough = max(len(data) // 2, 2 * len(model.library))
    for longest in reversed(TIMES):
        keep = lagged(data, place, longest * data.dt)[1]
        if int(keep.sum()) >= enough:
            break
    else:
        return 0.0

    def _cost(time: float) -> float:
        given, seen = (lagged(part, place, time)[0] for part in (guess, data))
        rows = Seen.of(given.select(keep), seen.select(keep), rates, noisy)
        theta, dx = rows.rows(model.library, generate(model.library, model.coefficients))
        return unexplained(free, theta, dx - theta @ fixed)

    return min([0.0, *(n * data.dt for n in TIMES if n <= longest)], key=_cost)


def lagged(data: Transitions, place: int, time: float) -> tuple[Transitions, Tensor]:
    """Return a recording whose input is what comes through a lag, and where that is known, bool `(N,)`."""
    if not time:
        return data, torch.ones(len(data), dtype=torch.bool)
    return Actuator(place, "lag", time).acts(data)


def with_follower(model: SindyModel, data: Transitions, place: int, time: float) -> SindyModel | None:
    """Return a model with the lag of an input as one state more, not fitted yet; None where that cannot be.

    Args:
        model: a model of the same states without it.
        data: the recording, NaN where a state was not measured.
        place: which input.
        time: first guess of the time of the lag [s].
    """
    known = rates_known(model.library, model.constraints)
    states = model.signature.state_names
    given = {states[i]: states[rate] for rate, i in known.items()}
    others = [i for i in range(len(states)) if i not in known.values()]
    if not bool(model.constraints.free[:, others].any()) or bool(model.constraints.offset[:, others].any()):
        return None
    tell("fit", words=f"{model.signature.input_names[place]} through a lag of {time:.3g} s")
    first = copy.deepcopy(model)
    through, heard = lagged(data.to(torch.float64), place, time)
    first.fit(through.select(heard))
    name = model.signature.input_names[place]
    follower = lagging(name)
    read = [feature.reading(name, follower) for feature in first.library.features]
    own = of("ahead", name, follower)
    signature = model.signature.with_state(follower, "1")
    library = Library(signature, [*read, own])
    names = [feature.name() for feature in read]
    free, found = first.constraints.free, first.coefficients
    allowed = {state: [n for n, may in zip(names, free[:, i]) if may] for i, state in enumerate(states)}
    initial = {state: {n: float(v) for n, v in zip(names, found[:, i]) if v} for i, state in enumerate(states)}
    return SindyModel(
        signature,
        library,
        model.regression,
        model.refinement,
        known=given,
        allowed=allowed | {follower: [own.name()]},
        initial=initial | {follower: {own.name(): 1 / time}},
        machine_code=model.machine_code,
    )


def lagging(name: str) -> str:
    """Return the name of the state that follows an input."""
    return f"{name}_lagging"


def lags(signature: Signature, logged: Tensor) -> dict[str, tuple[float, float]]:
    """Return the ends between which the states that follow inputs were in a log: the commands', and zero.

    Args:
        signature: names of the model.
        logged: inputs of the log, `(N, n_u)`, before which they were zero.
    """
    ends = zip(logged.amin(0).clamp_max(0.0).tolist(), logged.amax(0).clamp_min(0.0).tolist(), strict=True)
    both = zip(map(lagging, signature.input_names), ends, strict=True)
    return {name: (low, high) for name, (low, high) in both if name in signature.state_names}


def completed(data: Transitions, names: tuple[str, ...], signature: Signature) -> Transitions:
    """Return a recording with all states of a model, whose lags no sensor sees.

    Args:
        data: the recording.
        names: its states.
        signature: names of the model.

    Raises:
        ValueError: the model is of another plant.
    """
    more = signature.state_names[len(names) :]
    if signature.state_names[: len(names)] != names or not set(more) <= set(map(lagging, signature.input_names)):
        raise ValueError(
            f"the model has the states {', '.join(signature.state_names)}, the log {', '.join(names)}; give a model of "
            "the plant that the log is of"
        )
    for _ in more:
        data = widened(data)
    return data


def widened(data: Transitions) -> Transitions:
    """Return a recording with one state more, which no sensor sees."""
    unseen = torch.full_like(data.x[:, :1], torch.nan)
    return replace(data, x=torch.cat([data.x, unseen], -1), x_next=torch.cat([data.x_next, unseen], -1))
