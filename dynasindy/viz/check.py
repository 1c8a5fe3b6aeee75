"""What a model says of a controller: Nyquist curves, steps, worst cases, and from where the plant comes back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from torch import Tensor

from dynasindy.evaluation.check import TOLERANCE, Check, Thresholds
from dynasindy.evaluation.linear_loop import frequencies, open_loop_response
from dynasindy.text import format_duration, unit_suffix
from dynasindy.viz import style

EDGE = 0.08
"""Room between what stays near its target and the edge of an axis that cuts off what runs away [height of the axis]."""
NAMED = 9
"""Loops that have a colour and a name of their own, those that come nearest to -1 first."""


@style.styled
def draw_check(found: Check) -> dict[str, Figure]:
    """Return all figures of a check by name, with the thresholds of its verdict.

    * `recovery`: from which initial errors the plant comes back, a panel per pair of states;
    * `nyquist`: the loop opened at each input, a curve per target, and the point -1 that it must not go around;
    * `steps`: the model's step to the farthest target, and those of plants that were drawn around it. Where some run
      away, the axes end with what stays within reach, and the legend says how many are cut off.
    """
    figures: dict[str, Figure] = {}
    if found.planes:
        figures["recovery"] = _recovery(found)
    if found.stable.any() and found.loop.signature.n_u:
        figures["nyquist"] = _nyquist(found)
    figures["steps"] = _steps(found)
    return figures


def _in_words(found: Check, target: Tensor) -> str:
    """Return a target by the names of its outputs: `theta = 0.5 rad`."""
    signature, outputs = found.loop.signature, found.loop.task.outputs
    values = zip(outputs, target.tolist(), strict=True)
    return ", ".join(
        f"{style.symbol(signature.state_names[i])} = {v:.3g}{unit_suffix(signature.state_units[i])}" for i, v in values
    )


def _nyquist(found: Check) -> Figure:
    names, disk, count = found.loop.signature.input_names, Thresholds.disk, len(found.targets)
    rows = {k: found.rest.linear.row(k) for k, ok in enumerate(found.stable.tolist()) if ok}
    curves = {
        _in_words(found, found.targets[k]): np.asarray(open_loop_response(row, frequencies(row)))
        for k, row in rows.items()
    }
    lost = f"; left out, as the closed loop is not stable: {count - len(rows)} of {count} targets"
    title = f"Loop opened at each input{lost * (len(rows) < count)}"
    figure, axes = style.panels(1, len(names), (4.2 * len(names) + 2.2, 4.5), title, sharex=False)
    angle = np.linspace(0, 2 * np.pi, 200)
    # Inside of this circle, some factor between (2 - disk)/(2 + disk) and its inverse makes the loop unstable.
    near, far = -(2 - disk) / (2 + disk), -(2 + disk) / (2 - disk)
    nearest = sorted(curves, key=lambda name: float(np.abs(curves[name] + 1).min()))
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for k, target in enumerate(nearest):
            look: dict[str, Any] = {
                "color": style.CYCLE[k % len(style.CYCLE)],
                "linestyle": "-" if k < len(style.CYCLE) else "--",
            }
            look["label"] = target
            if k >= NAMED:
                look = {"color": style.GREY, "label": f"{len(curves) - NAMED} others, farther from \N{MINUS SIGN}1"}
            values = curves[target][:, i]
            axis.plot(values.real, values.imag, linewidth=1.0, zorder=2.5 - 0.01 * k, **look)
        axis.plot(np.cos(angle), np.sin(angle), color=style.GREY, linestyle=":", linewidth=0.9, label="gain 1")
        text = f"disk margin < {disk:g}"
        axis.add_patch(
            Circle((0.5 * (near + far), 0), 0.5 * (near - far), color=style.ORANGE, alpha=0.2, lw=0, label=text)
        )
        axis.plot([-1], [0], "k+", markersize=10, label="critical point \N{MINUS SIGN}1")
        axis.set(xlim=(-3, 1.5), ylim=(-2.25, 2.25), aspect="equal")
        axis.set(xlabel=f"real part, {style.label(name)}", ylabel="imaginary part")
    style.legend(axes[-1])
    return figure


def _steps(found: Check) -> Figure:
    signature, outputs, far, dt = found.loop.signature, found.loop.task.outputs, found.farthest, found.steps.dt
    x, u, r = (torch.cat([getattr(found.steps, part)[[far]], getattr(found.drawn, part)]) for part in "xur")
    flights = replace(found.drawn, x=x, u=u, r=r)
    y, inputs = style.array(x[..., outputs]), style.array(u)
    targets, reach = style.array(found.targets[far]), style.array(found.reach)
    title = f"Farthest step, to {_in_words(found, found.targets[far])}"
    n_r, names = len(outputs), [*(signature.state_names[k] for k in outputs), *signature.input_names]
    units = [*(signature.state_units[k] for k in outputs), *("-" for _ in signature.input_names)]
    figure, axes = style.time_panels(names, units, title)
    seconds = style.array(dt * np.arange(y.shape[1]))
    near = np.isfinite(y) & (np.abs(y - targets) <= reach)
    stays = ~flights.away(found.reach).numpy()
    how, drawn, away = f"coefficients {found.spread.how.partition(', ')[0]}", len(y) - 1, int((~stays[1:]).sum())
    words = {
        True: f"{drawn - away} of {drawn} plants, {how}" if away else f"{drawn} plants, {how}",
        False: f"{away} of these {drawn} that run away, cut off at the edges",
    }
    model = "the model itself" if stays[0] else "the model itself, which runs away"
    # The others lie broad below the model, which they often coincide with, and would not be seen behind it.
    looks: list[dict[str, Any]] = [{"color": style.BLUE, "linewidth": 0.9, "zorder": 2.5, "label": model}]
    looks += (
        {"color": style.SKY if it else style.ORANGE, "linewidth": 2.5, "label": words[it]} for it in stays[1:].tolist()
    )
    for i, axis in enumerate(axes[:n_r]):
        axis.axhline(targets[i], color=style.BLACK, linestyle="--", linewidth=1.2, zorder=2.6, label="target")
        for row, look in zip(y, looks, strict=True):
            axis.plot(seconds, row[:, i], **look)
        error = Thresholds.error * float(found.loop.task.boxes()[i])
        low, high = targets[i] - error, targets[i] + error
        axis.axhspan(low, high, color=style.GREY, alpha=0.2, lw=0, label="steady error that passes")
        if not near.all():
            values = y[stays, :, i][near[stays, :, i]]
            low, high = float(values.min(initial=low)), float(values.max(initial=high))
            axis.set_ylim(low - EDGE * (high - low), high + EDGE * (high - low))
    for i, axis in enumerate(axes[n_r:]):
        for row, look in zip(inputs, looks, strict=True):
            style.draw_input(axis, seconds[:-1], row, signature, i, **look)
    style.legend(axes[0], below=True)
    style.time_axis(figure, seconds)
    style.cut_time(figure)
    return figure


def _recovery(found: Check) -> Figure:
    title = (
        f"Errors that shrink to {100 * TOLERANCE:g} % of the range within {format_duration(found.seconds)} "
        f"(asked: {100 * Thresholds.recovered:.0f} % of them)"
    )
    planes, colors = found.planes, ListedColormap([style.RED, style.GREEN])
    figure, axes = style.panels(1, len(planes), (max(6.0, 3.6 * len(planes)), 3.8), title, sharex=False)
    for axis, plane in zip(axes, planes, strict=True):
        back = style.array(plane.back)
        axis.pcolormesh(
            style.array(plane.first), style.array(plane.second), back.T, cmap=colors, vmin=0, vmax=1, alpha=0.6
        )
        x, y = (f"error of {style.label(*of)}" for of in zip(plane.names, plane.units, strict=True))
        axis.set(title=f"{100 * np.mean(back):.0f} % come back", xlabel=x, ylabel=y)
    handles = [
        Patch(color=color, alpha=0.6, label=text)
        for color, text in ((style.GREEN, "comes back"), (style.RED, "does not"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure
