import shutil

import numpy as np
import pytest

from dynasindy.viz.report import control
from dynasindy.viz.report.document import Picture, Table, Text, Verdict
from dynasindy.viz.report.sources import Results


def lines(section):
    return [part.words for part in section.parts if isinstance(part, Text) and part.words.startswith("Not measured")]


def pictures(section):
    return {part.name: part.figure for part in section.parts if isinstance(part, Picture)}


def test_average_rewards_are_the_numbers_of_the_table(results):
    section = control.rewards(results)
    (axis,) = pictures(section)["average_rewards_xi_dyna"].axes
    curves = {line.get_label(): line.get_ydata() for line in axis.lines}
    np.testing.assert_allclose(curves["800 rollouts (3 seeds)"], [-10.0 / k + 1.0 for k in range(1, 7)])
    np.testing.assert_allclose(curves["no planning (3 seeds)"], [-200.0 / k + 1.0 for k in range(1, 7)])
    said = {finding.paper: finding for finding in section.findings if finding.case == "xi, `dyna`"}
    level = said["planning reaches the required level sooner"]
    assert level.verdict is Verdict.AS and level.ours.endswith("no planning never, 400 rollouts 6, 800 rollouts 4")
    assert "`python scripts/ablation.py system=xi experiment=paper` makes them" in lines(section)[0]
    assert len(lines(section)) == 3


def test_other_agents_without_a_model_stand_beside_where_the_level_is_compared(results, tmp_path):
    more = tmp_path / "results"
    shutil.copytree(results.folder, more)
    with (more / "ablation.csv").open("a") as file:
        file.write("xi,dyna,sb3_sac_5,0,7,5,abc1234\r\nxi,dyna,sb3_sac_5,1,7,5,abc1234\r\n")
    section = control.rewards(Results(more, results.settings))
    said = {finding.paper: finding for finding in section.findings if finding.case == "xi, `dyna`"}
    level = said["planning reaches the required level sooner"]
    assert level.ours.endswith("800 rollouts 4, SAC, five updates per step (7 episodes) 5")
    assert level.verdict is Verdict.SHORT
    (axis,) = pictures(section)["average_rewards_xi_dyna"].axes
    assert not any("SAC" in str(line.get_label()) for line in axis.lines)


def test_the_caption_of_curves_over_seeds_names_the_commits_of_their_runs_and_the_commands_of_the_saved_ones(results):
    (caption,) = [part.source for part in control.rewards(results).parts if isinstance(part, Picture)]
    command = "`python scripts/ablation.py system=xi experiment=dyna train.episodes=6 setting="
    assert f"ablation_curves.csv`, of runs with the settings of {command}" in caption
    assert "rollouts_0,rollouts_400,rollouts_800 seed=0,1,2` at commit abc1234 and def5678. First seeds: Run" in caption
    for name in ("rollouts_0", "rollouts_400", "rollouts_800"):
        assert f"xi_dyna_{name}`, made by `python scripts/x.py` at commit abc1234." in caption


@pytest.fixture
def longer(results, tmp_path):
    """Results whose rows are of 9 episodes, but seed 1 without planning ends at 7; saved runs have 6 as before."""
    more = tmp_path / "results"
    shutil.copytree(results.folder, more)
    runs = (
        (more / "ablation.csv").read_text().replace(",6,6,", ",9,6,").replace(",6,4,", ",9,4,").replace(",6,,", ",9,,")
    )
    (more / "ablation.csv").write_text(runs)
    with (more / "ablation_curves.csv").open("a") as file:
        for name in ("rollouts_0", "rollouts_400", "rollouts_800"):
            for seed, end in ((0, 9), (1, 7 if name == "rollouts_0" else 9), (2, 9)):
                file.writelines(f"xi,dyna,{name},{seed},{k},-1,0.01,0.01\r\n" for k in range(7, end + 1))
    return Results(more, results.settings)


