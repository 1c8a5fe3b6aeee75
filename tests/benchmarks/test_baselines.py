"""The table of controllers: what is measured, how it is carried on, and what it says."""

import pytest
import torch
from benchmark import parse
from benchmarks import baselines, gradient

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.metrics import tracking_metrics
from dynasindy.planning.linear_model import jacobians, zero_order_hold
from dynasindy.safe_io import read_rows
from dynasindy.systems import Tras, Xi
from dynasindy.tasks import Step, Tracking


@pytest.fixture
def quick(monkeypatch):
    build, tiny = gradient.build_recipe, {"updates": 1, "rollouts": 4, "window": 5}
    baselines._parts.cache_clear()
    monkeypatch.setattr(gradient, "build_recipe", lambda c, p, s, planning: build(c, p, s, {**tiny, **planning}))


def options(tmp_path, *more):
    return ["--plants", "xi", "--seeds", "0", "--seconds", "1", "--out", str(tmp_path / "baselines.csv"), *more]


@pytest.mark.slow
def test_every_controller_and_model_has_its_rows_and_its_line(quick, tmp_path, monkeypatch):
    pytest.importorskip("control")
    pytest.importorskip("do_mpc")
    monkeypatch.setattr(baselines, "STEPS", 2)
    baselines.main(parse("baselines", options(tmp_path)))
    rows = read_rows(tmp_path / "baselines.csv")
    assert tuple(rows[0]) == baselines.COLUMNS
    assert len(rows) == 4 * 2 * 3 * 4
    real = {(row["controller"], row["model"]): float(row["real_seconds"]) for row in rows}
    assert {seconds for (_, model), seconds in real.items() if model == "identified"} == {10.0}
    assert real["NMPC, do-mpc", "true"] == 0.0
    assert all(float(row["ms_per_action"]) > 0 and 0 <= float(row["azimuth"]) < 20 for row in rows)
    page = (tmp_path / "baselines.md").read_text()
    assert page.count("| NMPC, do-mpc | identified | 10 | 1 |") == 3


def test_rows_in_the_file_are_not_measured_again_and_text_above_the_tables_stays(tmp_path, monkeypatch):
    calls = []

    def judged(env, policy, head, among):
        calls.append(head[:4])
        values = (*head, "step", "rmse", 0.1, 0.2, 1.0)
        return [dict(zip(baselines.COLUMNS, values, strict=True))]

    monkeypatch.setattr(baselines, "prepare", lambda *key: (None, None, 10.0))
    monkeypatch.setattr(baselines, "judge", judged)
    (tmp_path / "baselines.md").write_text("# Mine\n\n## Tables\n\nold\n")
    only = ("--controllers", "LQI, python-control", "--models", "identified", "true")
    baselines.main(parse("baselines", options(tmp_path, *only)))
    baselines.main(parse("baselines", [*options(tmp_path, *only), "--seeds", "0", "1"]))
    assert calls == [
        ("xi", "LQI, python-control", "identified", 0),
        ("xi", "LQI, python-control", "true", 0),
        ("xi", "LQI, python-control", "identified", 1),
    ]
    page = (tmp_path / "baselines.md").read_text()
    assert page.startswith("# Mine\n\n## Tables\n\n###")
    assert "old" not in page


def still(tensordict):
    return tensordict.set("action", torch.full((*tensordict.batch_size, 2), 0.1))


def test_figures_are_those_of_the_flight():
    system = Xi()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.0, 0.0]])), dtype=torch.float64)
    among = baselines.scenarios("xi", 5.0)[1:]
    rows = baselines.judge(env, still, ("xi", "LQI", "true", 0, 0.0), among)
    task = Tracking(system.signature, among[1].reference, max_steps=100)
    flown = ControlEnv(system, task, dtype=torch.float64).rollout(100, still)
    time = torch.arange(100) * 0.05
    metrics = tracking_metrics(time, flown["state"][:, :2], flown["reference"], flown["action"])
    for row in rows[4:]:
        assert row["scenario"] == "square"
        assert [row["azimuth"], row["pitch"]] == pytest.approx(metrics[row["metric"]].tolist(), rel=1e-3, abs=1e-6)


