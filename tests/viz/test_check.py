import numpy as np
import pytest

from dynasindy.viz.check import coefficients, nyquist, recovery, steps


def test_a_loop_is_drawn_for_each_input_beside_the_point_that_it_must_not_go_around():
    curve = np.exp(1j * np.linspace(0, 3, 20))[:, None] * np.array([0.5, 2.0])
    figure = nyquist([curve, curve], ("u_a", "u_p"), 2 / 3)
    assert len(figure.axes) == 2
    drawn = figure.axes[1].lines[0].get_xydata()
    np.testing.assert_allclose(drawn, np.stack([curve[:, 1].real, curve[:, 1].imag], -1))
    assert [-1.0, 0.0] in figure.axes[0].lines[-1].get_xydata().tolist()
    # Factors between (2 - d)/(2 + d) and its inverse: for d = 2/3 the disk meets the real axis at -1/2 and -2.
    (disk,) = figure.axes[0].patches
    assert [disk.center[0] + disk.radius, disk.center[0] - disk.radius] == pytest.approx([-0.5, -2.0])
    assert nyquist([curve], ("u",)).legends[0].texts[2].get_text() == "disk margin < 0.5"


def test_the_worst_changes_stand_on_top_and_what_never_rests_at_the_edge():
    figure = coefficients(["a", "b$", "c"], [0.9, np.inf, 1.1])
    (axis,) = figure.axes
    assert [text.get_text() for text in axis.get_yticklabels()] == [r"b\$", "c", "a"]
    offsets = axis.collections[0].get_offsets()
    assert offsets[0][0] > offsets[1][0] == 1.1 and offsets[2].tolist() == [0.9, 0.0]
    assert offsets[0][1] == 2


def test_a_plane_is_drawn_with_the_first_state_to_the_right():
    back = np.array([[1, 1, 0], [0, 0, 0]])
    figure = recovery([(("p", "v"), ("m", "m/s"), [-1.0, 1.0], [-2.0, 0.0, 2.0], back)])
    (axis,) = figure.axes
    np.testing.assert_array_equal(axis.collections[0].get_array().reshape(3, 2), back.T)
    told = {
        t.get_text(): p.get_facecolor()[:3] for t, p in zip(figure.legends[0].texts, figure.legends[0].get_patches())
    }
    # What is 0 in `back` has the first colour of the map, what is 1 the last.
    colors = axis.collections[0].cmap([0.0, 1.0])[:, :3]
    assert told["does not"] == tuple(colors[0]) and told["comes back"] == tuple(colors[1])
    assert axis.get_title() == "33% come back" and "[m/s]" in axis.get_ylabel()


def test_steps_of_all_plants_are_drawn_under_their_reference():
    y, u = np.random.default_rng(0).normal(size=(4, 6, 1)), np.zeros((4, 5, 1))
    figure = steps(0.1, y, u, [0.3], [("p", "m")], ("force",))
    upper, lower = figure.axes
    np.testing.assert_allclose(upper.lines[3].get_ydata(), y[2, :, 0])
    assert upper.lines[0].get_ydata()[0] == 0.3 and upper.lines[1].get_xdata()[-1] == 0.5
    assert [text.get_text() for text in upper.get_legend().get_texts()] == ["target", "4 plants"]
    # The last of five inputs is held to the end of its period.
    assert len(lower.lines) == 4 and lower.lines[0].get_xdata()[-1] == 0.5
