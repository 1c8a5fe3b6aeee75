"""A figure as numbers: what a page needs to draw it again, with zoom, read-out and switches.

An artist whose label is `_NAME` belongs to the series NAME, without an entry of its own in the legend; a line that is
not visible is a single seed of its series.
"""

from __future__ import annotations

import re
from typing import Any
from unicodedata import lookup

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from dynasindy.viz.learning import LINEAR
from dynasindy.viz.style import Array

DIGITS, FINER = 4, 7
"""Significant digits of the numbers that a page reads out, and of limits and times."""
DASHES = {"-": "", "--": "6 3", ":": "2 3", "-.": "6 3 2 3"}
GREEK = {
    name: lookup(f"GREEK {'CAPITAL' if name[0].isupper() else 'SMALL'} LETTER {name.upper()}")
    for name in ("alpha", "beta", "theta", "phi", "psi", "omega", "Omega", "Xi")
}


def chart(figure: Figure) -> dict[str, Any] | None:
    """Return title, columns and panels of a figure, ready for JSON; None of a drawing without axes."""
    axes = [axis for axis in figure.axes if axis.axison and axis.get_visible()]
    if not axes:
        return None
    specification = axes[0].get_subplotspec()
    columns = specification.get_gridspec().ncols if specification else 1
    return {"title": plain(figure.get_suptitle()), "columns": columns, "panels": [_panel(axis) for axis in axes]}


def plain(words: str) -> str:
    r"""Return words with their mathematics as letters: `azimuth $\alpha_{a}$ [rad]` is `azimuth α_a [rad]`."""

    def _letters(formula: re.Match[str]) -> str:
        greek = re.sub(r"\\([A-Za-z]+)", lambda name: GREEK.get(name[1], name[1]), formula[1])
        return re.sub(r"_\{(\w+)\}", r"_\1", greek)

    return re.sub(r"(?<!\\)\$([^$]+)(?<!\\)\$", _letters, words).replace(r"\$", "$")


def _panel(axis: Axes) -> dict[str, Any]:
    panel: dict[str, Any] = {
        "x": [*map(_rounded, axis.get_xlim()), axis.get_xscale()],
        "y": [*map(_rounded, axis.get_ylim()), axis.get_yscale()],
        "xlabel": plain(axis.get_xlabel()),
        "ylabel": plain(axis.get_ylabel()),
        "title": plain(axis.get_title() or axis.get_title(loc="right")),
        "notes": [],
        "lines": [],
        "bands": [],
        "spans": [],
    }
    if "symlog" in (axis.get_xscale(), axis.get_yscale()):
        panel["linear"] = LINEAR
    seeds: dict[str, int] = {}
    for line in axis.lines:
        if not len(array := np.asarray(line.get_xdata(orig=False), dtype=np.float64)):
            panel["notes"].append(_name(line))  # an entry of the legend that explains others
            continue
        shown = _line(line, axis, array)
        if not line.get_visible():
            shown["seed"] = seeds[shown["name"]] = seeds.get(shown["name"], 0) + 1
        panel["lines"].append(shown)
    panel["bands"] += [_band(fill) for fill in axis.collections if isinstance(fill, PolyCollection)]
    panel["spans"] += [_span(patch, axis) for patch in axis.patches if isinstance(patch, Rectangle)]
    return panel


def _name(artist: Any) -> str:
    """Return the series of an artist; empty where it has no name of its own."""
    label = str(artist.get_label())
    return "" if re.fullmatch(r"_child\d+", label) else plain(label.removeprefix("_"))


def _line(line: Line2D, axis: Axes, x: Array) -> dict[str, Any]:
    y = np.asarray(line.get_ydata(orig=False), dtype=np.float64)
    found: dict[str, Any] = {
        "name": _name(line),
        "color": to_hex(line.get_color()),
        "dash": DASHES.get(str(line.get_linestyle())),
        "width": line.get_linewidth(),
    }
    if line.get_transform() == axis.get_yaxis_transform(which="grid"):
        return found | {"level": _rounded(y[0])}
    if line.get_transform() == axis.get_xaxis_transform(which="grid"):
        return found | {"at": _rounded(x[0])}
    if str(line.get_drawstyle()) == "steps-post":
        found["step"] = 1
    if line.get_marker() not in (None, "None", "none", ""):
        found |= {"dot": line.get_markersize() / 2, "ring": int(str(line.get_markerfacecolor()) == "none")}
    if (alpha := line.get_alpha()) is not None:
        found["alpha"] = alpha
    return found | {"x": _numbers(x), "y": _numbers(y)}


def _band(fill: PolyCollection) -> dict[str, Any]:
    """Return a band by its outline, there and back."""
    (vertices, *_) = (path.vertices for path in fill.get_paths())
    outline = np.asarray(vertices, dtype=np.float64)
    colour = to_hex(_opaque(fill))
    return {"name": _name(fill), "color": colour, "alpha": fill.get_alpha() or 1.0, "x": _numbers(outline[:, 0])} | {
        "y": _numbers(outline[:, 1])
    }


def _span(patch: Rectangle, axis: Axes) -> dict[str, Any]:
    """Return what is shaded: a stretch of x over the whole height, or of y over the whole width."""
    found = {"name": _name(patch), "color": to_hex(_opaque(patch)), "alpha": patch.get_alpha() or 1.0}
    if patch.get_transform() == patch.get_patch_transform() + axis.get_xaxis_transform(which="grid"):
        return found | {"x": [_rounded(patch.get_x()), _rounded(patch.get_x() + patch.get_width())]}
    return found | {"y": [_rounded(patch.get_y()), _rounded(patch.get_y() + patch.get_height())]}


def _opaque(artist: Any) -> Any:
    return tuple(np.reshape(artist.get_facecolor(), (-1, 4))[0, :3])


def _rounded(value: float, digits: int = FINER) -> float:
    return float(f"{value:.{digits}g}")


def _numbers(values: Array) -> list[float | None] | dict[str, float]:
    """Return numbers of few digits, evenly spaced ones by their first, their step and their count."""
    rounded = [_rounded(value, DIGITS) if np.isfinite(value) else None for value in values.tolist()]
    if len(values) > 3 and np.isfinite(values).all():
        steps = np.diff(values)
        if steps[0] and np.allclose(steps, steps[0], rtol=1e-6, atol=0):
            return {"first": _rounded(values[0]), "step": _rounded(float(steps.mean())), "count": len(values)}
    return rounded
