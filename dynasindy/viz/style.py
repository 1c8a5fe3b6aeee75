"""The one style of all figures: colours, also of controllers, labels with units, saving; pyplot stays out."""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import ArrayLike, NDArray

from dynasindy.data.headings import RATE_NAMES
from dynasindy.progress import report_progress
from dynasindy.safe_io import replace_file
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.text import duration_unit, format_duration

P = ParamSpec("P")
T = TypeVar("T")
Array = NDArray[np.float64]

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
"""Colour-blind safe palette (Okabe and Ito 2008); black is always the reference or the real plant."""
CYCLE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
GREY = "#7f7f7f"
# The default and the paper's three settings have a colour and a solid line; of the others, kin share a colour.
CONTROLLERS: Mapping[str, tuple[str, str, str]] = {
    "gradient": ("policy", BLUE, "-"),
    "gradient_integral": ("policy, integral action", BLUE, "--"),
    "rollouts_0": ("no planning", RED, "-"),
    "rollouts_400": ("400 rollouts", SKY, "-"),
    "rollouts_800": ("800 rollouts", GREEN, "-"),
    "rollouts_0_tuned": ("TD3 tuned for no planning", RED, "--"),
    "sb3_sac": ("SAC", PURPLE, "-"),
    "sb3_sac_5": ("SAC, five updates per step", PURPLE, "--"),
    "sb3_td3": ("Stable-Baselines3's TD3", ORANGE, "-"),
    "sb3_td3_5": ("Stable-Baselines3's TD3, five updates per step", ORANGE, "--"),
}
"""What the default, the paper's settings and agents without a model are called; colour and dashes of their lines."""
ROW = 13.5
"""Letters that a row of a legend below a figure holds for each inch."""
LEGEND = 60
"""Letters that a row of a legend beside an axis holds."""
USED = 0.1
"""Part of the range of an actuator below which an axis shows what was used of it."""
CALM = 0.02
"""Part of what a line moved by which it may stray from its last value when nothing moves any more."""
PANEL = 24
"""Letters that stand beside a panel of a figure over time."""

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
        title = title.replace("s^2", "s\N{SUPERSCRIPT TWO}")
        title = re.sub(rf"\b({'|'.join(GREEK)})_[^\W_]+\b", lambda found: symbol(found[0]), title)
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
    head, tail = (rf"\{part}" if part in GREEK else part for part in (head, tail))
    if len(tail) > 1 and tail not in GREEK and not tail.startswith("\\"):  # nor is a word there a product of letters
        tail = rf"\mathrm{{{tail}}}"
    return f"${head}_{{{tail}}}$" if tail else f"${head}$"


def label(name: str, unit: str = "") -> str:
    """Return an axis label: the quantity in words, its symbol and its unit, in lines that fit beside a panel."""
    words = f"{WORDS[name]} " if name in WORDS else ""
    text, letters = symbol(name), len(words) + 3
    if text == name:
        text = re.sub(rf"(.{{{PANEL // 2},}}?[_ ])(?=.{{4}})", r"\1\n", name) if len(name) > PANEL else name
        letters = len(name)
    between = "\n" if letters + len(unit) + 3 > PANEL else " "
    return f"{words}{text}" + (f"{between}[{unit}]" if unit else "")


