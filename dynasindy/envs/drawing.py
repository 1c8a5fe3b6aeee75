"""Pictures of a controlled plant: the twin rotor's beam in space, of other plants the tracked outputs.

The beam's shadow on the floor shows its azimuth. An angle is a dial, and any other output a number with its unit. The
plant is blue; the reference is dashed and black, as in every figure.

Drawn with Pillow at twice the size and scaled down, which smooths the edges.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dynasindy.systems import Signature
from dynasindy.systems.base import turn_of

Vector = NDArray[np.float64]
Frame = NDArray[np.uint8]
Colour = tuple[int, int, int, int]

HEIGHT = 360
"""Height of a frame [pixels]."""
_ZOOM = 2
_INK, _GHOST = (30, 30, 30, 255), (0, 0, 0, 255)
_PLANT, _MAIN, _TAIL, _FAINT = (0, 114, 178, 255), (230, 159, 0), (0, 158, 115), (215, 215, 215, 255)
_FLOOR, _SHADOW = (244, 244, 244, 255), (190, 190, 190, 255)
_RISE, _DEPTH = math.cos(math.radians(28.0)), math.sin(math.radians(28.0))
_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, _DEPTH, _RISE], [0.0, -_RISE, _DEPTH]])
"""Unit vectors to the right, upwards and towards the camera, which stands where a level beam looks level."""
_HANGING = ("theta", "Omega")
"""States of the pendulum, which hangs down at rest."""


def draw(
    signature: Signature,
    x: Sequence[float],
    reference: Sequence[float],
    outputs: Sequence[int],
    words: str = "",
) -> Frame:
    """Draw one state of a plant: the beam of the twin rotor with a key to its colours, the outputs of others.

    Args:
        signature: Names and units of the states.
        x: `(n_x,)` state.
        reference: `(n_r,)` reference of each tracked output; drawn dashed and black.
        outputs: Indices of the tracked outputs in `x`.
        words: Written into the corner.

    Returns:
        Colours, uint8 `(height, width, 3)`.
    """
    beam = signature.state_names[:2] == ("alpha_a", "alpha_p")
    size = (_ZOOM * (HEIGHT if beam else HEIGHT // 2 * max(1, len(outputs))), _ZOOM * HEIGHT)
    image = Image.new("RGB", size, "white")
    if beam:
        _draw_twin_rotor(image, np.asarray(x, dtype=np.float64), np.asarray(reference, dtype=np.float64))
        keys = {"- - reference": _GHOST, "plant": _PLANT, "main rotor": (*_MAIN, 255), "tail rotor": (*_TAIL, 255)}
        for (name, colour), left in zip(keys.items(), (10, 110, 160, 240), strict=True):
            _write(image, (left, 338), name, colour)
    else:
        for k, index in enumerate(outputs):
            _draw_output(image, k * HEIGHT // 2, signature, index, float(x[index]), float(reference[k]))
    _write(image, (10, 8), words)
    return np.asarray(image.resize((image.width // _ZOOM, HEIGHT), Image.Resampling.LANCZOS))


def _draw_output(
    image: Image.Image, left: int, signature: Signature, index: int, value: float, reference: float
) -> None:
    """Draw an output as numbers; an angle as a needle, too, counter-clockwise from the right, before its reference."""
    name, unit, turn = signature.state_names[index], signature.state_units[index], turn_of(signature.state_units[index])
    _write(image, (left + 8, HEIGHT // 4 + 4), name)
    if turn < math.inf:
        pen = ImageDraw.Draw(image, "RGBA")
        centre, radius = (left + 90, HEIGHT // 4 + 86), 56
        pen.ellipse([_ZOOM * (c + s * radius) for s in (-1, 1) for c in centre], outline=_FAINT, width=2 * _ZOOM)
        zero = -0.5 * math.pi if signature.state_names == _HANGING else 0.0
        needle = partial(pen.line, fill=_PLANT, width=4 * _ZOOM)
        for angle, line in ((value, needle), (reference, partial(_dashed, pen))):
            turned = angle * 2 * math.pi / turn + zero
            tip = (centre[0] + radius * math.cos(turned), centre[1] - radius * math.sin(turned))
            line([(_ZOOM * u, _ZOOM * v) for u, v in (centre, tip)])
    _write(image, (left + 8, HEIGHT // 4 + 152), f"{value:+z.3f} {unit}", _PLANT)
    _write(image, (left + 94, HEIGHT // 4 + 152), f"{reference:+z.3f}", _GHOST)


def _draw_twin_rotor(image: Image.Image, x: Vector, reference: Vector) -> None:
    pen = ImageDraw.Draw(image, "RGBA")
    floor = np.array([0.0, 0.0, -1.0])
    edge = _points(_circle(floor, 1.05, (1, 0, 0), (0, 1, 0)))
    pen.polygon(edge, fill=_FLOOR, outline=_FAINT)
    # The beam's shadow and, at the edge of the floor, where the reference wants it.
    for angle, inner, outer, shade, thick in ((x[0], -1.0, 1.0, _SHADOW, 5), (reference[0], 1.0, 1.15, _GHOST, 3)):
        way = np.array([math.cos(angle), math.sin(angle), 0.0])
        pen.line(_points([floor + inner * way, floor + outer * way]), fill=shade, width=thick * _ZOOM)
    pen.line(_points([floor, (0, 0, 0)]), fill=_FAINT, width=10 * _ZOOM)
    along, side, up = _frame(x[0], x[1])

    def _draw_beam() -> None:
        pen.line(_points([-along, along]), fill=_PLANT, width=6 * _ZOOM)
        pen.line(_points([np.zeros(3), -0.45 * up]), fill=_PLANT, width=4 * _ZOOM)  # counterweight arm
        (u, v), r = _points([-0.45 * up])[0], 8 * _ZOOM
        pen.ellipse([u - r, v - r, u + r, v + r], fill=_PLANT)

    def _draw_rotor(disc: Vector, colour: tuple[int, int, int], speed: float, full: float) -> None:
        """Draw a disc that is the more solid the faster its rotor turns [rpm]."""
        solid = int(40 + 160 * min(1.0, abs(float(speed)) / full)) if math.isfinite(speed) else 0
        pen.polygon(_points(disc), fill=(*colour, solid))
        pen.line(_points([*disc, disc[0]]), fill=(*colour, 255), width=2 * _ZOOM)

    parts = [
        (along, lambda: _draw_rotor(_circle(along, 0.42, along, side), _MAIN, x[5], 3800.0)),
        (-along, lambda: _draw_rotor(_circle(-along, 0.3, along, up), _TAIL, x[4], 7500.0)),
        (np.zeros(3), _draw_beam),
    ]
    # The farthest part first, so that nearer ones cover it.
    for _, part in sorted(parts, key=lambda item: float(item[0] @ _CAMERA[2])):
        part()
    # The reference lies over the beam and reaches beyond it, so that it is seen when they coincide.
    ghost, _, _ = _frame(reference[0], reference[1])
    _dashed(pen, _points([-1.25 * ghost, 1.25 * ghost]))


def _dashed(pen: ImageDraw.ImageDraw, ends: Sequence[tuple[float, float]]) -> None:
    """Draw a reference: a dashed black line between two points [pixels of the enlarged image]."""
    (u, v), (u_end, v_end) = ends
    dashes = max(1, round(math.hypot(u_end - u, v_end - v) / (12 * _ZOOM)))
    for k in range(dashes):
        part = [(u + at * (u_end - u), v + at * (v_end - v)) for at in (k / dashes, (k + 0.6) / dashes)]
        pen.line(part, fill=_GHOST, width=2 * _ZOOM)


def _frame(azimuth: float, pitch: float) -> tuple[Vector, Vector, Vector]:
    """Return the unit vectors along the beam to the main rotor, to its side, and upwards from it."""
    ca, sa, cp, sp = math.cos(azimuth), math.sin(azimuth), math.cos(pitch), math.sin(pitch)
    return np.array([cp * ca, cp * sa, sp]), np.array([-sa, ca, 0.0]), np.array([-sp * ca, -sp * sa, cp])


def _circle(centre: Vector, radius: float, e1: Sequence[float] | Vector, e2: Sequence[float] | Vector) -> Vector:
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    return centre + radius * (np.cos(angle) * np.asarray(e1) + np.sin(angle) * np.asarray(e2))


def _points(positions: Sequence[Sequence[float] | Vector] | Vector) -> list[tuple[float, float]]:
    """Project positions orthographically onto the picture [pixels of the enlarged image]."""
    scale, middle = 0.32 * HEIGHT * _ZOOM, 0.5 * HEIGHT * _ZOOM
    seen = np.asarray(positions, dtype=np.float64) @ _CAMERA[:2].T
    return [(float(middle + scale * u), float(0.9 * middle - scale * v)) for u, v in seen]


def _write(image: Image.Image, at: tuple[float, float], text: str, colour: Colour = _INK) -> None:
    font = ImageFont.load_default(size=13 * _ZOOM)
    ImageDraw.Draw(image).text((_ZOOM * at[0], _ZOOM * at[1]), text, fill=colour, font=font)
