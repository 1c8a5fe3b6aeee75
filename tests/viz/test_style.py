"""The style: labels with units, equal files for equal data, no trace in matplotlib's settings."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.mathtext import MathTextParser

from dynasindy.systems import Signature
from dynasindy.viz.style import (
    GREEK,
    draw_input,
    label,
    legend,
    panels,
    symbol,
    time_panels,
    time_span,
)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("alpha_a", r"$\alpha_{a}$"),
        ("Omega", r"$\Omega$"),
        ("u_p", "$u_{p}$"),
        ("u_angle", r"$u_{\mathrm{angle}}$"),
        ("x", "$x$"),
    ],
)
def test_symbols(name: str, expected: str) -> None:
    assert symbol(name) == expected


@pytest.mark.parametrize("name", GREEK)
def test_greek_names_are_letters(name: str) -> None:
    assert symbol(name) == rf"$\{name}$"
    parse_math(symbol(name))


@pytest.mark.parametrize("name", ["Temperature_1_rate", "joint_position_of_the_left_arm", "omega_p", "T"])
def test_labels_fit_beside_their_panel_and_legends_below_their_figure(name: str) -> None:
    figure, axes = time_panels([name] * 6, ["rad/s"] * 6, "")
    axes[0].plot([0, 1], [0, 1], label="a line of " + 60 * "w")
    axes[0].plot([0, 1], [1, 0], label="another of " + 60 * "w")
    legend(axes[0], below=True)
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    boxes = [axis.yaxis.label.get_window_extent(renderer) for axis in axes[::2]]
    assert all(below.y1 < above.y0 for above, below in zip(boxes, boxes[1:], strict=False))
    box = figure.legends[0].get_window_extent(renderer)
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width


def test_the_axis_of_an_input_that_hardly_moves_shows_how_it_does() -> None:
    _, (shown,) = panels(1)
    draw_input(shown, np.arange(3.0), np.array([[0.01], [0.02], [0.01]]), Signature(("x",), ("m",), ("u",), (1.0,)), 0)
    low, high = shown.get_ylim()
    assert 0 < low < 0.01 and 0.02 < high < 0.03


def test_a_title_has_greek_letters_for_names_and_not_for_words():
    figure, _ = panels(1, title="Plant xi, pushed by 0.5 rad/s^2 on Omega_a, not alpha_a_rate")
    words = figure.get_suptitle().split()
    assert words[:2] == ["Plant", "xi,"] and words[5:] == ["rad/s²", "on", r"$\Omega_{a}$,", "not", "alpha_a_rate"]


@pytest.mark.parametrize("name", ["größe", "x12", "T_in2", "theta_1", "u"])
def test_symbols_are_ones_that_matplotlib_reads(name: str) -> None:
    parse_math(label(name, "°/s"))


def parse_math(text: str) -> None:
    """Read a text as matplotlib does; one that is no mathematics raises a ValueError."""
    MathTextParser("agg").parse(text)


@pytest.mark.parametrize(
    ("ends", "limits", "units", "axis"),
    [
        ((), (), (), (-1.08, 1.08, "$u_{b}$ [-]")),
        ([[-1, 1], [-12, 12]], [[-1, 1], [0, 1]], ["-", "V"], (-0.48, 12.48, "$u_{b}$ [V]")),
        ([[-1, 1], [0, 10]], (), (), (-0.4, 10.4, "$u_{b}$")),
    ],
)
def test_the_axis_of_an_input_has_the_range_and_the_unit_of_its_actuator(ends, limits, units, axis) -> None:
    _, (shown,) = panels(1)
    signature = Signature(("x",), ("m",), ("u_a", "u_b"), (1.0,), ends, limits, units)
    draw_input(shown, np.arange(3.0), np.zeros((3, 2)), signature, 1)
    assert (*shown.get_ylim(), shown.get_ylabel()) == pytest.approx(axis)


@pytest.mark.parametrize(
    ("times", "ends"),
    [
        (np.arange(0, 20, 0.05), (0, 20)),
        (np.arange(0, 20, 0.1), (0, 20)),
        (np.arange(0.05, 20, 0.1), (0, 20)),  # every other sample, from the second on
        (np.arange(0, 200, 0.2), (0, 200)),
        (np.arange(0, 7.3, 0.05), (0, 7.3)),
        (np.arange(3.0, 5.0, 0.5), (3, 5)),
        (np.array([2.0]), (2, 2)),
    ],
)
def test_a_run_ends_with_its_last_period(times, ends) -> None:
    assert time_span(times) == pytest.approx(ends)
