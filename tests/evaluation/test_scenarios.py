"""Scenarios with policies whose outcome is known in advance, and their summaries."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from controllers import angle_task
from plants import Plant
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, exploration_type

from dynasindy.envs import ControlEnv, RandomStep, Step, Tracking, TrackingReward, Wave, wave
from dynasindy.evaluation.forecast import Forecast
from dynasindy.evaluation.metrics import CONTROL, STEP, TRACKING, to_text, tracking_metrics
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate, step_references
from dynasindy.evaluation.tracking_criteria import judge_tracking
from dynasindy.findings import weak
from dynasindy.systems import Diverged, Pendulum, Signature, Tras, Xi


def make(plant: type[Tras] | type[Xi] = Xi) -> ControlEnv:
    system = plant()
    task = Tracking(system.signature, RandomStep([-0.4, -0.25], [0.4, 0.25]))
    return ControlEnv(system, task, substeps=1, seed=7)


def constant(u_a: float, u_p: float):
    def policy(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.tensor([u_a, u_p]).expand(*td.batch_size, 2))

    return policy


def test_returns_are_sums_of_the_rewards_and_rows_are_in_order() -> None:
    result = evaluate(make(), constant(0.0, 0.2), Scenario("two", Step([[0.1, 0.2], [0.3, -0.1]]), episodes=2))
    torch.testing.assert_close(result.trajectory["reference"][:, 0], torch.tensor([[0.1, 0.2], [0.3, -0.1]]))
    rewards = result.trajectory["next", "reward"]
    assert result.returns[1].item() == pytest.approx(sum(r.item() for r in rewards[1]), rel=1e-4)
    assert result.trajectory["next", "truncated"][:, -1].all()
    assert not result.trajectory["next", "done"][:, :-1].any()


def test_batched_rows_equal_single_runs() -> None:
    targets = [[0.1, 0.2], [-0.3, 0.1], [0.2, -0.2]]

    def feedback(td: TensorDictBase) -> TensorDictBase:
        error = td["reference"] - td["state"][..., :2]
        return td.set("action", (0.5 * error).clamp(-1, 1))

    batch = evaluate(make(), feedback, Scenario("all", Step(targets), episodes=3, seconds=5.0))
    for k, target in enumerate(targets):
        single = evaluate(make(), feedback, Scenario("one", Step([target]), seconds=5.0))
        torch.testing.assert_close(single.outputs[0], batch.outputs[k], atol=1e-5, rtol=0)


def test_no_exploration_and_no_trace_in_any_generator() -> None:
    seen = set()

    def curious(td: TensorDictBase) -> TensorDictBase:
        seen.add(exploration_type())
        return td.set("action", 0.1 * torch.randn(*td.batch_size, 2))

    env = make()
    before, own = torch.random.get_rng_state(), env.rng.get_state()
    scenario = Scenario("drawn", episodes=3, seconds=0.5)
    first, second = evaluate(env, curious, scenario), evaluate(env, curious, scenario)
    assert seen == {ExplorationType.DETERMINISTIC}
    assert torch.equal(before, torch.random.get_rng_state())
    assert torch.equal(own, env.rng.get_state())
    torch.testing.assert_close(first.trajectory["reference"], second.trajectory["reference"], rtol=0, atol=0)


def test_step_references_are_fixed_and_fill_the_box() -> None:
    targets = step_references([-0.4, -0.25], [0.4, 0.25]).targets
    assert targets.shape == (64, 2)
    assert torch.equal(targets, step_references([-0.4, -0.25], [0.4, 0.25]).targets)
    assert not torch.equal(targets, step_references([-0.4, -0.25], [0.4, 0.25], seed=1).targets)
    # 64 scrambled Sobol points put exactly 16 into each quadrant.
    quadrant = 2 * (targets[:, 0] > 0) + (targets[:, 1] > 0)
    assert quadrant.bincount().tolist() == [16] * 4
    with pytest.raises(ValueError, match="differ in length"):
        step_references([0.0], [0.1, 0.1])


def run_with(windows: list[tuple[float, float]] | None) -> Evaluation:
    scenario = Scenario("swap", Step([[0.0, 0.0]]), seconds=3.0, plant=lambda _: Tras(), windows=windows)
    return evaluate(make(Xi), constant(0.1, 0.3), scenario)


def test_the_disturbed_plant_holds_in_its_windows_only() -> None:
    xi = evaluate(make(Xi), constant(0.1, 0.3), Scenario("xi", Step([[0.0, 0.0]]), seconds=3.0))
    tras = evaluate(make(Tras), constant(0.1, 0.3), Scenario("tras", Step([[0.0, 0.0]]), seconds=3.0))
    torch.testing.assert_close(run_with(None).outputs, tras.outputs)
    torch.testing.assert_close(run_with([]).outputs, xi.outputs)
    swapped = run_with([(1.0, 2.0)])
    assert torch.equal(swapped.trajectory["step_count"][0, :, 0], torch.arange(60))
    torch.testing.assert_close(swapped.outputs[:, :21], xi.outputs[:, :21])
    # Within the window the plant continues from the state it has: one step of tras from there.
    x = swapped.trajectory["state"][:, 20]
    after, _ = make(Tras).advance(x, torch.tensor([[0.1, 0.3]]))
    torch.testing.assert_close(swapped.trajectory["state"][:, 21], after[:, -1])


def test_wrappers_are_applied_in_order() -> None:
    def scaled(factor: float, offset: float):
        def wrap(policy, env):
            def wrapped(td: TensorDictBase) -> TensorDictBase:
                return td.set("action", factor * policy(td)["action"] + offset)

            return wrapped

        return wrap

    scenario = Scenario("wrapped", seconds=0.1, wrappers=[scaled(2.0, 0.0), scaled(1.0, 0.1)])
    result = evaluate(make(), constant(0.1, 0.2), scenario)
    torch.testing.assert_close(result.trajectory["action"][0, 0], torch.tensor([0.3, 0.5]))


def test_a_plant_that_runs_away_is_left_where_its_numbers_would_overflow() -> None:
    """From 0 under u = 1 there is x = e^(5 t) - 1; under u = 0 it stays at 0."""
    plant, reward = Plant("x", lambda x, u: [5 * x + 5 * u], (2.0,)), TrackingReward(error_weights=(1.0,))
    env = ControlEnv(plant, Tracking(plant.signature, Step([[1.0]]), ["x"], [], reward), 0.05, 50, dtype=torch.float64)

    def policy(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.tensor([[1.0], [0.0]]).expand(*td.batch_size, 1))

    flown = evaluate(env, policy, Scenario("boom", Step([[1.0], [2.0]]), episodes=2, seconds=4.0))
    x = flown.trajectory["next", "state"][..., 0]
    # Within 1e4 ranges of 2 m as long as 5 t <= log(20001) = 9.90, that is in 39 periods of 0.05 s.
    assert x[0, :39].tolist() == pytest.approx([math.expm1(0.25 * k) for k in range(1, 40)], rel=1e-6)
    assert x[0, 39:].tolist() == [2e4] * 41
    assert not x[1].any()
    assert flown.lost.tolist() == [True, False]
    assert bool(flown.returns.isfinite().all())


def test_a_simulation_that_breaks_down_by_its_steps_alone_says_so() -> None:
    """A tank fills in 20 ms: a step of 10 ms from empty ends below its bottom."""
    plant = Plant("h", lambda h, u: [10.0 * u - 100.0 * torch.sqrt(h)], (0.01,))
    task = Tracking(plant.signature, Step([[1.0]]), ["h"], [], TrackingReward(error_weights=(1.0,)))
    env, push = ControlEnv(plant, task, 0.05, 5), lambda td: td.set("action", torch.ones(*td.batch_size, 1))
    with pytest.raises(Diverged, match=r"'stiff': .*period 1 .*env\.substeps"):
        evaluate(env, push, Scenario("stiff", Step([[1.0]]), episodes=1, seconds=1.0))


def test_the_first_step_is_the_one_nearest_to_three_quarters_of_the_upper_ends() -> None:
    targets = step_references([-0.4, -0.1], [0.4, 0.25], number=32).targets
    distances = ((targets - torch.tensor([0.3, 0.1875])) ** 2).sum(-1)
    assert torch.equal(distances, distances.sort().values) and len(targets) == 32
    assert bool(((targets >= torch.tensor([-0.4, -0.1])) & (targets <= torch.tensor([0.4, 0.25]))).all())


def test_without_a_length_a_run_is_an_episode_of_the_task() -> None:
    env = make()
    env.task.max_steps = 30
    result = evaluate(env, constant(0.0, 0.2), Scenario("short", Step([[0.1, 0.2]]), seconds=None))
    assert len(result.time) == 30 and result.seconds == pytest.approx(1.5)
    assert result.steady_seconds == pytest.approx(0.375) and result.units == {"alpha_a": "rad", "alpha_p": "rad"}
    gust = Scenario("gust", Step([[0.1, 0.2]]), seconds=None, plant=lambda plant: plant, windows=[(0.5, 1.0)])
    assert evaluate(env, constant(0.0, 0.2), gust).windows == ((0.5, 1.0),)


def test_a_task_without_references_is_run_as_it_draws_its_episodes(settle) -> None:
    plant = Pendulum()
    env = ControlEnv(plant, settle(plant.signature, price=0.5), substeps=1, seed=3)

    def pushed(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.full((*td.batch_size, 1), 0.2))

    result = evaluate(env, pushed, Scenario("task", episodes=5, seconds=2.0))
    x, starts = result.trajectory["next", "state"], result.trajectory["state"][:, 0]
    assert (result.outputs.shape, result.references.shape, result.output_names) == ((5, 40, 0), (5, 40, 0), ())
    assert len(starts.unique(dim=0)) == 5 and bool((starts.abs() <= torch.tensor([0.5, 1.5])).all())
    paid = -x[..., 0].square() - (x[..., 1] / 3.0).square() - 0.5 * 0.2**2
    torch.testing.assert_close(result.returns, paid.sum(-1), rtol=1e-4, atol=0)
    table = to_text(result.summary(), result.title)
    assert "'task' (5 episodes, 2 s)" in table
    assert "control effort" in table and "error" not in table
    with pytest.raises(TypeError, match="scenario=task"):
        evaluate(env, pushed, Scenario("step", Step([[0.1]])))


def test_of_an_angle_that_goes_over_many_turns_errors_are_shares_of_one_turn() -> None:
    """A pendulum that hangs, 3.6 degrees off its targets of twenty turns, is a hundredth of a turn away."""
    system = Pendulum()
    for reach, box in ((20.0, 2 * math.pi), (0.5, 1.0)):
        steps, paid = RandomStep([-reach], [reach]), TrackingReward(error_weights=(1.0,))
        task = Tracking(system.signature, steps, ["theta"], ["Omega"], paid, low=[-reach], high=[reach])
        env = ControlEnv(system, task, substeps=1, seed=7)
        hang = lambda td: td.set("action", torch.zeros(*td.batch_size, 1))  # noqa: E731
        result = evaluate(env, hang, Scenario("hang", Step([[0.02 * math.pi]]), seconds=1.0))
        assert result.boxes == (pytest.approx(box),)
        assert result.errors[0, -1, 0].item() == pytest.approx(0.02 * math.pi / box)
        found = judge_tracking(result, system)
        assert found.turned == (["theta"] if box > 6 else [])
        told = Forecast((found,), result).summary()
        assert ("of a turn" in told) is (box > 6)


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
    halved = replace(found, signature=replace(signature, input_limits=((-1.0, 0.0), (0.0, 1.0))))
    shares = {told.values["input"]: told.values["percent"] for told in halved.restless}
    assert shares == {"u": pytest.approx(5.0), "v": pytest.approx(2.0)}
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
    env = ControlEnv(Pendulum(), angle_task(Step([[0.1]]), low=[-0.3], high=[0.4]), substeps=1)

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
    upright = angle_task(Step([[math.pi]]), low=[math.pi], high=[math.pi])
    assert evaluate(ControlEnv(Pendulum(), upright), still, Scenario("step", seconds=1.0)).beyond_targets == []


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
