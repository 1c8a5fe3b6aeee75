from matplotlib.patches import FancyBboxPatch

from dynasindy.viz.framework import BOXES, framework


def test_every_box_and_phase_is_drawn_and_boxes_do_not_overlap():
    figure = framework()
    (axis,) = figure.axes
    boxes = [patch.get_window_extent() for patch in axis.patches if isinstance(patch, FancyBboxPatch)]
    assert len(boxes) == len(BOXES)
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    words = " ".join(text.get_text() for text in axis.texts)
    learning = "model learning", "policy learning, by TD3", "or by gradient"
    phases = (*learning, "excitation", "real interaction", "imagination", "deployment")
    assert all(phase in words for phase in phases)
