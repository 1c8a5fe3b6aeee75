from pathlib import Path

import pytest

from dynasindy.evaluation.ablation import read_rows
from dynasindy.viz.ablation import families
from dynasindy.viz.controllers import COLOURS, NAMES, colours, named
from dynasindy.viz.style import BLACK, BLUE, GREEN, GREY, RED

ROWS = Path(__file__).parents[2] / "docs/results/ablation.csv"


def test_a_controller_has_one_colour_by_its_setting_and_by_its_words_in_every_company():
    assert colours(["rollouts_800", "rollouts_0"]) == {"rollouts_800": BLUE, "rollouts_0": RED}
    assert colours(["no planning", "x", "800 rollouts"]) == {"no planning": RED, "x": GREEN, "800 rollouts": BLUE}
    assert len(set(colours("abcdef").values())) == 6


@pytest.mark.parametrize("system", ["xi", "tras"])
def test_no_two_controllers_of_a_figure_of_the_ablation_share_a_colour(system):
    settings = {str(row["setting"]): [0.0] for row in read_rows(ROWS) if row["system"] == system}
    assert len(settings) > 9
    for members in families(settings, [0.0]).values():
        chosen = colours(map(named, members))
        assert len(set(chosen.values())) == len(members), chosen
        assert not {BLACK, GREY} & set(chosen.values())  # the reference, and what explains a legend


def test_names_are_words_and_unique():
    assert named("rollouts_0") == "no planning" and named("horizon_20") == "horizon 20"
    assert named("horizon_20,agent.tau=0.1") == "horizon_20,agent.tau=0.1"
    words = [named(setting) for setting in {*NAMES, *COLOURS}]
    assert len(set(words)) == len(words) and not any("_" in word for word in words)
