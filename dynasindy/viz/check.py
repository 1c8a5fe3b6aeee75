"""What a model says of a controller: Nyquist curves, steps, worst cases, and from where the plant comes back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from dynasindy.checking import Check, Thresholds
from dynasindy.checking.linear_loop import frequencies, open_loop_response
from dynasindy.checking.simulation import TOLERANCE, diverged_rows
from dynasindy.systems import Signature
from dynasindy.text import format_duration
from dynasindy.viz.style import (
    BLACK,
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SKY,
    array,
    input_axis,
    label,
    legend_above,
    legend_beside,
    panels,
    styled,
    symbol,
    time_axis,
    zero_order_hold,
)

SHOWN = 15
"""Changes of single coefficients that are drawn, the worst first."""
FEW_TICKS = 4
"""Intervals between the ticks of an axis whose numbers have many digits."""
ROOM = 1.3
"""Distance of two ticks, at least [widths of the widest number at one]."""
LISTED = 3
"""Targets without a curve that are listed by name."""
EDGE = 0.08
"""Room between what stays near its target and the edge of an axis that cuts off what runs away [height of the axis]."""
NAMED = 9
"""Loops that have a colour and a name of their own, those that come nearest to -1 first."""


class TrackedOutput(NamedTuple):
    """An output in the figure of a step.

    Attributes:
        name: of the output.
        unit: Its unit.
        target: Where it is to go [unit of the output].
        error: Steady error that passes the check [unit of the output].
        reach: Distance from the target beyond which a plant that ends there has run away [unit of the output].
    """

    name: str
    unit: str
    target: float
    error: float
    reach: float = math.inf


def draw_check(found: Check, thresholds: Thresholds | None = None) -> dict[str, Figure]:
    """Return all figures of a check by name, with the thresholds of its verdict."""
    signature, limits = found.loop.signature, thresholds or Thresholds()
    figures: dict[str, Figure] = {}
    if planes := [(p.names, p.units, p.first, p.second, p.back) for p in found.planes]:
        words = (
            f"Errors from which the model comes back to its rest at {_in_words(found, found.middle)}: within "
            f"{format_duration(found.seconds)} to {100 * TOLERANCE:g} % of each output's range "
            f"(asked for: {100 * limits.recovered:.0f} % of them)"
        )
        figures["recovery"] = draw_recovery(planes, words)
    stable = [k for k, ok in enumerate(found.stable.tolist()) if ok]
    if stable and signature.n_u:
        rows = [found.rest.linear.row(k) for k in stable]
        curves = {
            _target(found, k): open_loop_response(row, frequencies(row)) for k, row in zip(stable, rows, strict=True)
        }
        title = "\n".join(["Loop opened at each input", *_left_out(found)])
        figures["nyquist"] = draw_nyquist(curves, signature.input_names, limits.disk, title)
    figures["steps"] = _steps(found, limits)
    single = slice(found.spread.draws, None)
    if found.spread.labels[single]:
        number = len(stable)
        title = f"Stability if one coefficient is wrong, at the worst of {number} target{'s' * (number > 1)}"
        figures["coefficients"] = draw_stability(found.spread.labels[single], found.spread.worst[single], title)
    return figures


def _target(found: Check, number: int) -> str:
    """Return a target by the names of its outputs: `theta = 0.5 rad`."""
    return _in_words(found, found.targets[number])


def _in_words(found: Check, target: Tensor) -> str:
    signature, outputs = found.loop.signature, found.loop.task.outputs
    values = zip(outputs, target.tolist(), strict=True)
    return ", ".join(f"{symbol(signature.state_names[i])} = {v:.3g} {signature.state_units[i]}" for i, v in values)


def _left_out(found: Check) -> list[str]:
    """Say which targets have no curve of an open loop, and why; nothing if all have one."""
    lost = [k for k, ok in enumerate(found.stable.tolist()) if not ok]
    if not lost:
        return []
    why = {
        "the closed loop is not stable": [k for k in lost if found.rest.still[k]],
        "the closed loop never comes to rest": [k for k in lost if not found.rest.still[k]],
    }
    text = [f"{words} at {_listed(found, ks)}" for words, ks in why.items() if ks]
    return [f"left out, {len(lost)} of {len(found.targets)} targets: {'; '.join(text)}"]


def _listed(found: Check, targets: Sequence[int]) -> str:
    """Return the first few of some targets in words, and how many more there are."""
    words = [f"({_target(found, k)})" for k in targets[:LISTED]]
    more = len(targets) - len(words)
    return ", ".join([*words, *([f"{more} more"] if more else [])])


def _steps(found: Check, limits: Thresholds) -> Figure:
    """Draw the model's step to the farthest target, and those of plants that were drawn around it."""
    signature, outputs, far = found.loop.signature, found.loop.task.outputs, found.farthest
    x, u = found.steps.x[far : far + 1], found.steps.u[far : far + 1]
    if found.drawn is not None:
        x, u = torch.cat([x, found.drawn.x]), torch.cat([u, found.drawn.u])
    names, units, ranges = signature.state_names, signature.state_units, signature.x_scale
    tracked = zip(outputs, found.targets[far].tolist(), found.reach.tolist(), strict=True)
    return draw_steps(
        found.steps.dt,
        array(x[:, :, outputs]),
        array(u),
        [TrackedOutput(names[i], units[i], r, limits.error * ranges[i], reach) for i, r, reach in tracked],
        signature,
        f"Step from {found.beginning(symbol)} to {_target(found, far)}, the farthest target",
        f"coefficients {found.spread.how.by}",
    )


