"""Seeing a controller move: the plant beside its outputs over time, as GIF, or as MP4 where ffmpeg is installed."""

import math
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

from dynasindy.envs.drawing import HEIGHT, Frame, draw, draw_beam, is_beam
from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.tracking_criteria import representative_episode
from dynasindy.progress import track
from dynasindy.safe_io import replace_file, write_bytes
from dynasindy.text import duration_unit
from dynasindy.viz.style import BLACK, BLUE, STYLE, WORDS, Array, label, time_axis, time_span

SUFFIXES = (".gif", ".mp4")
RATE = 10
"""Pictures per second."""
FULL = (7500.0, 3800.0)
"""Speeds of tail and main rotor at which the drawn blades turn a radian per picture [rpm]; real ones would blur."""


class Chart:
    """The tracked outputs of one row over the whole run, drawn as far as a moment.

    Args:
        evaluation: What to show.
        row: Which of its references.
    """

    ZOOM = 2

    def __init__(self, evaluation: Evaluation, row: int) -> None:
        self.names, self.time = evaluation.output_names, evaluation.time.numpy()
        self.units = tuple(evaluation.units.values())
        self.y, self.r = evaluation.outputs[row].numpy(), evaluation.references[row].numpy()
        inch = HEIGHT / 100
        with matplotlib.rc_context(STYLE):
            figure = Figure(figsize=(inch, inch), dpi=100 * self.ZOOM)
            canvas = FigureCanvasAgg(figure)
            axes = figure.subplots(len(self.names), 1, sharex=True, squeeze=False)[:, 0]
            figure.subplots_adjust(left=0.2, right=0.96, bottom=0.19, top=0.92, hspace=0.32)
            for k, axis in enumerate(axes):
                self._frame(axis, k)
            time_axis(axes[-1], time_span(self.time))
            figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=2)
            canvas.draw()
        self.ground = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        self.lines = [self._pixels(axis, self.y[:, k]) for k, axis in enumerate(axes)]
        self.tops = [(1 - axis.get_position().y1) * self.ground.height for axis in axes]

    def until(self, moment: int) -> Frame:
        """Return the chart up to and with sample number `moment`, and the errors then in words."""
        image = self.ground.copy()
        pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=13 * self.ZOOM)
        for k, (line, top) in enumerate(zip(self.lines, self.tops, strict=True)):
            past = line[: moment + 1]
            pen.line(past, fill=BLUE, width=2 * self.ZOOM, joint="curve")
            (u, v), size = past[-1], 4 * self.ZOOM
            pen.ellipse([u - size, v - size, u + size, v + size], fill=BLUE)
            error = self.r[moment, k] - self.y[moment, k]
            words = f"{WORDS.get(self.names[k], self.names[k])} error {error:+z.3f} {self.units[k]}"
            pen.text((0.96 * image.width, top - 5 * self.ZOOM), words, fill=BLACK, font=font, anchor="rs")
        return np.asarray(image.resize((HEIGHT, HEIGHT), Image.Resampling.LANCZOS))

    def _frame(self, axis: Axes, k: int) -> None:
        """Draw what does not move: the reference, axes that hold the whole run, and the legend's lines."""
        step = bool((np.diff(self.r[:, k]) == 0).mean() > 0.5)
        look: dict[str, Any] = {"drawstyle": "steps-post" if step else "default", "linestyle": "--", "linewidth": 1.2}
        axis.plot(self.time, self.r[:, k], color=BLACK, label="reference", **look)
        axis.plot([], [], color=BLUE, linewidth=2.0, label="plant")  # its curve grows with time, see `until`
        axis.set_ylim(*self._ends(k))
        axis.set_xlim(self.time[0], self.time[-1])
        axis.set_ylabel(label(self.names[k], self.units[k]))

    def _ends(self, k: int) -> tuple[float, float]:
        """Return between which values output and reference are, and a little more."""
        values = np.concatenate([self.y[:, k], self.r[:, k]])
        extent = float(np.ptp(values))
        beyond = 0.08 * max(extent, 0.02) if extent else 0.0016
        return float(values.min()) - beyond, float(values.max()) + beyond

    def _pixels(self, axis: Axes, values: Array) -> list[tuple[float, float]]:
        points = axis.transData.transform(np.stack([self.time, values], -1))
        return [(float(u), self.ground.height - float(v)) for u, v in points]


