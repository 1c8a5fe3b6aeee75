"""Seeing a controller move: the plant beside its outputs over time, as GIF."""

import math
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from dynasindy.envs.drawing import HEIGHT, Frame, draw
from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.progress import track
from dynasindy.safe_io import replace_file
from dynasindy.text import duration_unit
from dynasindy.viz.style import BLACK, BLUE, STYLE, WORDS, Array, label, time_axis, time_span

RATE = 10
"""Pictures per second."""


def _frames(evaluation: Evaluation, row: int = 0, every: int = 2) -> Iterator[Frame]:
    """Yield a picture of each `every`-th sample of one row of an evaluation: the plant, and its outputs so far."""
    time, y, r = evaluation.time.numpy(), evaluation.outputs[row].numpy(), evaluation.references[row].numpy()
    x, names = evaluation.trajectory["state"][row].tolist(), evaluation.output_names
    units = [*evaluation.units.values()]
    speed = every * RATE * float(time[1] - time[0])
    fast = f"\n{speed:.3g} times as fast" if speed > 1.01 else ""
    unit = duration_unit(evaluation.seconds)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(HEIGHT / 100, HEIGHT / 100), dpi=100)
        canvas, axes = FigureCanvasAgg(figure), figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        figure.subplots_adjust(left=0.2, right=0.96, bottom=0.19, top=0.92, hspace=0.32)
        curves = [_frame(axis, time, r[:, n], y[:, n]) for n, axis in enumerate(axes)]
        for axis, name, of in zip(axes, names, units, strict=True):
            axis.set_ylabel(label(name, of))
        time_axis(figure, time_span(time))
        figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=2)
    for k in range(0, len(x), every):
        words = f"t = {time[k] / unit.seconds:.1f} {unit.name}{fast}"
        scene = draw(evaluation.signature, x[k], r[k].tolist(), evaluation.columns, words)
        for n, (axis, (past, now)) in enumerate(zip(axes, curves, strict=True)):
            past.set_data(time[: k + 1], y[: k + 1, n])
            now.set_data(time[[k]], y[[k], n])
            error = f"error {r[k, n] - y[k, n]:+z.3f} {units[n]}"
            axis.set_title(f"{WORDS.get(names[n], names[n])} {error}", loc="right", fontsize=8)
        canvas.draw()
        yield np.hstack([scene, np.asarray(canvas.buffer_rgba())[..., :3]])


def _frame(axis: Axes, time: Array, reference: Array, output: Array) -> tuple[Line2D, Line2D]:
    """Draw what does not move, and return the lines of the output and of its last value, which grow with time."""
    step = bool((np.diff(reference) == 0).mean() > 0.5)
    style = "steps-post" if step else "default"
    axis.plot(time, reference, color=BLACK, label="reference", drawstyle=style, linestyle="--", linewidth=1.2)
    (past,) = axis.plot([], [], color=BLUE, linewidth=2.0, label="plant")
    (now,) = axis.plot([], [], color=BLUE, marker="o", markersize=5)
    values = np.concatenate([output, reference])
    extent = float(np.ptp(values))
    beyond = 0.08 * max(extent, 0.02) if extent else 0.0016
    axis.set_ylim(float(values.min()) - beyond, float(values.max()) + beyond)
    axis.set_xlim(time[0], time[-1])
    return past, now


def animate(evaluation: Evaluation, path: Path, seconds: float = 10.0) -> Path:
    """Write the episode of an evaluation that figures show as an animation, in real time unless that takes too long.

    Args:
        evaluation: What to show.
        path: File to write, `.gif`.
        seconds: Longest time it may take [s]; a longer run is shown a whole number of times as fast, and says so.

    Returns:
        The file.

    Raises:
        ValueError: Nothing is tracked.
    """
    if not evaluation.columns:
        raise ValueError("an animation shows what is tracked, and the task tracks nothing; leave out animate=true")
    dt = float(evaluation.time[1] - evaluation.time[0])
    speed = max(1, math.ceil(len(evaluation.time) * dt / seconds - 1e-6))
    every = max(1, round(speed / (RATE * dt)))
    row, _ = evaluation.representative_episode
    pictures = track("animation", _frames(evaluation, row, every), math.ceil(len(evaluation.time) / every), "pictures")
    # 64 colours without dithering keep the file small; the octree keeps thin lines, which the default turns grey.
    octree, plain = Image.Quantize.FASTOCTREE, Image.Dither.NONE
    images = [Image.fromarray(picture).quantize(64, method=octree, dither=plain) for picture in pictures]
    more = {"append_images": images[1:], "duration": round(1000 * every * dt / speed), "loop": 0}
    with replace_file(path) as file:
        images[0].save(file, format="gif", save_all=True, **more)
    return path
