"""Pictures: sizes, what moves in them and what does not."""

import math

import numpy as np
import pytest

from dynasindy.envs.drawing import HEIGHT, draw
from dynasindy.systems import Pendulum, Signature, Tras

LEVEL = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
BEAM = np.array([0, 114, 178])


def beam_ends(pitch: float) -> tuple[float, float]:
    """Mean heights of the beam left and right of the post, above the key, in pixels above the frame's bottom."""
    frame = draw(Tras().signature, [0.0, pitch, 0, 0, 0, 0], [0.0, 0.0], [0, 1]).astype(int)
    rows, columns = np.nonzero(np.abs(frame[:320] - BEAM).max(-1) < 12)
    right, left = columns > 0.65 * HEIGHT, columns < 0.35 * HEIGHT
    return HEIGHT - rows[left].mean(), HEIGHT - rows[right].mean()


def test_frames_are_pictures_of_a_fixed_size() -> None:
    frame = draw(Tras().signature, LEVEL, [0.4, 0.25], [0, 1], "t = 1.25 s")
    assert frame.shape == (360, 360, 3)
    assert frame.dtype == np.uint8
    assert draw(Pendulum().signature, [0.1, 0.0], [0.5], [0]).shape == (360, 180, 3)


def test_a_level_beam_looks_level_and_positive_pitch_lifts_the_main_rotor() -> None:
    left, right = beam_ends(0.0)
    assert left == pytest.approx(right, abs=1.5)
    left, right = beam_ends(0.4)
    # The main rotor is at the right end, one beam's half length (0.32 of the frame) from the pivot.
    slope = math.atan2(right - left, 0.32 * HEIGHT * math.cos(0.4) * 2 * 0.8)
    assert slope == pytest.approx(0.4 * math.cos(math.radians(28)), abs=0.12)


def test_a_pendulum_at_rest_hangs() -> None:
    frame = draw(Pendulum().signature, [0.0, 0.0], [0.0], [0]).astype(int)
    inked = frame[..., 0] < 60  # the blue needle and the black reference on it, and no grey
    rows, columns = np.nonzero(inked & (np.arange(180) > 60) & (np.arange(180) < 120))
    needle = rows[(rows > 170) & (rows < 240)]
    assert len(needle) > 100
    assert np.ptp(columns[(rows > 180) & (rows < 230)]) < 8


def plant(unit: str, scale: float = 1.0) -> Signature:
    """A plant with one state in a unit."""
    return Signature(("h",), (unit,), ("u",), (scale,))


def test_angles_are_dials_in_any_unit_and_all_else_is_not() -> None:
    right = np.s_[:, 100:140]  # where the needle of a dial lies at zero
    away = {"rad": math.pi, "deg": 180.0}
    dials = [draw(plant(unit), [0.0], [turn], [0]).astype(int)[:230][right] for unit, turn in away.items()]
    needles = [int((np.abs(dial - BEAM).max(-1) < 12).sum()) for dial in dials]
    assert needles[0] == needles[1] > 30
    upright = [draw(plant(unit), [turn], [0.0], [0]) for unit, turn in (("rad", math.pi / 2), ("deg", 90.0))]
    assert (upright[0][100:230] == upright[1][100:230]).all()  # the units beneath differ
    level = draw(plant("m"), [0.0], [0.0], [0]).astype(int)[150:230, 120:140]
    assert not (np.abs(level - BEAM).max(-1) < 12).any()
