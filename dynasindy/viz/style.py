"""The one style of all figures: colours, labels with units, saving; pyplot and its global state stay out."""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from dynasindy.data.rates import NAMED
from dynasindy.progress import report_progress
from dynasindy.safe_io import replace_file
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.text import TimeUnit, duration_unit

P = ParamSpec("P")
T = TypeVar("T")
Array = NDArray[np.float64]

BLACK, ORANGE, SKY, GREEN, BLUE, RED, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
"""Colour-blind safe palette (Okabe and Ito 2008); black is always the reference or the real plant."""
CYCLE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
GREY = "#7f7f7f"
DIVERGED = "ran away, above the axis"
ROW = 95
"""Letters that a row of a legend above an axis holds."""
LEGEND = 60
"""Letters that a row of a legend beside an axis holds."""

# Any: the stubs want a literal type of every setting.
STYLE: Any = {
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.formatter.useoffset": False,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    # The same data give the same file, byte for byte.
    "svg.hashsalt": "dynasindy",
}

WORDS = {
    "alpha_a": "azimuth",
    "alpha_p": "pitch",
    "Omega_a": "azimuth rate",
    "Omega_p": "pitch rate",
    "omega_a": "tail rotor speed",
    "omega_p": "main rotor speed",
    "u_a": "tail input",
    "u_p": "main input",
}
GREEK = ("alpha", "beta", "theta", "phi", "psi", "omega", "Omega")


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Make a figure function draw in the module's style without leaving a trace in matplotlib's settings."""

    @wraps(draw)
    def _drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return _drawn


def panels(
    rows: int, columns: int = 1, size: tuple[float, float] = (7.0, 4.0), title: str = "", sharex: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `size` [inch] and its axes row by row; a long line of the title becomes several."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=sharex, squeeze=False)
    for axis in axes.flat:
        axis.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10]))
    if title:
        letters = int(11 * size[0])  # some eleven an inch
        figure.suptitle("\n".join(row for line in title.split("\n") for row in _wrap_title(line, letters)), fontsize=11)
    return figure, list(axes.flat)


def _wrap_title(line: str, letters: int) -> list[str]:
    """Return a line as few lines of at most so many letters, which break between clauses or are of equal length."""
    if len(line) <= letters:
        return [line]
    clauses = re.split(r"(?<=[;:.]) ", line)
    rows = clauses[:1]
    for clause in clauses[1:]:
        joined = f"{rows[-1]} {clause}"
        rows = [*rows[:-1], joined] if len(joined) <= letters else [*rows, clause]
    fewest = len(textwrap.wrap(line, letters))
    if len(rows) == fewest and max(map(len, rows)) <= letters:
        return rows
    narrow = next(n for n in range(1, letters + 1) if len(textwrap.wrap(line, n, break_long_words=False)) <= fewest)
    return textwrap.wrap(line, max(narrow, max(map(len, line.split()))), break_long_words=False)


def symbol(name: str) -> str:
    r"""Return a name as mathematics: `alpha_a` becomes `$\alpha_a$`; one that is no symbol stays as it is.

    Mathematics would lose spaces, and several `_` are no subscript. Nor is a rate the subscript of its angle, and a
    word such as `angle` is no product of letters.
    """
    head, _, tail = name.partition("_")
    if not head.isalnum() or not (tail.isalnum() or head == name):
        return name
    if (head.isalpha() and len(head) > 1 and head not in GREEK) or f"{{}}_{tail}" in NAMED:
        return name
    head = rf"\{head}" if head in GREEK else head
    return f"${head}_{{{tail}}}$" if tail else f"${head}$"


def label(name: str, unit: str = "") -> str:
    """Return an axis label: the quantity in words, its symbol and its unit."""
    words = f"{WORDS[name]} " if name in WORDS else ""
    return f"{words}{symbol(name)}" + (f" [{unit}]" if unit else "")


def spell_names(text: str) -> str:
    """Return a text with words for the names of the twin rotor, and units with raised exponents.

    What a plant's equation makes of a state is told with a stroke, `Omega_a'`, and is the change of it. Names of other
    plants stay: they may be single letters, as units are.
    """
    for name, words in WORDS.items():
        text = re.sub(rf"\b{name}'", f"change of {words}", text)
        text = re.sub(rf"\b{name}\b", words, text)
    return text.replace("^2", "²")


def input_axis(axis: Axes, signature: Signature, place: int) -> None:
    """Label the axis of an input and give it the range of its actuator, in the unit of this.

    Args:
        axis: Where.
        signature: Tells the input's name, its unit and its range.
        place: Which input.
    """
    limits = signature.input_limits or ((-1.0, 1.0),) * signature.n_u
    low, high = signature.in_own_units(np.array(limits).T)[:, place]
    room = 0.04 * (high - low)
    axis.set_ylim(low - room, high + room)
    unit = signature.input_units[place] if signature.input_units else "-"
    if unit == "-" and signature.input_ends and signature.input_ends[place] != WHOLE:
        unit = "unit of its actuator"
    axis.set_ylabel(label(signature.input_names[place], unit))


def array(values: ArrayLike) -> Array:
    """Return values, a tensor included, as a float64 array."""
    return np.asarray(values, dtype=np.float64)


def time_span(seconds: Array) -> tuple[float, float]:
    """Return the start and the end of a run in time: the last sample is held for a period, too.

    A start or an end that misses a whole second by less than a period is drawn at it, as every other sample is saved.
    """
    start, last = float(seconds[0]), float(seconds[-1])
    period = last - float(seconds[-2]) if len(seconds) > 1 else 0.0
    end = np.ceil(last) if 0 < np.ceil(last) - last <= period + 1e-9 else last + period
    return 0.0 if 0 < start < period + 1e-9 else start, round(float(end), 9)


def time_axis(axis: Axes, seconds: ArrayLike, words: str = "time") -> None:
    """Label an axis whose data are in seconds, with ticks in the unit in which its length is told: s, min or h.

    Args:
        axis: Where; figures that share it are told, too.
        seconds: The times that it shows, or its two ends [s]; `span` gives those of a run.
        words: What it shows.
    """
    unit = duration_unit(float(np.ptp(array(seconds)))) if np.size(seconds) else duration_unit(0.0)
    TIMED[axis] = words, unit
    _label_time_axis(axis, words, unit)


TIMED: WeakKeyDictionary[Axes, tuple[str, TimeUnit]] = WeakKeyDictionary()
"""Axes of time, with what they show and the unit that they have by themselves."""


def _share_time_unit(figures: Iterable[Figure]) -> None:
    """Tell the times of all figures in one unit, the smallest of those that they have by themselves."""
    timed = [(axis, *TIMED[axis]) for figure in figures for axis in figure.axes if axis in TIMED]
    for axis, words, _ in timed:
        _label_time_axis(axis, words, min((unit for *_, unit in timed), key=lambda unit: unit.seconds))


def _label_time_axis(axis: Axes, words: str, unit: TimeUnit) -> None:
    axis.set_xlabel(f"{words} [{unit.name}]")
    if unit.seconds != 1 or isinstance(axis.xaxis.get_major_locator(), _Scaled):  # which had another unit before
        axis.xaxis.set_major_locator(_Scaled(unit.seconds))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / unit.seconds:g}"))


class _Scaled(MaxNLocator):
    """Ticks at round values of a unit that is so many times that of the data."""

    def __init__(self, unit: float) -> None:
        super().__init__(steps=[1, 2, 5, 10])
        self.unit = unit

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Return the places of the ticks between two values, in the unit of the data."""
        return [self.unit * tick for tick in super().tick_values(vmin / self.unit, vmax / self.unit)]


def zero_order_hold(seconds: Array, values: Array) -> tuple[Array, Array]:
    """Return times and values of an input that is held, its last sample up to the end of the run."""
    return np.append(seconds, time_span(seconds)[1]), np.concatenate([values, values[-1:]])


def format_number(value: float) -> str:
    """Return a number with three digits, or all those before the point."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def draw_named_values(axis: Axes, values: Mapping[str, tuple[float, str]], what: str) -> None:
    """Draw single values along an axis, one below the other, each with its name in front and its number beside it.

    Args:
        axis: Where.
        values: Value, NaN if there is none, and colour by name.
        what: Label of the axis.
    """
    for height, (value, color) in enumerate(values.values()):
        if np.isfinite(value):
            axis.plot(value, height, color=color, marker="o", markersize=6)
            at = (value, height)
            ground = {"facecolor": "white", "linewidth": 0, "pad": 1}  # the line of the grid would run through it
            axis.annotate(
                format_number(value), at, (8, 0), textcoords="offset points", va="center", color=color, bbox=ground
            )
    axis.set_yticks(range(len(values)), list(values))
    axis.set_ylim(len(values) - 0.5, -0.5)
    axis.set_xlabel(what)


def label_single_point(axis: Axes, x: Array, y: Array, color: str) -> None:
    """Write its value beside a curve that has only one point, which is easily overlooked."""
    seen = np.isfinite(y)
    if seen.sum() == 1:
        axis.plot(x[seen], y[seen], color=color, marker="o", markersize=5, linestyle="none")
        axis.annotate(
            f"{y[seen][0]:.3g}", (x[seen][0], y[seen][0]), (7, 0), textcoords="offset points", va="center", color=color
        )


def legend_above(axis: Axes) -> None:
    """Put the legend above an axis: what moves leaves no corner free."""
    named = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))  # what is drawn twice is told once
    labels = list(named)
    # An entry takes its letters and a sample of its line; more than a row holds would press the axis together.
    rows = -(-sum(len(label) + 6 for label in labels) // ROW)
    columns = max(1, -(-len(labels) // max(1, rows)))
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": columns}
    axis.legend(list(named.values()), labels, **place, columnspacing=1.2, handlelength=1.6)


def legend_beside(axis: Axes) -> None:
    """Put the legend to the right of an axis, where no line can run through it; what is drawn twice is told once."""
    named = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    words = [textwrap.fill(name, LEGEND) for name in named]
    axis.legend(list(named.values()), words, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def mark_divergence(axis: Axes, x: Array, color: str) -> None:
    """Mark at the upper edge of an axis, whose limits end with this, where an error was not finite."""
    low, top = axis.get_ylim()
    axis.set_ylim(low, top)
    if len(x):
        look: dict[str, Any] = {"marker": "^", "markersize": 6, "linestyle": "none", "clip_on": False, "zorder": 3}
        axis.plot(x, np.full(len(x), top), color=color, label=DIVERGED, **look)


def save_all(figures: Mapping[str, Figure], folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Write figures that belong together, their times in one unit, as `folder/NAME`, and return the files."""
    _share_time_unit(figures.values())
    return [file for name, figure in figures.items() for file in save(figure, folder / name, formats)]


def save(figure: Figure, path: str | Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Write a figure once per format as `path` with the format's suffix and return the files."""
    target = Path(path)
    report_progress("figures", note=target.name)
    files = [target.with_name(f"{target.name}.{suffix}") for suffix in formats]
    with matplotlib.rc_context(STYLE):
        for place, suffix in zip(files, formats, strict=True):
            # Dates would make equal figures differ.
            metadata = {"Date": None} if suffix in ("svg", "pdf") else None
            with replace_file(place) as file:
                figure.savefig(file, format=suffix, metadata=metadata)
    return files