def test_runs_of_another_length_are_not_told_as_the_first_seeds_of_curves_and_both_lengths_are_told(longer):
    section = control.rewards(longer)
    (picture,) = [part for part in section.parts if isinstance(part, Picture)]
    assert "First seeds" not in picture.source and "train.episodes=9 setting=" in picture.source
    # Nothing is compared after episode 7, which is as far as all seeds go.
    assert "up to 7 of them" in picture.caption
    assert {len(line.get_xdata()) for line in picture.figure.axes[0].lines} - {0} == {7}
    for section in (control.steps(longer), control.wave(longer, "sine")):
        (caption,) = [part.caption for part in section.parts if isinstance(part, Picture)]
        assert "after 6 real episodes. Figure 11 is of other runs, of 9 episodes," in caption


def test_runs_of_the_same_length_at_another_commit_are_not_the_first_seeds(results, tmp_path):
    more = tmp_path / "results"
    shutil.copytree(results.folder, more)
    file = more / "ablation.csv"
    file.write_text(file.read_text().replace("abc1234", "7654321"))
    (picture,) = [part for part in control.rewards(Results(more, results.settings)).parts if isinstance(part, Picture)]
    assert "First seeds" not in picture.source and "commit 7654321 and def5678" in picture.source


def test_errors_at_the_end_are_those_of_the_worse_axis(results):
    findings = [one for one in control.rewards(results).findings if one.case == "xi, `dyna`"]
    (end,) = [one for one in findings if one.paper.startswith("all settings end")]
    assert "no planning 0.2 to 0.2, 400 rollouts 0.05 to 0.0501, 800 rollouts 0.01 to 0.01, not all of" in end.ours


def test_steps_of_the_three_settings_share_axes_and_their_errors_are_those_of_the_runs(results):
    section = control.steps(results)
    figure = pictures(section)["step_xi_dyna"]
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels[:4] == ["reference", "no planning", "400 rollouts", "800 rollouts"]
    (table,) = [part for part in section.parts if isinstance(part, Table)]
    assert [row[:4] for row in table.rows] == [
        ["no planning", "0.2", "0.2", "5"],
        ["400 rollouts", "0.05", "0.05", "5"],
        ["800 rollouts", "0.01", "0.01", "5"],
    ]
    assert table.rows[0][4] == "-"  # no number
    assert [finding.verdict for finding in section.findings[:3]] == [Verdict.AS, Verdict.BETTER, Verdict.AS]


def test_waves_compare_the_model_with_none(results):
    for shape in ("sine", "square"):
        section = control.wave(results, shape)
        figure = pictures(section)[f"{shape}_xi_dyna"]
        lines_of = {line.get_label(): line.get_ydata() for line in figure.axes[0].lines}
        np.testing.assert_allclose(lines_of["800 rollouts"] - lines_of["reference"], 0.01, atol=1e-12)
        np.testing.assert_allclose(lines_of["no planning"] - lines_of["reference"], 0.2, atol=1e-12)
        assert section.findings[0].verdict is Verdict.AS
        assert len(lines(section)) == 3


def test_a_step_is_named_and_overshoot_says_over_which_targets_it_is_a_median(results):
    section = control.steps(results)
    (caption,) = [part.caption for part in section.parts if isinstance(part, Picture)]
    assert caption.startswith(
        "The first of the 64 targets, the one nearest to three quarters of the upper ends, on `xi`"
    )
    (words,) = [
        part.words for part in section.parts if isinstance(part, Text) and part.words.startswith("**Plant `xi`")
    ]
    assert words.endswith("overshoot: median over those that move the axis by 5 % of the range of its targets.")
    counted = {"a": {"steps/alpha_a": 56.0, "steps/alpha_p": 57.0}}
    assert control._counted(counted) == " (56 on azimuth, 57 on pitch)"
    assert control._counted(counted | {"b": {}}) == ""
