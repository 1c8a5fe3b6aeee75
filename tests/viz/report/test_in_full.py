import shutil

import numpy as np
import pytest

from dynasindy.viz.report import control
from dynasindy.viz.report.document import Picture, Table, Text
from dynasindy.viz.report.in_full import longer
from dynasindy.viz.report.sources import Results

HEADER = "system,setting,seed,episode,evaluated_return,azimuth,pitch,commit\r\n"
ENDS = {("rollouts_0", 0): 12, ("rollouts_800", 0): 12, ("rollouts_800", 1): 12, ("rollouts_800", 2): 9}
"""The last episode of each run that went on; one without planning stopped before the curves end."""


def line(setting, seed, k):
    """Return a row whose return rises and whose error falls with 800 rollouts, and the other way round without."""
    better = setting == "rollouts_800"
    return f"xi,{setting},{seed},{k},{-100 / k if better else -k},{0.3 / k if better else 0.01 * k},0.001,abc1234\r\n"


@pytest.fixture
def both(results, tmp_path):
    """Results whose curves of the paper's experiment end at episode 6, and single runs that go on."""
    more = tmp_path / "results"
    shutil.copytree(results.folder, more)
    for name in ("ablation", "ablation_curves"):
        (more / f"{name}.csv").write_text((more / f"{name}.csv").read_text().replace("xi,dyna", "xi,paper"))
    rows = [line(*run, k) for run, last in ENDS.items() for k in range(1, last + 1)]
    rows += [line("rollouts_0", 1, k) for k in range(1, 5)] + ["tras,rollouts_800,0,12,-1,1,1,abc1234\r\n"]
    (more / "paper_in_full.csv").write_text("".join([HEADER, *rows]))
    return Results(more, results.settings)


def test_runs_that_went_on_are_thin_lines_up_to_their_own_end(both):
    (picture,) = [part for part in control.rewards(both).parts if isinstance(part, Picture)]
    (axis,) = picture.figure.axes
    thin = [one for one in axis.lines if "longer" in str(one.get_label()) and one.get_visible()]
    assert [one.get_label() for one in thin] == [
        "no planning, longer (1 seed)",
        "800 rollouts, longer (3 seeds)",
        "_800 rollouts, longer (3 seeds)",
        "_800 rollouts, longer (3 seeds)",
    ]
    assert [one.get_xdata()[-1] for one in thin] == [12, 12, 12, 9] and axis.get_xlim()[1] > 12
    np.testing.assert_allclose(thin[1].get_ydata(), [-100 / k for k in range(1, 13)])
    colours = {one.get_label(): one.get_color() for one in axis.lines}
    assert thin[1].get_color() == colours["800 rollouts (3 seeds)"] != thin[0].get_color()


def test_the_caption_counts_the_seeds_of_the_table(both):
    (picture,) = [part for part in control.rewards(both).parts if isinstance(part, Picture)]
    assert picture.caption.endswith(
        "Thin lines are other runs, which went beyond episode 6: 1 seed without planning to episode 12, 2 seeds with "
        "800 rollouts to episode 12 and 1 seed with 800 rollouts to episode 9; no seed with 400 rollouts did."
    )
    with (both.folder / "paper_in_full.csv").open("a") as file:
        file.writelines(line("rollouts_400", 7, k) for k in (6, 12))
    (picture,) = [part for part in control.rewards(both).parts if isinstance(part, Picture)]
    assert "1 seed with 400 rollouts to episode 12" in picture.caption and "did." not in picture.caption


def test_what_became_of_them_after_the_curves_end_is_told(both):
    parts = control.rewards(both).parts
    (words,) = [part.words for part in parts if isinstance(part, Text) and "the whole curve" in part.words]
    assert "4 other runs went beyond it. From there to the end the return rose in 3 of them" in words
    assert "the error of the worse axis fell in 3" in words
    table, settings = (part for part in parts if isinstance(part, Table))
    # Errors with 800 rollouts are 0.3 / k, so 0.05 rad is reached at once after 6; without they are 0.01 k until 5.
    average = f"{-sum(100 / k for k in range(1, 13)) / 12:.4g}"
    assert settings.rows == [
        ["no planning", "1", "-6.5", "-12", "0.12", "0 of 1", "1"],
        ["800 rollouts", "2", f"{average}, {average}", "-8.333, -8.333", "0.025, 0.025", "2 of 2", "6, 6"],
    ]
    assert table.rows[0] == ["no planning", "0", "12", "-6", "-12", "0.06", "0.12", "abc1234"]
    assert table.rows[3] == ["800 rollouts", "2", "9", "-16.67", "-11.11", "0.05", "0.03333", "abc1234"]


def test_without_runs_that_went_on_nothing_is_said_of_any(results, both):
    assert longer(both, "xi", "dyna", 6.0) == longer(both, "xi", "paper", 12.0) == []
    section = control.rewards(results)
    (caption,) = [part.caption for part in section.parts if isinstance(part, Picture)]
    assert "Thin lines" not in caption and not [part for part in section.parts if isinstance(part, Table)]
