"""The one style of all figures: colours, labels with units, saving; pyplot and its global state stay out."""

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from dynasindy.data.headings import RATE_NAMES
from dynasindy.progress import report_progress
from dynasindy.safe_io import replace_file
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.text import duration_unit

P = ParamSpec("P")
T = TypeVar("T")
Array = NDArray[np.float64]

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
"""Colour-blind safe palette (Okabe and Ito 2008); black is always the reference or the real plant."""
CYCLE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
GREY = "#7f7f7f"
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
    "path.simplify_threshold": 0.5,  # pixels: lines of a hundred thousand samples are drawn in half the time
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
GREEK = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu"),
    *("xi", "pi", "rho", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega"),
    *("Gamma", "Delta", "Theta", "Lambda", "Xi", "Pi", "Sigma", "Upsilon", "Phi", "Psi", "Omega"),
)
MINUS = re.compile(r"(?<![\w.$}\])-])-(?=[\d.])")
"""The sign of a number, no hyphen."""


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
        title = MINUS.sub("\N{MINUS SIGN}", title)
        letters = int(11 * size[0])  # some eleven an inch
        lines = [textwrap.fill(line, letters, break_long_words=False) for line in title.split("\n")]
        figure.suptitle("\n".join(lines), fontsize=11)
    return figure, list(axes.flat)


def symbol(name: str) -> str:
    r"""Return a name as mathematics: `alpha_a` becomes `$\alpha_a$`; one that is no symbol stays as it is.

    Mathematics would lose spaces, and several `_` are no subscript. Nor is a rate the subscript of its angle, and a
    word such as `angle` is no product of letters.
    """
    head, _, tail = name.partition("_")
    if not head.isalnum() or not (tail.isalnum() or head == name):
        return name
    if (head.isalpha() and len(head) > 1 and head not in GREEK) or f"{{}}_{tail}" in RATE_NAMES:
        return name
    head = rf"\{head}" if head in GREEK else head
    return f"${head}_{{{tail}}}$" if tail else f"${head}$"


def label(name: str, unit: str = "") -> str:
    """Return an axis label: the quantity in words, its symbol and its unit."""
    words = f"{WORDS[name]} " if name in WORDS else ""
    return f"{words}{symbol(name)}" + (f" [{unit}]" if unit else "")


def draw_input(axis: Axes, seconds: Array, u: Array, signature: Signature, place: int, **look: Any) -> None:
    """Draw an input over time as it is held, up to the end of its last period, in the unit and range of its actuator.

    Args:
        axis: Where.
        seconds: When periods begin, `(T,)` [s]; NaN where the line breaks.
        u: Inputs, `(T, n_u)` in [-1, 1].
        signature: Tells the input's name, its unit and its range.
        place: Which input.
        **look: Of the line, as matplotlib takes it.
    """
    own = signature.in_own_units(u)[:, place]
    end = time_span(seconds[np.isfinite(seconds)])[1]
    axis.step(np.append(seconds, end), np.append(own, own[-1:]), where="post", **look)
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
    """Let an axis end where its data in seconds do, with ticks in the unit in which its length is given: s, min or h.

    Args:
        axis: Where; figures that share it follow.
        seconds: The times that it shows, or its two ends [s]; `time_span` gives those of a run.
        words: What it shows.
    """
    low, high = float(np.min(seconds, initial=np.inf)), float(np.max(seconds, initial=-np.inf))
    unit, ticks = duration_unit(max(0.0, high - low)), MaxNLocator(steps=[1, 2, 5, 10])
    axis.set_xlabel(f"{words} [{unit.name}]")
    axis.xaxis.set_major_locator(ticks)
    if unit.seconds != 1:
        places = ticks.tick_values(low / unit.seconds, high / unit.seconds)
        axis.set_xticks([unit.seconds * place for place in places], [f"{place:g}" for place in places])
    if low < high:
        axis.set_xlim(low, high)


def legend(axis: Axes, place: Literal["above", "beside", "below"] = "beside") -> None:
    """Put the legend where no line can run through it: above an axis, to its right, or below its figure.

    What is drawn twice is named once.
    """
    named = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    handles, words = list(named.values()), list(named)
    if not named:
        return
    if place == "below":
        axis.figure.legend(handles, words, loc="outside lower center", ncols=len(words))
    elif place == "beside":
        words = [textwrap.fill(name, LEGEND) for name in words]
        axis.legend(handles, words, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    else:
        # An entry takes its letters and a sample of its line; more than a row holds would press the axis together.
        rows = -(-sum(len(name) + 6 for name in words) // ROW)
        look: dict[str, Any] = {"columnspacing": 1.2, "handlelength": 1.6, "ncols": max(1, -(-len(words) // rows))}
        axis.legend(handles, words, loc="lower right", bbox_to_anchor=(1.0, 1.0), **look)


def save_figures(figures: Mapping[str, Figure], folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Write each figure once per format as `folder/NAME` with the format's suffix, and return the files."""
    files = []
    with matplotlib.rc_context(STYLE):
        for name, figure in figures.items():
            report_progress("figures", note=name)
            for suffix in formats:
                # Dates would make equal figures differ.
                metadata = {"Date": None} if suffix in ("svg", "pdf") else None
                files.append(folder / f"{name}.{suffix}")
                with replace_file(files[-1]) as file:
                    figure.savefig(file, format=suffix, metadata=metadata)
    return files
