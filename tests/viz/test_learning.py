"""Learning figures: the statistics they draw against hand-computed ones, and what stands beside what."""

import numpy as np
import pandas as pd
import pytest

from dynasindy.evaluation.ablation import Level
from dynasindy.viz.learning import average_rewards, draw_ablation
from dynasindy.viz.run import _learning_curve


def test_learning_curve_draws_episodes_their_moving_mean_and_evaluations() -> None:
    returns = np.arange(30.0)
    evaluations = {10: 12.0, 20: 22.0}
    rows = {"episode": np.arange(1, 31), "return": returns}
    rows["evaluated_return"] = [evaluations.get(episode, np.nan) for episode in rows["episode"]]
    figure = _learning_curve(pd.DataFrame(rows), 5.0)
    raw, mean, evaluated = figure.axes[0].lines
    np.testing.assert_array_equal(raw.get_ydata(), returns)
    assert [mean.get_ydata()[k] for k in (0, 2, 29)] == [0.0, 1.0, 24.5]
    np.testing.assert_array_equal(evaluated.get_xydata(), [[0, 5.0], [10, 12.0], [20, 22.0]])


def test_average_rewards_draw_the_interquartile_mean_within_its_band() -> None:
    one = np.array([[0.0], [10.0], [20.0], [1000.0]]) + np.zeros((4, 6))
    (axis,) = average_rewards({"wild": pd.DataFrame(one), "calm": pd.DataFrame(np.ones((3, 6)))}).axes
    np.testing.assert_allclose(axis.lines[0].get_ydata(), 15.0)
    low, high = (f(axis.collections[0].get_paths()[0].vertices[:, 1]) for f in (np.min, np.max))
    assert 0 <= low <= 15 <= high <= 1000
    assert len(axis.collections) == 2  # three seeds have a band, too


def test_a_logarithmic_axis_is_for_returns_that_differ_much() -> None:
    scales = [
        average_rewards({"a": pd.DataFrame([[low, -1000.0]])}).axes[0].get_yscale() for low in (-100.0, -20.0, 5.0)
    ]
    assert scales == ["linear", "symlog", "symlog"]


def rows(settings, episodes=(1, 2), seeds=(0, 1), **changed):
    return [
        {
            "system": "xi", "experiment": "dyna", "setting": setting, "seed": seed, "episode": episode,
            "evaluated_return": -10.0, "evaluated_steady_state_error/y": error, "evaluated_steady_state_error/z": 0.02,
            **changed,
        }
        for setting, error in settings.items()
        for seed in seeds
        for episode in episodes
    ]  # fmt: skip


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Draw an ablation of rows and return its figures by file."""

    def _draw(table, **level):
        found = {}
        monkeypatch.setattr("dynasindy.viz.style.save_figures", lambda figures, *_: found.update(figures) or [])
        pd.DataFrame(table).to_csv(tmp_path / "ablation_curves.csv", index=False)
        draw_ablation(tmp_path, Level(**level))
        return found

    return _draw


def lines(axis):
    return {line.get_label(): line.get_xydata().tolist() for line in axis.lines if len(line.get_xdata())}


@pytest.mark.parametrize("common", ["", "".join(f",scenario.reference.option_{k}=10" for k in range(20))])
def test_a_pair_of_figures_for_every_plant_and_experiment(tmp_path, common):
    both = [rows({f"a{common}": 0.1, f"b{common}": 0.2}, system=system) for system in ("tras", "xi")]
    pd.DataFrame(both[0] + both[1]).to_csv(tmp_path / "ablation_curves.csv", index=False)
    names = {file.name for file in draw_ablation(tmp_path, Level())}
    kinds = ("average_rewards", "steady_state_error")
    assert names == {f"{kind}_{system}_dyna.png" for kind in kinds for system in ("tras", "xi")}
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)


def test_the_error_of_the_worse_axis_stands_at_its_evaluations_beside_the_level(drawn):
    found = drawn(rows({"rollouts_0": 0.1, "rollouts_800": 0.01}, episodes=(2, 4, 6)))
    (axis,) = found["steady_state_error_xi_dyna"].axes
    curves = lines(axis)
    assert curves["no planning (2 seeds)"] == [[2, 0.1], [4, 0.1], [6, 0.1]]
    assert curves["800 rollouts (2 seeds)"][0] == [2, 0.02] and axis.get_yscale() == "log"
    assert curves["required: at most 0.05 rad"][0][1] == 0.05


def test_seeds_that_share_no_episode_have_no_curve_and_spoil_none(drawn):
    apart = [row for seed in range(3) for row in rows({"a": 0.1}, (seed,), (seed,))]
    for others, curves in (([], 0), (rows({"b": 0.2}, (4, 6)), 2)):
        (axis,) = drawn(apart + others)["average_rewards_xi_dyna"].axes
        assert sum(len(line.get_xdata()) > 0 for line in axis.lines) == curves
        assert "a (3 seeds, no common episode)" in [line.get_label() for line in axis.lines]


def test_of_many_settings_those_of_the_paper_are_drawn(drawn):
    names = ("direct", "oracle", "sb3_sac", "sb3_sac_5", "rollouts_0", "rollouts_800")
    some = drawn(rows(dict.fromkeys(names, 0.1), seeds=(0,)))["steady_state_error_xi_dyna"].axes[0]
    assert len([name for name in lines(some) if "(1 seed)" in name]) == 6
    found = drawn(rows(dict.fromkeys((*names, "pysindy"), 0.1), seeds=(0,)))
    shown = [name.partition(" (")[0] for name in lines(found["steady_state_error_xi_dyna"].axes[0])][:-1]
    assert set(found) == {"average_rewards_xi_dyna", "steady_state_error_xi_dyna"}
    assert shown == ["no planning", "800 rollouts"]


def test_errors_of_outputs_in_several_units_are_drawn_as_per_cent_of_the_target_range(drawn):
    table = [
        row
        for name in ("a", "rollouts_800")
        for n in (1, 2)
        for row in rows({name: 0.1}, (n,), (0,), steady_state_share=0.4 / n)
    ]
    found = drawn(table, share=0.1)
    for curve in ("800 rollouts (1 seed)", "a (1 seed)"):
        curves = lines(found["steady_state_error_xi_dyna"].axes[0])
        assert curves["required: at most 10 % of the target range"][0][1] == 10.0
        np.testing.assert_allclose(curves[curve], [[1, 40.0], [2, 20.0]])
