from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from dynasindy.evaluation.ablation import read_ablation
from dynasindy.viz.ablation import families
from dynasindy.viz.controllers import CONTROLLERS, by_planning, looks, named, with_integral
from dynasindy.viz.style import BLACK, BLUE, GREEN, GREY, RED

ROWS = Path(__file__).parents[2] / "docs/results/ablation.csv"
PAPER = ("gradient", "rollouts_0", "rollouts_400", "rollouts_800")


def test_a_controller_looks_the_same_by_its_setting_and_by_its_words_in_every_company():
    solid = {"linestyle": "-"}
    assert looks(["gradient", "rollouts_0"]) == {
        "gradient": {"color": BLUE, **solid},
        "rollouts_0": {"color": RED, **solid},
    }
    assert looks(["no planning", "x", "800 rollouts"]) == {
        "no planning": {"color": RED, **solid},
        "x": {"color": BLUE, **solid},
        "800 rollouts": {"color": GREEN, **solid},
    }
    assert len({look["color"] for look in looks("abcdef").values()}) == 6


def test_no_two_controllers_share_a_look_and_none_has_that_of_the_reference():
    pairs = [(one.colour, one.dashes) for one in CONTROLLERS.values()]
    assert len(set(pairs)) == len(pairs)
    assert not {BLACK, GREY} & {colour for colour, _ in pairs}  # the reference, and what explains a legend


def seen_without(missing, colour):
    """Return how a colour looks to an eye without one kind of cone, in CIELAB (Vienot, Brettel and Mollon 1999)."""
    lms = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
    blind = {
        "protan": np.array([[0, 2.02344, -2.52581], [0, 1, 0], [0, 0, 1]]),
        "deutan": np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]]),
    }[missing]
    linear = np.clip(np.linalg.inv(lms) @ blind @ lms @ np.array(to_rgb(colour)) ** 2.2, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    x, y, z = np.cbrt(xyz / np.array([0.9505, 1.0, 1.089]))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("missing", ["protan", "deutan"])
def test_the_papers_settings_and_the_default_are_told_apart_by_the_colour_blind(missing):
    colours = [seen_without(missing, CONTROLLERS[name].colour) for name in PAPER]
    apart = [float(np.linalg.norm(a - b)) for k, a in enumerate(colours) for b in colours[:k]]
    assert min(apart) > 15  # a difference of 2.3 is just seen side by side


@pytest.mark.parametrize("system", ["xi", "tras"])
def test_no_two_controllers_of_a_figure_of_the_ablation_share_a_look(system):
    settings = {str(row["setting"]): [0.0] for row in read_ablation(ROWS) if row["system"] == system}
    assert len(settings) > 9
    for family, members in families(settings, [0.0]).items():
        chosen = [tuple(look.values()) for look in looks(map(named, members)).values()]
        assert len(set(chosen)) == len(members), chosen
        assert not any("_" in words or words.startswith("real share") for words in (family, *map(named, members)))


def test_names_are_words_and_unique():
    assert named("rollouts_0") == "no planning" and named("horizon_20") == "rollouts of 20 periods"
    assert named("real_share_05") == "5 % of a batch real"
    assert named("rollouts_4") == "4 rollouts" and named("horizon_7") == "rollouts of 7 periods"
    assert named("horizon_20,agent.tau=0.1") == "horizon_20,agent.tau=0.1"
    words = [named(setting) for setting in CONTROLLERS]
    assert len(set(words)) == len(words) and not any("_" in word for word in words)


@pytest.mark.parametrize(
    ("planning", "words"),
    [
        ({"_target_": "dynasindy.planning.GradientPlanning", "rollouts": 128}, "planning by gradient"),
        ({"_target_": "dynasindy.planning.ImaginedReplay", "rollouts": 800}, "800 rollouts"),
        ({"_target_": "dynasindy.planning.ImaginedReplay", "rollouts": 0}, "no planning"),
        ({"_target_": "dynasindy.planning.NoPlanning"}, "no planning"),
        ({"_target_": "mine.Planning"}, "policy"),
        ({}, "policy"),
    ],
)
def test_a_controller_of_a_run_has_the_name_that_it_has_elsewhere(planning, words):
    assert by_planning(planning) == words


def test_integral_action_is_a_controller_of_its_own():
    assert with_integral(named("gradient")) == named("gradient_integral")
    assert looks([named("gradient"), named("gradient_integral")])[named("gradient_integral")]["linestyle"] == "--"