def bar_limits(evaluation: Evaluation, row: int, output: int) -> tuple[float, float]:
    """Return the ends of the bar of an output [its unit]: the plant's bounds, so that a level reads as a level.

    Where there are none, the bar begins at zero, or at the lowest value if that is below, and it reaches up to the
    typical range of the state, or to the highest value or target if that is above.

    Args:
        evaluation: What is shown.
        row: Which of its references.
        output: Which of its outputs.
    """
    low, high = evaluation.bounds[output] if evaluation.bounds else (-math.inf, math.inf)
    values = torch.cat([evaluation.outputs[row, :, output], evaluation.references[row, :, output]]).double()
    shown, scale = values[values.isfinite()].tolist(), evaluation.signature.x_scale[evaluation.columns[output]]
    low = low if math.isfinite(low) else min([0.0, *shown])
    high = high if math.isfinite(high) else max([scale, *shown])
    return low, high if high > low else low + scale


def frames(evaluation: Evaluation, row: int = 0, every: int = 2) -> Iterator[Frame]:
    """Yield a picture of each `every`-th sample of one row of an evaluation: the plant, and its outputs so far.

    Args:
        evaluation: What to show.
        row: Which of its references.
        every: Control periods per picture.
    """
    chart = Chart(evaluation, row)
    x, reference = evaluation.trajectory["state"][row].tolist(), evaluation.references[row].tolist()
    speed = every * RATE * float(evaluation.time[1] - evaluation.time[0])
    fast = f", {speed:.3g} times as fast" if speed > 1.01 else ""
    ends = [bar_limits(evaluation, row, n) for n in range(len(evaluation.columns))]
    turned, unit = [0.0, 0.0], duration_unit(evaluation.seconds)
    for k in range(0, len(x), every):
        words = f"t = {evaluation.time[k] / unit.seconds:.1f} {unit.name}{fast}"
        if is_beam(evaluation.signature):
            turned = [angle + w / full for angle, w, full in zip(turned, x[k][4:], FULL, strict=True)]
            scene = draw_beam(x[k], reference[k], turned, words)
        else:
            moment, seconds = float(evaluation.time[k]), evaluation.seconds
            scene = draw(evaluation.signature, x[k], reference[k], evaluation.columns, moment, ends, seconds)
        yield np.hstack([scene, chart.until(k)])


def animate(evaluation: Evaluation, path: Path, row: int | None = None, seconds: float = 10.0) -> Path:
    """Write one row of an evaluation as an animation, in real time unless that takes too long.

    Args:
        evaluation: What to show.
        path: File to write; its suffix, .gif or .mp4, says how.
        row: Which of its episodes; the one that figures show, if omitted.
        seconds: Longest time it may take [s]; a longer run is shown a whole number of times as fast, and says so.

    Returns:
        The file.

    Raises:
        ValueError: The suffix is unknown, `seconds` is not positive, nothing is tracked, or ffmpeg is missing.
    """
    if not evaluation.columns:
        raise ValueError("an animation shows what is tracked, and the task tracks nothing; leave out animate=true")
    if path.suffix not in SUFFIXES:
        raise ValueError(f"an animation cannot be written as '{path.name}'; use a name in {' or '.join(SUFFIXES)}")
    if not seconds > 0:
        raise ValueError(f"seconds of an animation must be positive, got {seconds}; 10 is easy to watch")
    dt = float(evaluation.time[1] - evaluation.time[0])
    speed = max(1, math.ceil(len(evaluation.time) * dt / seconds - 1e-6))
    every = max(1, round(speed / (RATE * dt)))
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    row = representative_episode(evaluation).row if row is None else row
    pictures = track("animation", frames(evaluation, row, every), math.ceil(len(evaluation.time) / every), "pictures")
    write(pictures, path, every * dt / speed)
    return path


def _write_gif(pictures: Iterable[Frame], path: Path, seconds: float) -> None:
    """Write pictures `seconds` apart; 64 colours without dithering keep the file small."""
    # The octree keeps thin coloured lines, which the default merges into the large grey areas.
    octree, plain = Image.Quantize.FASTOCTREE, Image.Dither.NONE
    images = [Image.fromarray(picture).quantize(64, method=octree, dither=plain) for picture in pictures]
    more = {"append_images": images[1:], "duration": round(1000 * seconds), "loop": 0}
    with replace_file(path) as file:
        images[0].save(file, format="gif", save_all=True, **more)


def _write_mp4(pictures: Iterable[Frame], path: Path, seconds: float) -> None:
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ValueError(f"'{path.name}' needs ffmpeg, which is not installed; install it or write a .gif")
    stream = iter(pictures)
    first = next(stream)
    height, width = first.shape[:2]
    source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {1 / seconds} -i -".split()
    command = [ffmpeg, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p"]
    data = b"".join(np.ascontiguousarray(p).tobytes() for p in chain([first], stream))
    with TemporaryDirectory() as folder:  # ffmpeg wants a file of its own, in which it can go back
        film = Path(folder) / path.name
        subprocess.run([*command, str(film)], input=data, check=True)
        write_bytes(path, film.read_bytes())