@styled
def draw_nyquist(
    curves: Mapping[str, ArrayLike],
    names: Sequence[str],
    disk: float = Thresholds.disk,
    title: str = "Loop opened at each input",
) -> Figure:
    """Draw the loop opened at each input, one curve per target, and the point -1 that it must not go around.

    Args:
        curves: Loops `(n_omega, n_u)`, complex, by target.
        names: Inputs.
        disk: Least disk margin that passes the check.
        title: of the figure.
    """
    figure, axes = panels(1, len(names), (4.2 * len(names) + 2.2, 4.5), title, sharex=False)
    angle = np.linspace(0, 2 * np.pi, 200)
    # Inside of this circle, some factor between (2 - disk)/(2 + disk) and its inverse makes the loop unstable.
    near, far = -(2 - disk) / (2 + disk), -(2 + disk) / (2 - disk)
    nearest = sorted(curves, key=lambda name: float(np.abs(np.asarray(curves[name]) + 1).min()))
    others = f"{len(curves) - NAMED} others, farther from -1"
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for k, target in enumerate(nearest):
            look: dict[str, Any] = {
                "color": CYCLE[k % len(CYCLE)],
                "linestyle": "-" if k < len(CYCLE) else "--",
                "label": target,
            }
            if k >= NAMED:
                look = {"color": GREY, "linestyle": "-", "label": "_" * (k > NAMED) + others}
            values = np.asarray(curves[target])[:, i]
            axis.plot(values.real, values.imag, linewidth=1.0, zorder=2.5 - 0.01 * k, **look)
        axis.plot(np.cos(angle), np.sin(angle), color=GREY, linestyle=":", linewidth=0.9, label="gain 1")
        text = f"disk margin < {disk:g}"
        axis.add_patch(Circle((0.5 * (near + far), 0), 0.5 * (near - far), color=ORANGE, alpha=0.2, lw=0, label=text))
        axis.plot([-1], [0], color=BLACK, marker="+", markersize=10, linestyle="none", label="critical point -1")
        axis.set_xlim(-3, 1.5)
        axis.set_ylim(-2.25, 2.25)
        axis.set_aspect("equal")
        axis.set_xlabel(f"real part, {label(name)}")
        axis.set_ylabel("imaginary part")
    legend_beside(axes[-1])
    return figure


