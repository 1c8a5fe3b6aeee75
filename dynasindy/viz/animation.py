"""Seeing a controller move: the drawn plant over time, as GIF, or as MP4 where ffmpeg is installed."""

import shutil
import subprocess
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image

from dynasindy.envs.drawing import Frame, draw
from dynasindy.evaluation.scenarios import Evaluation

SUFFIXES = (".gif", ".mp4")


def frames(evaluation: Evaluation, row: int = 0, every: int = 2) -> Iterator[Frame]:
    """Yield a picture of each `every`-th sample of one row of an evaluation.

    Args:
        evaluation: What to show.
        row: Which of its references.
        every: Control periods per picture.
    """
    x = evaluation.trajectory["state"][row, ::every].tolist()
    reference = evaluation.references[row, ::every].tolist()
    for k, time in enumerate(evaluation.time[::every].tolist()):
        yield draw(evaluation.signature, x[k], reference[k], evaluation.columns, time)


def animate(evaluation: Evaluation, path: Path, row: int = 0, every: int = 2) -> Path:
    """Write one row of an evaluation as an animation in real time.

    Args:
        evaluation: What to show.
        path: File to write; its suffix, .gif or .mp4, says how.
        row: Which of its references.
        every: Control periods per picture.

    Returns:
        The file.

    Raises:
        ValueError: The suffix is unknown, `every` is not positive, or ffmpeg is missing.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"an animation cannot be written as '{path.name}'; use a name in {' or '.join(SUFFIXES)}")
    if every < 1:
        raise ValueError(f"every must be at least 1 control period per picture, got {every}; 2 is smooth enough")
    path.parent.mkdir(parents=True, exist_ok=True)
    seconds = every * float(evaluation.time[1] - evaluation.time[0])
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    write(frames(evaluation, row, every), path, seconds)
    return path


def _write_gif(pictures: Iterable[Frame], path: Path, seconds: float) -> None:
    """Write pictures `seconds` apart; 64 colours without dithering keep the file small."""
    # The octree keeps thin coloured lines, which the default merges into the large grey areas.
    octree, plain = Image.Quantize.FASTOCTREE, Image.Dither.NONE
    images = [Image.fromarray(picture).quantize(64, method=octree, dither=plain) for picture in pictures]
    images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 * seconds), loop=0)


def _write_mp4(pictures: Iterable[Frame], path: Path, seconds: float) -> None:
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise ValueError(f"'{path.name}' needs ffmpeg, which is not installed; install it or write a .gif")
    stream = iter(pictures)
    first = next(stream)
    height, width = first.shape[:2]
    source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {1 / seconds} -i -".split()
    command = [ffmpeg, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
    data = b"".join(np.ascontiguousarray(p).tobytes() for p in chain([first], stream))
    subprocess.run(command, input=data, check=True)
