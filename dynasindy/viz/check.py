"""What a model says of a controller: Nyquist curves, steps, worst cases, and from where the plant comes back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from numpy.typing import ArrayLike

from dynasindy.checking import Check, Thresholds
from dynasindy.checking.margins import broken, frequencies
from dynasindy.viz.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    array,
    held,
    label,
    legend_above,
    panels,
    styled,
)

SHOWN = 15
"""Changes of single coefficients that are drawn, the worst first."""


def draw(found: Check) -> dict[str, Figure]:
    """Return all figures of a check by name."""
    signature, outputs = found.loop.signature, found.loop.task.outputs
    figures: dict[str, Figure] = {}
    if planes := [(p.names, p.units, p.first, p.second, p.back) for p in found.planes]:
        figures["recovery"] = recovery(planes, "Comes back from these errors, on the model")
    stable = [k for k, ok in enumerate(found.stable.tolist()) if ok]
    if stable and signature.n_u:
        rows = [found.rest.linear.row(k) for k in stable]
        curves = [broken(row, frequencies(row)) for row in rows]
        figures["nyquist"] = nyquist(curves, signature.input_names)
    drawn = found.drawn or found.steps
    figures["steps"] = steps(
        drawn.dt,
        array(drawn.x[:, :, outputs]),
        array(drawn.u),
        array(drawn.r[0]),
        [(signature.state_names[i], signature.state_units[i]) for i in outputs],
        signature.input_names,
    )
    single = slice(found.spread.draws, None)
    if found.spread.labels[single]:
        figures["coefficients"] = coefficients(found.spread.labels[single], found.spread.worst[single])
    return figures


@styled
def nyquist(
    curves: Sequence[ArrayLike],
    names: Sequence[str],
    disk: float = Thresholds.disk,
    title: str = "Loop opened at each input",
) -> Figure:
    """Draw the loop opened at each input, one curve per target, and the point -1 that it must not go around.

    Args:
        curves: Loops `(n_omega, n_u)`, complex, one per target.
        names: Inputs.
        disk: Least disk margin that passes the check.
        title: of the figure.
    """
    figure, axes = panels(1, len(names), (4.2 * len(names), 4.5), title, sharex=False)
    angle = np.linspace(0, 2 * np.pi, 200)
    # Inside of this circle, some factor between (2 - disk)/(2 + disk) and its inverse makes the loop unstable.
    near, far = -(2 - disk) / (2 + disk), -(2 + disk) / (2 - disk)
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for k, curve in enumerate(curves):
            values = np.asarray(curve)[:, i]
            axis.plot(values.real, values.imag, color=BLUE, alpha=0.6, linewidth=1.0, label="loop" if not k else None)
        axis.plot(np.cos(angle), np.sin(angle), color=GREY, linestyle=":", linewidth=0.9, label="gain 1")
        told = f"disk margin < {disk:g}"
        axis.add_patch(Circle((0.5 * (near + far), 0), 0.5 * (near - far), color=ORANGE, alpha=0.2, lw=0, label=told))
        axis.plot([-1], [0], color=RED, marker="+", markersize=10, linestyle="none", label="-1")
        axis.set_xlim(-3, 1.5)
        axis.set_ylim(-2.25, 2.25)
        axis.set_aspect("equal")
        axis.set_xlabel(f"real part, {label(name)}")
        axis.set_ylabel("imaginary part")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@styled
def steps(
    dt: float,
    outputs: ArrayLike,
    inputs: ArrayLike,
    reference: ArrayLike,
    names: Sequence[tuple[str, str]],
    input_names: Sequence[str],
    title: str = "Step with plants that the model might have meant",
) -> Figure:
    """Draw steps of many plants under one controller.

    Args:
        dt: Control period [s].
        outputs: `(rows, T + 1, n_r)`.
        inputs: `(rows, T, n_u)`, in [-1, 1].
        reference: `(n_r,)`.
        names: Name and unit of each output.
        input_names: Inputs.
        title: of the figure.
    """
    y, u, r = array(outputs), array(inputs), array(reference)
    figure, axes = panels(len(names) + len(input_names), 1, (7.0, 2.1 * len(names) + 1.4 * len(input_names)), title)
    seconds = array(dt * np.arange(y.shape[1]))
    for i, (axis, (name, unit)) in enumerate(zip(axes, names, strict=False)):
        axis.axhline(r[i], color=BLACK, linestyle="--", linewidth=1.2, label="target")
        lines = axis.plot(seconds, y[:, :, i].T, color=BLUE, alpha=0.4, linewidth=0.8)
        lines[0].set_label(f"{len(y)} plants")
        axis.set_ylabel(label(name, unit))
    for i, (axis, name) in enumerate(zip(axes[len(names) :], input_names, strict=True)):
        axis.step(*held(seconds[:-1], u[:, :, i].T), where="post", color=BLUE, alpha=0.4, linewidth=0.8)
        axis.set_ylim(-1.08, 1.08)
        axis.set_ylabel(label(name, "-"))
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0, float(seconds[-1]))
    return figure


@styled
def coefficients(
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
    figure, (axis,) = panels(1, 1, (9.0, 0.26 * len(order) + 1.2), title)
    places = np.arange(len(order))[::-1]
    shown = np.where(np.isfinite(values[order]), values[order], edge)
    axis.scatter(shown, places, color=np.where(values[order] < 1, GREEN, RED), zorder=3)
    axis.set_yticks(places, [_plain(labels[k]) for k in order])
    axis.axvline(1.0, color=BLACK, linestyle="--", linewidth=1.0)
    axis.set_xlabel("largest spectral radius (stable below 1)")
    return figure


Drawn = tuple[tuple[str, str], tuple[str, str], ArrayLike, ArrayLike, ArrayLike]


@styled
def recovery(planes: Sequence[Drawn], title: str = "Comes back from these errors") -> Figure:
    """Draw from which initial errors a plant comes back, one panel per pair of states.

    Args:
        planes: Names, units, errors of the first and the second state `(n,)`, and whether it comes back `(n, n)`.
        title: of the figure.
    """
    figure, axes = panels(1, max(1, len(planes)), (3.6 * max(1, len(planes)), 3.6), title, sharex=False)
    for axis, (names, units, first, second, back) in zip(axes, planes, strict=False):
        axis.pcolormesh(
            array(first), array(second), array(back).T, cmap=ListedColormap([RED, GREEN]), vmin=0, vmax=1, alpha=0.6
        )
        axis.set_title(f"{np.mean(array(back)):.0%} come back")
        _named(axis, names, units)
    told = [Patch(color=color, alpha=0.6, label=words) for color, words in ((GREEN, "comes back"), (RED, "does not"))]
    figure.legend(handles=told, loc="outside lower center", ncols=2)
    return figure


def _named(axis: Axes, names: tuple[str, str], units: tuple[str, str]) -> None:
    axis.set_xlabel(f"error of {label(names[0], units[0])}")
    axis.set_ylabel(f"error of {label(names[1], units[1])}")


def _plain(text: str) -> str:
    """Return a name as it stands: a dollar sign would begin mathematics."""
    return text.replace("$", r"\$")
