"""The framework as a drawing: what acts on the plant, what is learnt from it, and where experience goes."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from dynasindy.viz.style import BLACK, BLUE, GREEN, GREY, ORANGE, RED, panels, styled

Place = tuple[float, float]
WIDTH, HEIGHT = 2.1, 0.9
BOXES: Mapping[str, tuple[Place, str, str]] = {
    "plant": ((0.0, 2.2), "plant\ndx/dt = f(x, u)", BLACK),
    "agent": ((8.4, 2.2), "agent: the actor;\nTD3 adds two critics", BLUE),
    "real": ((4.2, 2.2), "replay.real\nreal transitions", GREY),
    "model": ((0.0, 0.0), "SINDy model\ndx/dt = $\\Xi^T\\Theta(x, u)$", RED),
    "gate": ((2.8, 0.0), "gate\nis it trusted?", ORANGE),
    "imagine": ((5.6, 0.0), "imagination\nrollouts of the model", GREEN),
    "imagined": ((8.4, 0.0), "replay.model\nimagined transitions", GREY),
}
"""Centre, words and colour of each box."""


@styled
def framework(title: str = "Dyna-style SINDy, with TD3 or by gradient") -> Figure:
    """Draw the phases of Algorithm 1 between plant, model, replay and agent, and both ways to learn the policy."""
    figure, (axis,) = panels(1, 1, (9.0, 3.9), title)
    axis.set(xlim=(-1.3, 9.7), ylim=(-0.7, 3.9))
    axis.axis("off")
    for (x, y), words, colour in BOXES.values():
        corner = (x - WIDTH / 2, y - HEIGHT / 2)
        box = FancyBboxPatch(
            corner, WIDTH, HEIGHT, boxstyle="round,pad=0,rounding_size=0.12", ec=colour, fc="white", lw=1.6
        )
        axis.add_patch(box)
        axis.text(x, y, words, ha="center", va="center", fontsize=8.5)
    _arrow(axis, (1.05, 2.2), (3.15, 2.2), "real interaction")
    _arrow(axis, (5.25, 2.2), (7.35, 2.2), "policy learning, by TD3")
    _arrow(axis, (8.4, 0.45), (8.4, 1.75), "by TD3", side=(0.08, 0.0))
    _arrow(axis, (6.6, 0.45), (8.0, 1.75), "or by gradient", side=(0.04, -0.24))
    _arrow(axis, (0.0, 1.75), (0.0, 0.45), "model learning", side=(0.08, 0.0))
    _arrow(axis, (1.05, 0.0), (1.75, 0.0))
    _arrow(axis, (3.85, 0.0), (4.55, 0.0))
    _arrow(axis, (6.65, 0.0), (7.35, 0.0))
    _arrow(axis, (4.5, 1.75), (5.4, 0.45), "start states", side=(0.12, 0.0))
    _arrow(axis, (7.6, 1.75), (6.2, 0.45), "policy", side=(-0.55, 0.05))
    axis.plot([8.4, 8.4, 0.0], [2.65, 3.35, 3.35], color=BLACK, lw=1.0)
    _arrow(axis, (0.0, 3.35), (0.0, 2.65))
    axis.text(
        4.2, 3.42, "u: exploration, and deployment at the end; before both, the excitation", ha="center", fontsize=8
    )
    return figure


def _arrow(axis: Axes, start: Place, end: Place, words: str = "", side: Place = (0.0, 0.1)) -> None:
    axis.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "color": BLACK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    )
    middle = ((start[0] + end[0]) / 2 + side[0], (start[1] + end[1]) / 2 + side[1])
    axis.text(*middle, words, ha="left" if side[0] else "center", va="center" if side[0] else "bottom", fontsize=8)
