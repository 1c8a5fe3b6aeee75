"""Summaries: what is a mean, what is a median, and that JSON can hold them."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward, Wave, wave
from dynasindy.evaluation.metrics import CONTROL, STEP, TRACKING, to_text, tracking_metrics
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.findings import weak
from dynasindy.systems import Pendulum, Signature, Xi


def evaluation(**changes: torch.Tensor) -> Evaluation:
    metrics = {name: torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.5, 0.9]]) for name in (*TRACKING, *STEP)}
    metrics |= {name: torch.tensor([[1.0], [2.0], [3.0]]) for name in CONTROL}
    rewards = torch.tensor([-3.0, 0.0, 9.0]).reshape(3, 1, 1)
    at_stop = torch.tensor([False, False, True]).reshape(3, 1, 1)
    trajectory = TensorDict({"next": TensorDict({"reward": rewards, "at_stop": at_stop}, [3, 1])}, [3, 1])
    signature = Signature(("alpha_a", "alpha_p"), ("rad", "rad"), ("u",), (1.0, 1.0))
    return Evaluation("made up", signature, (0, 1), torch.zeros(1), trajectory, metrics | changes)


def test_means_of_errors_and_medians_of_times() -> None:
    summary = evaluation().summary()
    assert summary["return"] == pytest.approx(2.0)
    assert summary["stop_share"] == pytest.approx(1 / 3)
    assert summary["rmse/alpha_p"] == pytest.approx(0.5)
    assert summary["rise_time/alpha_p"] == pytest.approx(0.4)
    assert summary["control_effort/u"] == pytest.approx(2.0)


def test_an_input_that_swings_while_a_target_is_held_is_told() -> None:
    """Of 100 periods the last quarter counts; there u swings by 0.1 in one run of two, and v by 0.02 in both."""
    swing = torch.tensor([1.0, -1.0]).repeat(50)
    early = torch.where(torch.arange(100) < 60, 5.0, 0.0) * swing
    u = torch.stack([0.05 * swing, early])
    action = torch.stack([u, (0.01 * swing).expand(2, -1)], -1)
    signature = Signature(("a",), ("rad",), ("u", "v"), (1.0,))
    trajectory = TensorDict({"action": action, "reference": torch.zeros(2, 100, 1)}, [2, 100])
    found = Evaluation("made up", signature, (0,), 0.05 * torch.arange(100), trajectory, {})
    assert found.restless == [weak("control.restless", input="u", percent=pytest.approx(2.5))]
    trajectory["reference"][:, -1] = 1.0
    assert found.restless == []


def test_steps_that_never_settle_count_and_rows_without_a_step_do_not() -> None:
    times = torch.tensor([[math.inf, math.nan], [math.inf, math.nan], [2.0, 3.0]])
    summary = evaluation(settling_time=times).summary()
    assert summary["settling_time/alpha_a"] is None
    assert summary["settled/alpha_a"] == pytest.approx(1 / 3)
    assert summary["settling_time/alpha_p"] == pytest.approx(3.0)
    assert summary["settled/alpha_p"] == 1.0
    json.dumps(summary, allow_nan=False)


def test_the_table_names_every_metric_with_its_unit() -> None:
    undefined = torch.full((3, 2), math.nan)
    text = to_text(evaluation(overshoot=undefined).summary(), "Step")
    lines = text.splitlines()
    assert lines[0] == "Step"
    row = next(line for line in lines if line.startswith("steady-state error"))
    assert "[rad]" in row
    assert row.split()[-2:] == ["0.3", "0.5"]
    row = next(line for line in lines if line.startswith("overshoot [%]"))
    assert row.split()[-2:] == ["-", "-"]
    assert len({len(line) for line in lines[2:9]}) == 1
    assert row_of(text, "control effort (mean u^2) [-]") == row_of(text, "control variation [1/s]") == ["2"]


def row_of(text: str, words: str) -> list[str]:
    return next(line.removeprefix(words) for line in text.splitlines() if line.startswith(words)).split()


def row(text: str, start: str) -> list[str]:
    return next(line for line in text.splitlines() if line.startswith(start)).split()


@pytest.mark.parametrize(
    ("signal", "kept"), [(torch.sin, False), (lambda t: torch.sin(t).sign(), True), (torch.ones_like, True)]
)
def test_only_what_rests_has_a_steady_state_to_read(signal, kept):
    """A square rests between its jumps, one of which is in the last quarter of two periods; a sine never rests."""
    time = 0.05 * torch.arange(252, dtype=torch.float64)
    y, r = torch.zeros(1, 252, 1).double(), signal(time + 0.01).reshape(1, 252, 1)
    metrics = tracking_metrics(time, y, r, torch.zeros(1, 252, 1))
    following = TensorDict({"reward": torch.zeros(1, 252, 1), "at_stop": torch.zeros(1, 252, 1)}, [1, 252])
    trajectory = TensorDict({"state": y, "reference": r, "next": following}, [1, 252])
    made = Evaluation("made up", Signature(("h",), ("m",), ("u",), (1.0,)), (0,), time, trajectory, metrics)
    summary = made.summary()
    text = to_text(summary, units=made.units, steady=made.told_steady_seconds)
    assert summary["steady_state_error/h"] is not None and "mean abs error [m]" in text
    assert ("steady-state error" in text) == kept


def test_references_beyond_the_targets_of_the_plant_are_told_and_others_are_not() -> None:
    system = Pendulum()
    box = {"low": [-0.3], "high": [0.4]}
    task = Tracking(system.signature, Step([[0.1]]), ["theta"], ["Omega"], TrackingReward((4.0,)), **box)
    env = ControlEnv(system, task, substeps=1)

    def still(td):
        return td.set("action", torch.zeros(*td.batch_size, 1))

    own = Wave([0.35], [1.0], "square")
    (told,) = evaluate(env, still, Scenario("square", own, seconds=2.0)).beyond_targets
    assert (told.code, told.values["output"], told.values["scenario"]) == ("control.beyond_targets", "theta", "square")
    ends = [told.values[name] for name in ("least", "most", "low", "high")]
    assert ends == pytest.approx([-0.35, 0.35, -0.3, 0.4])
    derived = wave("square", [-0.3], [0.4], 20, 0.05)
    assert evaluate(env, still, Scenario("square", derived, seconds=2.0)).beyond_targets == []
    assert evaluate(env, still, Scenario("step", Step([[0.4], [-0.3]]), 2, 1.0)).beyond_targets == []
    upright = Tracking(
        system.signature, Step([[math.pi]]), ["theta"], ["Omega"], TrackingReward((4.0,)), low=[math.pi], high=[math.pi]
    )
    assert evaluate(ControlEnv(system, upright), still, Scenario("step", seconds=1.0)).beyond_targets == []


def test_json_holds_the_summary_and_csv_one_row(tmp_path: Path) -> None:
    system = Xi()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.1, 0.2], [0.3, -0.1]])), substeps=1)
    scenario = Scenario("two", episodes=2, seconds=0.5)
    result = evaluate(env, lambda td: td.set("action", torch.full((*td.batch_size, 2), 0.25)), scenario)
    figures, table = result.save(tmp_path / "new")
    episode, _ = result.representative_episode

    record = json.loads(figures.read_text())
    assert (record.pop("scenario"), record.pop("rows")) == ("two", 2)
    assert record == result.summary()
    rates = result.trajectory["state"][..., 2:].flatten(0, -2)
    ends = [[record[f"{end}/{name}"] for name in system.signature.state_names[2:]] for end in ("least", "most")]
    assert np.array(ends) == pytest.approx(np.array([rates.min(0).values, rates.max(0).values]))

    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 10
    assert float(rows[3]["time [s]"]) == pytest.approx(0.15)
    assert float(rows[3]["omega_p [rpm]"]) == pytest.approx(result.trajectory["state"][episode, 3, 5].item(), rel=1e-8)
    aim = float(rows[3]["reference_alpha_p [rad]"])
    assert rows[3]["u_a [-]"] == "0.25" and aim == pytest.approx([0.2, -0.1][episode])