@styled
def draw_steps(
    dt: float,
    outputs: ArrayLike,
    inputs: ArrayLike,
    tracked: Sequence[TrackedOutput],
    signature: Signature,
    title: str = "Step",
    how: str = "other coefficients",
) -> Figure:
    """Draw a step of the model and of plants that were drawn around it, under one controller.

    Where some run away, so that they end out of reach of the target, the axes end with what stays within reach, and
    the legend says how many are cut off.

    Args:
        dt: Control period [s].
        outputs: `(rows, T + 1, n_r)`; the first row is that of the model, all others are of other plants.
        inputs: `(rows, T, n_u)`, in [-1, 1], likewise; drawn in their own units.
        tracked: What is to be drawn beside each output.
        signature: Tells the inputs, their units and ranges.
        title: of the figure.
        how: What the other plants have that the model has not.
    """
    y, u = array(outputs), array(inputs)
    n_u = signature.n_u
    figure, axes = panels(len(tracked) + n_u, 1, (7.0, 2.1 * len(tracked) + 1.4 * n_u), title)
    seconds = array(dt * np.arange(y.shape[1]))
    targets, reach = np.array([[each.target, each.reach] for each in tracked]).T
    near = np.isfinite(y) & (np.abs(y - targets) <= reach)
    stays = ~diverged_rows(torch.from_numpy(y), torch.from_numpy(targets), torch.from_numpy(reach), dt).numpy()
    looks = _looks(stays, how)
    for i, (axis, output) in enumerate(zip(axes, tracked, strict=False)):
        axis.axhline(output.target, color=BLACK, linestyle="--", linewidth=1.2, label="target")
        for row, look in zip(y, looks, strict=True):
            axis.plot(seconds, row[:, i], **look)
        low, high = output.target - output.error, output.target + output.error
        axis.axhspan(low, high, color=GREY, alpha=0.2, lw=0, label="steady error that passes")
        if not near.all():
            values = y[stays, :, i][near[stays, :, i]]
            low, high = float(values.min(initial=low)), float(values.max(initial=high))
            axis.set_ylim(low - EDGE * (high - low), high + EDGE * (high - low))
        axis.set_ylabel(label(output.name, output.unit))
    for i, axis in enumerate(axes[len(tracked) :]):
        for row, look in zip(signature.in_own_units(u), looks, strict=True):
            axis.step(*zero_order_hold(seconds[:-1], row[:, i]), where="post", **{"linewidth": 1.0, **look})
        input_axis(axis, signature, i)
    legend_above(axes[0])
    time_axis(axes[-1], seconds)
    axes[-1].set_xlim(0, float(seconds[-1]))
    return figure


def _looks(stays: NDArray[np.bool_], how: str) -> list[dict[str, Any]]:
    """Return how the model, the first row, and each other plant are drawn, and named once in the legend."""
    drawn = len(stays) - 1
    away = int((~stays[1:]).sum())
    near = f"{drawn} plants, {how}" if not away else f"{drawn - away} of {drawn} plants, {how}"
    words = {True: near, False: f"{away} of these {drawn} that run away, cut off at the edges"}
    model = "the model itself" if stays[0] else "the model itself, which runs away"
    looks: list[dict[str, Any]] = [{"color": BLUE, "zorder": 3, "label": model}]
    for held_near in stays[1:].tolist():
        color, text = SKY if held_near else ORANGE, words.pop(held_near, "_")
        looks.append({"color": color, "linewidth": 0.8, "label": text})
    return looks