def row(controller, scenario, metric, azimuth, seed=0):
    values = ("xi", controller, "identified", str(seed), "10", scenario, metric, str(azimuth), "0.5", "1")
    return dict(zip(baselines.COLUMNS, values, strict=True))


def test_the_learned_controller_is_held_against_the_better_rival():
    rows = [
        row("planning by gradient", "sine", "rmse", 0.004),
        row("LQI", "sine", "rmse", 0.003),
        row("MPC", "sine", "rmse", 0.006),
    ]
    lines = baselines.goals(rows).splitlines()[2:]
    assert [line.rpartition(" | ")[2] for line in lines] == ["behind by 0.001 |", "level by 0 |"]


def test_rows_of_a_run_replace_earlier_ones_of_the_same_seed_only(tmp_path):
    path = tmp_path / "baselines.csv"
    for value, seed in ((0.1, 0), (0.2, 1), (0.3, 0)):
        baselines.append(path, [row("TD3", "step", "rmse", value, seed)])
    assert [(r["seed"], r["azimuth"]) for r in read_rows(path)] == [("1", "0.2"), ("0", "0.3")]


def rests(system, policy, targets, seconds):
    env = ControlEnv(system, Tracking(system.signature, Step(targets)), dtype=torch.float64)
    return env.rollout(round(seconds / 0.05), policy)["state"][-1, :2]


def test_lqi_has_the_gain_of_a_riccati_recursion_and_no_error_under_a_steady_push():
    pytest.importorskip("control")

    class Pushed(Xi):
        def forward(self, x, u):
            return super().forward(x, u) + torch.tensor([0, 0, 0.1, 0.3, 0, 0], dtype=x.dtype)

    lqi = baselines.Lqi(Xi(), 0.05)
    a, b = zero_order_hold(*jacobians(Xi(), *lqi.equilibria.state_and_input(torch.zeros(2), lqi.equilibria.home)), 0.05)
    f = torch.zeros(8, 8, dtype=torch.float64)
    f[:6, :6], f[6, 0], f[7, 1], f[6:, 6:] = a, 1.0, 1.0, torch.eye(2)
    g = torch.cat((b, torch.zeros(2, 2)))
    scale = torch.tensor([*Xi().signature.x_scale, 1, 1], dtype=torch.float64)
    q = torch.diag(torch.tensor([30, 30, 1, 1, 0, 0, 50 * 0.05**2, 50 * 0.05**2]).double() / scale**2)
    p, r = q.clone(), torch.eye(2, dtype=torch.float64)
    for _ in range(20_000):
        gain = torch.linalg.solve(r + g.T @ p @ g, g.T @ p @ f)
        p = q + f.T @ p @ (f - g @ gain)
    torch.testing.assert_close(lqi.gain, gain, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(
        rests(Pushed(), lqi, [[0.3, 0.2]], 40).float(), torch.tensor([0.3, 0.2]), atol=1e-3, rtol=0
    )


@pytest.mark.slow
@pytest.mark.parametrize("system", [Xi(), Tras()])
def test_do_mpc_predicts_by_the_equations_of_the_plant_and_brings_it_to_its_target(system):
    casadi = pytest.importorskip("casadi")
    pytest.importorskip("do_mpc")
    x, u = torch.tensor([0.1, 0.2, -0.3, 0.4, 500.0, -900.0]).double(), torch.tensor([0.3, -0.6]).double()
    rates = baselines.casadi_field(system, smooth=False)(x.tolist(), u.tolist())
    assert [float(casadi.DM(rate)) for rate in rates] == pytest.approx(system(x, u).tolist(), rel=1e-9)
    at = rests(system, baselines.Nmpc(system, 0.05), [[0.2, 0.1]], 6)
    torch.testing.assert_close(at.float(), torch.tensor([0.2, 0.1]), atol=5e-3, rtol=0)
