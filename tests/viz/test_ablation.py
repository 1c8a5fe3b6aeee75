import numpy as np
import pytest

from dynasindy.evaluation.ablation import write_ablation
from dynasindy.viz.ablation import control_families, draw_ablation, draw_controls, steady_state_errors


def test_the_error_figure_has_a_line_per_setting_and_the_level():
    figure = steady_state_errors({"a": np.full((3, 4), 0.1), "b": np.full((2, 4), 0.02)}, level=0.05)
    (axis,) = figure.axes
    lines = {line.get_label(): line.get_ydata() for line in axis.lines}
    np.testing.assert_allclose(lines["a (3 seeds)"], 0.1)
    np.testing.assert_allclose(lines["b (2 seeds)"], 0.02)
    assert list(lines["required: at most 0.05 rad"]) == [0.05, 0.05]
    assert axis.get_yscale() == "log"


def test_runs_that_are_evaluated_now_and_then_stand_at_the_episodes_of_their_evaluations():
    figure = steady_state_errors({"a": np.full((2, 3), 0.1)}, level=0.05, episode=[2, 4, 6, 8])
    line = next(line for line in figure.axes[0].lines if line.get_label() == "a (2 seeds)")
    assert list(line.get_xdata()) == [2, 4, 6]


@pytest.mark.parametrize("common", ["", "".join(f",scenario.reference.option_{k}=10" for k in range(20))])
def test_a_pair_of_figures_for_every_plant_and_experiment(tmp_path, common):
    rows = [
        {
            "system": system, "experiment": "dyna", "setting": setting + common, "seed": seed, "episode": episode,
            "evaluated_return": -10.0, "evaluated_steady_state_error/y": 0.1, "evaluated_steady_state_error/z": 0.2,
        }
        for system in ("tras", "xi")
        for setting in ("a", "b")
        for seed in (0, 1)
        for episode in range(1, 4 + seed)
    ]  # fmt: skip
    write_ablation(tmp_path / "ablation_curves.csv", rows)
    names = {file.name for file in draw_ablation(tmp_path, 0.05)}
    kinds = ("average_rewards", "steady_state_error")
    assert names == {f"{kind}_{system}_dyna.png" for kind in kinds for system in ("tras", "xi")}


def test_controls_stand_by_what_they_vary_beside_the_reference_where_it_compares():
    names = ("direct", "horizon_100", "horizon_20", "oracle", "real_share_05", "horizon_20,agent.tau=0.1")
    names += ("rollouts_0_tuned", "sb3_sac", "sb3_sac_5")
    curves = {name: np.full((1, 2), float(k)) for k, name in enumerate(names)}
    found = control_families(curves, np.full((5, 2), 9.0))
    assert {family: list(members) for family, members in found.items()} == {
        "changed on the command line": ["rollouts_800", "horizon_20,agent.tau=0.1"],
        # At equal numbers of transitions, of which the reference has more.
        "length of a rollout, at equal numbers of imagined transitions": ["horizon_20", "horizon_100"],
        "other models, and the gate": ["rollouts_800", "oracle"],
        "share of real transitions in a batch": ["rollouts_800", "real_share_05"],
        "without a model": ["rollouts_800", "direct", "rollouts_0_tuned", "sb3_sac", "sb3_sac_5"],
    }
    assert list(control_families({"direct": curves["direct"]}, None)["without a model"]) == ["direct"]


def test_the_settings_of_the_paper_stand_alone_and_the_controls_in_a_figure_of_their_own(tmp_path):
    rows = [
        {
            "system": "xi", "experiment": "dyna", "setting": setting, "seed": 0, "episode": episode,
            "evaluated_return": -10.0, "evaluated_steady_state_error/y": 0.1,
        }
        for setting in ("direct", "rollouts_0", "rollouts_800")
        for episode in (1, 2)
    ]  # fmt: skip
    write_ablation(tmp_path / "ablation_curves.csv", rows)
    drawn = {file.stem for file in draw_ablation(tmp_path, 0.05, ("svg",))}
    assert drawn == {"average_rewards_xi_dyna", "steady_state_error_xi_dyna", "controls_xi_dyna"}


def test_the_figure_of_controls_has_a_panel_per_family_on_one_scale():
    control_families = {"horizon": {"horizon_1": np.full((2, 3), 0.1)}, "others": {"direct": np.full((1, 3), 2.0)}}
    figure = draw_controls(control_families, level=0.05)
    assert [axis.get_title() for axis in figure.axes] == ["horizon", "others"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    assert figure.axes[1].get_legend().get_texts()[0].get_text() == "direct (1 seed)"


def hostile_rows(**changed):
    row = {"system": "xi", "experiment": "dyna", "setting": "a", "seed": 0, "episode": 1, "evaluated_return": -1.0}
    return [{**row, "evaluated_steady_state_error/y": 0.1, **changed}]


@pytest.mark.parametrize("changed", [{"system": "../../x"}, {"experiment": "x/../../../y"}, {"system": "/tmp/x"}])
def test_cells_of_a_table_do_not_choose_where_figures_go(tmp_path, changed):
    (tmp_path / "results").mkdir()
    write_ablation(tmp_path / "results" / "ablation_curves.csv", hostile_rows(**changed))
    with pytest.raises(ValueError, match="file"):
        draw_ablation(tmp_path / "results", 0.05)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["ablation_curves.csv"]


def test_a_setting_with_signs_of_mathematics_is_drawn_as_it_stands(tmp_path):
    write_ablation(tmp_path / "ablation_curves.csv", hostile_rows(setting="$\\frac{$,x=<b>"))
    assert draw_ablation(tmp_path, 0.05)


def test_errors_of_outputs_in_several_units_are_drawn_as_per_cent_of_the_target_range(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("dynasindy.viz.ablation.save", lambda figure, *_: drawn.append(figure) or [])
    rows = [row for n in (1, 2) for row in hostile_rows(episode=n, steady_state_share=0.4 / n)]
    write_ablation(tmp_path / "ablation_curves.csv", [*rows, *({**row, "setting": "rollouts_800"} for row in rows)])
    draw_ablation(tmp_path, 0.05, share=0.1)
    for axis, label in ((drawn[1].axes[0], "800 rollouts"), (drawn[2].axes[0], "a (1 seed)")):
        lines = {line.get_label(): list(line.get_ydata()) for line in axis.lines}
        assert lines["required: at most 10 % of the target range"] == [10.0, 10.0]
        assert next(ends for name, ends in lines.items() if name.startswith(label)) == pytest.approx([40.0, 20.0])
        assert "worse axis [% of range]" in axis.get_ylabel() and "rad" not in axis.get_ylabel()