@styled
def draw_stability(
    labels: Sequence[str], radius: ArrayLike, title: str = "Stability if one coefficient is wrong"
) -> Figure:
    """Draw the spectral radius with each change, the worst first; what never rests is drawn at the right edge.

    Args:
        labels: What is changed.
        radius: Spectral radius, `(n,)`, infinite where the loop never rests.
        title: of the figure.
    """
    values = array(radius)
    order = np.argsort(-values)[:SHOWN]
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=1.0)), float(finite.max(initial=1.0))
    edge = high + 0.1 * max(high - low, 1e-3)
    if len(order) < len(values):
        title += f": the worst {len(order)} of {len(values)} changes"
    figure, (axis,) = panels(1, 1, (9.0, 0.26 * len(order) + 1.2), title)
    places, worst = np.arange(len(order))[::-1], values[order]
    kinds: dict[str, tuple[NDArray[np.bool_], dict[str, Any]]] = {
        "stable": (worst < 1, {"color": GREEN}),
        "not stable": ((worst >= 1) & np.isfinite(worst), {"color": RED}),
        "never comes to rest, drawn at the edge": (~np.isfinite(worst), {"color": RED, "marker": ">"}),
    }
    for words, (these, look) in kinds.items():
        if these.any():
            shown = np.where(np.isfinite(worst[these]), worst[these], edge)
            axis.scatter(shown, places[these], zorder=3, label=words, **look)
    axis.set_yticks(places, [_plain(labels[k]) for k in order])
    axis.axvline(1.0, color=BLACK, linestyle="--", linewidth=1.0, label="limit of stability")
    axis.set_xlabel("largest spectral radius (stable below 1)")
    legend_beside(axis)
    _limit_and_ticks_beside_it(figure, axis)
    return figure


def _limit_and_ticks_beside_it(figure: Figure, axis: Axes) -> None:
    """Give the limit of stability a tick, and others as many as there is room for their numbers.

    Long names of changes leave a narrow axis, so the room is known only when all else has its place.
    """
    left, right = axis.get_xlim()
    ticks = [1.0, *(tick for tick in MaxNLocator(FEW_TICKS).tick_values(left, right) if left <= tick <= right)]
    axis.set_xticks(ticks)
    figure.draw_without_rendering()
    widest = max(number.get_window_extent().width for number in axis.get_xticklabels())
    room = ROOM * widest / axis.bbox.width * (right - left)
    kept: list[float] = []
    for tick in sorted(ticks, key=lambda tick: abs(tick - 1)):
        if all(abs(tick - other) >= room for other in kept):
            kept.append(tick)
    axis.set_xticks(sorted(kept))


Drawn = tuple[tuple[str, str], tuple[str, str], ArrayLike, ArrayLike, ArrayLike]


@styled
def draw_recovery(planes: Sequence[Drawn], title: str = "Comes back from these errors") -> Figure:
    """Draw from which initial errors a plant comes back, one panel per pair of states.

    Args:
        planes: Names, units, errors of the first and the second state `(n,)`, and whether it comes back `(n, n)`.
        title: of the figure.
    """
    figure, axes = panels(1, max(1, len(planes)), (max(6.0, 3.6 * len(planes)), 3.8), title, sharex=False)
    for axis, (names, units, first, second, back) in zip(axes, planes, strict=False):
        axis.pcolormesh(
            array(first), array(second), array(back).T, cmap=ListedColormap([RED, GREEN]), vmin=0, vmax=1, alpha=0.6
        )
        axis.set_title(f"{100 * np.mean(array(back)):.0f} % come back")
        _named(axis, names, units)
    handles = [
        Patch(color=color, alpha=0.6, label=words) for color, words in ((GREEN, "comes back"), (RED, "does not"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _named(axis: Axes, names: tuple[str, str], units: tuple[str, str]) -> None:
    axis.set_xlabel(f"error of {label(names[0], units[0])}")
    axis.set_ylabel(f"error of {label(names[1], units[1])}")


def _plain(text: str) -> str:
    """Return a name as it stands: a dollar sign would begin mathematics."""
    return text.replace("$", r"\$")