def draw_input(axis: Axes, seconds: Array, u: Array, signature: Signature, place: int, **look: Any) -> None:
    """Draw an input over time as it is held, up to the end of its last period, in the unit and range of its actuator.

    The axis ends with what is drawn where that is a small part of the range.

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
    least, most = axis.dataLim.intervaly
    if 0 < most - least < USED * (high - low):
        low, high = least, most
    room = 0.04 * (high - low)
    axis.set_ylim(low - room, high + room)
    unit = signature.input_units[place] if signature.input_units else "-"
    if unit == "-" and signature.input_ends and signature.input_ends[place] != WHOLE:
        unit = ""  # which the log does not tell
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


def time_panels(names: Sequence[str], units: Sequence[str], title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel over time for each quantity, in two columns where they are many."""
    columns = 2 if len(names) > 4 else 1
    rows = -(-len(names) // columns)
    figure, axes = panels(rows, columns, (9.0 if columns > 1 else 7.0, 1.9 * rows + 0.5), title)
    for axis, name, unit in zip(axes, names, units, strict=False):
        axis.set_ylabel(label(name, unit))
    for axis in axes[len(names) :]:
        axis.remove()
    return figure, axes[: len(names)]


def time_axis(figure: Figure, seconds: ArrayLike, words: str = "time") -> None:
    """Let panels end where their data in seconds do, with ticks in the unit in which the length is given: s, min or h.

    Args:
        figure: Whose last panels name the time, one of each column, also above an empty place.
        seconds: The times that it shows, or its two ends [s]; `time_span` gives those of a run.
        words: What it shows.
    """
    low, high = float(np.min(seconds, initial=np.inf)), float(np.max(seconds, initial=-np.inf))
    unit, ticks = duration_unit(max(0.0, high - low)), MaxNLocator(steps=[1, 2, 5, 10])
    columns = len({axis.get_position().x0 for axis in figure.axes})
    for axis in figure.axes[-columns:]:
        axis.set_xlabel(f"{words} [{unit.name}]")
        axis.tick_params(labelbottom=True)
        axis.xaxis.set_major_locator(ticks)
        axis.xaxis.set_major_formatter(ScalarFormatter())  # the labels of a longer time stay otherwise
        if unit.seconds != 1:
            places = ticks.tick_values(low / unit.seconds, high / unit.seconds)
            axis.set_xticks([unit.seconds * place for place in places], [f"{place:g}" for place in places])
        if low < high:
            axis.set_xlim(low, high)


def cut_time(figure: Figure) -> bool:
    """Let the time of steps end with twice what passes until no line moves any more, and return whether that is early.

    A line may stray from its last value by `CALM` of what it moved.
    """
    last = 0.0
    start, end = figure.axes[-1].get_xlim()
    for line in (line for axis in figure.axes for line in axis.lines):
        time, values = array(line.get_xdata()), array(line.get_ydata())
        far = ~(np.abs(values - values[-1]) <= CALM * np.ptp(values))
        last = max(last, float(time[far].max(initial=start) - start))
    if not 0 < 4 * last < end - start:
        return False
    time_axis(figure, (start, start + 2 * last), f"time, of {format_duration(end - start)} in all")
    return True


def legend(axis: Axes, below: bool = False) -> None:
    """Put the legend where no line can run through it, beside its axis or below its figure, each once."""
    named = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    handles, words = list(named.values()), list(named)
    if not named:
        return
    if not below:
        words = [textwrap.fill(name, LEGEND) for name in words]
        axis.legend(handles, words, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return
    # An entry takes its letters and a sample of its line; more than a row holds would leave the figure.
    rows = -(-sum(len(name) + 6 for name in words) // int(ROW * axis.figure.bbox.width / axis.figure.dpi))
    columns = -(-len(words) // rows)
    axis.figure.legends.clear()
    axis.figure.legend(handles, words, loc="outside lower center", columnspacing=1.2, handlelength=1.6, ncols=columns)


def controller_name(setting: str) -> str:
    """Return the words for a setting: `rollouts_800` is `800 rollouts`."""
    if setting in CONTROLLERS:
        return CONTROLLERS[setting][0]
    found = re.fullmatch(r"rollouts_(\d+)", setting)
    return f"{found[1]} rollouts" if found else setting if "," in setting else setting.replace("_", " ")


def line_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return colour and dashes per controller of a figure, by its setting or its words, as matplotlib takes them.

    One that is known looks the same everywhere; others take the colours of the cycle that are left, in their order.
    """
    known = {name: look for setting, (words, *look) in CONTROLLERS.items() for name in (setting, words)}
    chosen = list(names)
    taken = {known[name][0] for name in chosen if name in known}
    free = [colour for colour in CYCLE if colour not in taken] or list(CYCLE)
    others = [name for name in chosen if name not in known]
    known |= {name: [free[k % len(free)], "-"] for k, name in enumerate(others)}
    return {name: dict(zip(("color", "linestyle"), known[name], strict=True)) for name in chosen}


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
