"""Whether a plant is held: how near its outputs stay to their targets, and whether its other states come to rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.findings import Finding, note, wrong
from dynasindy.systems import Diverged, System
from dynasindy.systems.base import turn_of
from dynasindy.systems.equilibria import states_that_matter

FAR = 20.0
"""Ranges from where it began at which a state has run away, whatever the reference does."""
WITHIN = 0.01
"""Mean absolute error at the end that is asked for unless another is given, in target ranges."""
LOST = 10.0
"""Multiple of the error asked for beyond which the worst reference counts as not held."""
UNREST = 0.5
"""Ranges that a state may move by at the end of a run whose references stand still."""
LONGER = (5.0, 20.0)
"""Multiples of a run's length in which it shows whether a state that has not come to rest at its end is about to; the
larger one where the smaller one does not show it, as of long chains."""
OF_CHANGE = 0.1
"""Part of a state's change that may differ from another state, its rate: the trapezoidal rule errs by a tenth where it
swings once in six control periods."""
DECAYED = 0.7
"""Share of its motion at the end of a run that such a state may still have there."""


@dataclass(frozen=True)
class TrackingCriteria:
    """What an evaluation shows of the plant; `dataclasses.asdict` gives what `metrics.json` holds.

    Attributes:
        share: Mean absolute error at the end, of each output, in target ranges, or in those of what its references do
            where all move; None where it is not finite.
        worst: The same of the worst reference.
        away: States that run away or do not come to rest though they are not tracked, with the share of runs.
        idle: Those of them that nothing depends on, as a mileage.
        swings: Those of `away` that stay near and only do not come to rest.
        ringing: States that have not come to rest either, and do so in longer runs; they are none of `away`.
        turned: Outputs whose targets reach over a turn or more, and whose errors are shares of one turn.
        targets: Lower and upper end of the targets of each output [its unit]; none where no task tells them.
        rates: States that are rates of those of `away`, or are in it and rates of others: they are zero at rest.
        moving: Whether no reference rests at the end, so that outputs lag behind.
    """

    share: dict[str, float | None]
    worst: dict[str, float | None]
    away: dict[str, float]
    idle: dict[str, float]
    swings: dict[str, float] = field(default_factory=dict)
    ringing: dict[str, float] = field(default_factory=dict)
    turned: list[str] = field(default_factory=list)
    targets: dict[str, tuple[float, float]] = field(default_factory=dict)
    rates: list[str] = field(default_factory=list)
    moving: bool = False


def judge_tracking(
    evaluation: Evaluation, system: System, rerun: Callable[[str, float], Evaluation] | None = None
) -> TrackingCriteria:
    """Judge the final part of an evaluation.

    Args:
        evaluation: Runs of a policy.
        system: The plant, or a model of it, whose equations say which states matter.
        rerun: Makes the same runs in another length [s], of which it gets the phase in words, too. By them swings that
            die away are known; if it is omitted, or fails, as where memory is short, all swings count alike.
    """
    last = evaluation.steady_periods
    errors = evaluation.errors[:, -last:].mean(1)
    spans = (evaluation.references.amax(1) - evaluation.references.amin(1)) / torch.tensor(evaluation.boxes or 1.0)
    if moving := bool(evaluation.columns) and not bool(evaluation.resting.any()) and bool((spans > 0).all()):
        errors = errors / spans.clamp(1 / LOST, 1.0)  # the limit is never less than that of a target at rest
    scale = torch.tensor(evaluation.signature.x_scale, dtype=torch.float64)
    states = evaluation.trajectory["state"].double()
    matter = states_that_matter(system, evaluation.columns, states[0, 0])
    x = states[:, -last:] / scale
    far = ~((x - states[:, :1] / scale).abs() <= FAR).all(1)
    lost = far.clone()
    # Where nothing is tracked nobody asked for a rest either: a task may pay for motion.
    if evaluation.columns:
        lost |= evaluation.resting.unsqueeze(-1) & ~(x.amax(1) - x.amin(1) <= UNREST)
    shares = lost.double().mean(0).tolist()
    names = evaluation.signature.state_names
    gone = {i: share for i, share in enumerate(shares) if share and i not in evaluation.columns}
    near = (~far.any(0)).tolist()
    swinging = [i for i in gone if bool(matter[i]) and near[i]]
    decaying: set[int] = set()
    if swinging and evaluation.columns and rerun is not None and bool((errors.mean(0) <= LOST * WITHIN).all()):
        with suppress(Diverged, ValueError, MemoryError, RuntimeError):  # torch's own where memory runs out
            for factor in LONGER:
                decaying = _decaying(evaluation, rerun("whether swings die away", factor * evaluation.seconds))
                if decaying.issuperset(swinging):
                    break
    ringing = {names[i]: gone.pop(i) for i in swinging if i in decaying}
    pairs = _rates(evaluation) if gone and evaluation.columns else []
    rates = {j for i, j in pairs if matter[i] and {i, j} & {*gone} and j not in evaluation.columns}
    return TrackingCriteria(
        share=_named(evaluation, errors.mean(0)),
        worst=_named(evaluation, errors.amax(0)),
        away={names[i]: share for i, share in gone.items() if bool(matter[i])},
        idle={names[i]: share for i, share in gone.items() if not bool(matter[i])},
        swings={names[i]: share for i, share in gone.items() if bool(matter[i]) and near[i]},
        ringing=ringing,
        turned=[
            name
            for (name, unit), box in zip(evaluation.units.items(), evaluation.boxes, strict=False)
            if box >= turn_of(unit)
        ],
        targets=dict(zip(evaluation.output_names, evaluation.ends, strict=False)),
        rates=[names[j] for j in sorted(rates)],
        moving=moving,
    )


def judge_control(
    flights: Sequence[TrackingCriteria], within: float, code: str = "run.tracked", **facts: Any
) -> tuple[bool | None, Finding]:
    """Return whether a policy holds a plant, or each model of one, and the finding that says so.

    It does if every output stays as near to its targets as was asked for, and nothing else runs away; it is None where
    the task names no targets and nothing runs away: a return says nothing of control.

    Args:
        flights: What each of one plant or more shows.
        within: Mean absolute error at the end that is asked for, in ranges of targets; the worst reference may be
            `LOST` times as far, and so may all where no reference rests.
        code: Of the finding.
        **facts: What else it says: `grew`, whether the return did, or `seconds`, how long the flights were.
    """
    outputs, first, missed, lost = {}, flights[0], False, LOST * within
    within = lost if first.moving else within
    for name in first.share:
        share = [_number(flight.share[name]) for flight in flights]
        worst = [_number(flight.worst[name]) for flight in flights]
        missed |= max(share) > within or max(worst) > lost
        outputs[name] = {"least": min(share), "most": max(share), "worst": max(worst), "of_turn": name in first.turned}
    away: dict[str, dict[str, Any]] = {}
    for flight in flights:
        for name, share_of_runs in flight.away.items():
            told = away.setdefault(name, {"share": 0.0, "swings": True})
            told |= {"share": max(told["share"], share_of_runs), "swings": told["swings"] and name in flight.swings}
    controlled = False if missed or away else True if outputs else None
    ringing = dict.fromkeys(name for flight in flights for name in flight.ringing if name not in away)
    idle, rates = (sorted({name for flight in flights for name in getattr(flight, of)}) for of in ("idle", "rates"))
    facts |= {"controlled": controlled, "outputs": outputs, "within": within, "lost": lost, "away": away}
    facts |= {"moving": first.moving, "ringing": [*ringing], "idle": idle}
    # Where outputs are not held either, it is not for a state that nobody asked to come to rest.
    if away and rates and first.targets and not missed:
        facts |= {"rates": rates, "targets": first.targets}
    return controlled, (wrong if controlled is False else note)(code, **facts)


def _number(share: float | None) -> float:
    return math.inf if share is None else share


def _rates(evaluation: Evaluation) -> list[tuple[int, int]]:
    """Return the states whose change is another state, and that state, as the trajectory shows."""
    x = evaluation.trajectory["state"].double()
    change, mean = x.diff(dim=1), 0.5 * (x[:, 1:] + x[:, :-1])
    step, found = float(evaluation.time[1] - evaluation.time[0]), []
    for i in range(x.shape[-1]):
        own = change[..., i : i + 1]
        near = (own - step * mean).abs().sum((0, 1)) < OF_CHANGE * own.abs().sum()
        found += [(i, j) for j in near.nonzero().flatten().tolist() if i != j]
    return found


def _decaying(evaluation: Evaluation, longer: Evaluation) -> set[int]:
    """Return the states that move less in longer runs than at the end of the others, wherever references rest there."""
    # A longer run counts until its reference jumps, which starts new swings, and not if that is within a run's length.
    scale = torch.tensor(evaluation.signature.x_scale, dtype=torch.float64)
    n, calm = len(evaluation.time), torch.ones(len(scale), dtype=torch.bool)
    for row in evaluation.resting.nonzero().flatten().tolist():
        reference, until = longer.references[row], n
        until += int((reference[n:] == reference[n - 1]).all(-1).int().cumprod(0).sum())
        ends = [(evaluation, n - evaluation.steady_periods, n), (longer, until - n, until)]
        states = [run.trajectory["state"][row, first:last].double() / scale for run, first, last in ends]
        now, later = (x.amax(0) - x.amin(0) for x in states)
        calm &= later <= (DECAYED * now).clamp_min(UNREST) if until >= 2 * n else now <= UNREST
    return set(calm.nonzero().flatten().tolist())


def _named(evaluation: Evaluation, values: Tensor) -> dict[str, float | None]:
    finite = [value if value < float("inf") else None for value in values.tolist()]
    return dict(zip(evaluation.output_names, finite, strict=True))
