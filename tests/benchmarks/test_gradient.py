"""Planning by gradient on both plants: rows of the command, its sensors, and the situations nothing was tuned on."""

import math

import pytest
import torch
from benchmark import parse
from benchmarks import gradient, unseen_situations
from benchmarks.unseen_situations import HELD, LEVELS, STAIR, Flight, chirp, ramps, rim, stairs

from dynasindy.envs import ControlEnv
from dynasindy.safe_io import read_rows
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking

TINY = {"updates": 2, "more_updates": 1, "rollouts": 4, "window": 5}


def test_every_phase_has_a_row_that_counts_all_seconds_and_is_not_measured_again(tmp_path, monkeypatch):
    build, calls = gradient.build_recipe, []
    monkeypatch.setattr(gradient, "build_recipe", lambda *of: calls.append(of[2]) or build(*of[:3], TINY))
    options = ["--cases", "step", "--plants", "xi", "--out", str(tmp_path / "gradient.csv"), "--seeds", "0"]
    for _ in range(2):
        gradient.main(parse("gradient", options))
    rows = read_rows(tmp_path / "gradient.csv")
    assert tuple(rows[0]) == gradient.COLUMNS and calls == [0]
    assert [(row["plant_seconds"], row["updates"]) for row in rows] == [("10.0", "2"), ("30.0", "3")]
    # After a few updates the plant is still on its way, and no farther from a target than the range of targets is wide.
    assert all(0 < float(row["azimuth"]) < float(row["azimuth_worst"]) < 1.0 for row in rows)
    assert float(rows[1]["azimuth"]) < float(rows[0]["azimuth"])
    assert 0 < float(rows[0]["cpu_seconds"]) < float(rows[1]["cpu_seconds"])


def test_noise_is_in_the_data_of_the_cases_with_noise_only():
    for name, std in (("noise", gradient.NOISE), ("step", (0.0,) * 6)):
        parts = gradient.build_recipe(gradient.CASES[name], "xi", 0, TINY).build()
        calm, seen = (env.rollout(50, parts.excitation) for env in (parts.plant, parts.env))
        spread = (seen["next", "samples"] - calm["next", "samples"]).std((0, 1))
        torch.testing.assert_close(spread, torch.tensor(std, dtype=spread.dtype), rtol=0.3, atol=0)


def test_the_bench_sees_no_rates_and_its_delay_is_in_the_data():
    for name in ("bench", "bench_delay"):
        parts = gradient.build_recipe(gradient.CASES[name], "xi", 0, TINY).build()
        seen = parts.env.rollout(3, parts.excitation)
        assert seen["next", "samples"].isnan().all(0).all(0).tolist() == [False, False, True, True, False, False]
        u = seen["action"][0] if name == "bench" else torch.zeros(2)
        first = parts.plant.advance(torch.zeros(6).double(), u.double())[0][-1]
        assert torch.equal(seen["next", "true_state"][0], first)


def still(tensordict):
    return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))


def plant(observe_rate=False):
    return ControlEnv(Xi(), Tracking(Xi().signature, Step([[0.0, 0.0]]), observe_rate=observe_rate), dt=0.25)


def test_holding_flies_every_situation_within_and_beyond_its_box():
    """With sensors, the noise in flight is what the observer has to filter."""
    env, noise = plant(), (0.01, 0.03, 9.0, 9.0, 9.0, 9.0)
    observer = Observer(Xi(), Sensors({name: {} for name in ("alpha_a", "alpha_p")}, rates={"alpha_a": "Omega_a"}), env)
    sensing = Sensing(env, observer, torch.Generator().manual_seed(0))
    judged = unseen_situations.judge_holding(env, still, (-0.4, -0.2), (0.4, 0.3), noise, 0, sensing)
    flown = {name: result for name, _, result, _ in judged}
    assert {name: len(result.references) for name, result in flown.items()} == {
        **dict.fromkeys(("step", "away", "noise_in_flight"), 64), "edges": 16, "beyond": 16, "staircase": 1,
    }  # fmt: skip
    assert flown["step"].references.abs().amax() <= 0.4
    torch.testing.assert_close(flown["edges"].references.amax((0, 1)), torch.tensor([0.4, 0.3]))
    torch.testing.assert_close(flown["beyond"].references.amin((0, 1)), torch.tensor([-0.48, -0.25]))
    starts = flown["away"].trajectory["state"][:, 0] / torch.tensor(Xi().signature.x_scale)
    assert not flown["step"].trajectory["state"][:, 0].any() and 0.45 < starts.abs().max() <= 0.5
    errors = {
        name: (result.trajectory["measurement"] - result.trajectory["state"]).flatten(0, 1)
        for name, result in flown.items()
    }
    torch.testing.assert_close(errors["noise_in_flight"].std(0)[:2], torch.tensor(noise[:2]), rtol=0.05, atol=0)
    assert not errors["away"][:, :2].any() and errors["noise_in_flight"][:, 2:].isnan().all()


def test_each_stair_is_judged_by_its_end():
    *_, (name, _, result, errors) = unseen_situations.judge_following(plant(observe_rate=True), still)
    ends = result.outputs[0].reshape(len(LEVELS), round(STAIR / 0.25), 2)[:, -round(HELD / 0.25) :]
    assert name == "staircase"
    torch.testing.assert_close(errors, (torch.tensor(LEVELS).unsqueeze(1) - ends).abs().mean(1))


def at(course, *seconds):
    """The course at single times, `(2, n, n_r)`: values, then rates."""
    return torch.stack(course(torch.tensor(seconds, dtype=torch.float64).unsqueeze(-1)))


def test_courses_go_where_they_say():
    values, rates = at(ramps([0.0, 2.0, 6.0], [[0.0, 1.0], [1.0, 1.0], [-1.0, 3.0]]), 0.0, 1.0, 2.0, 3.0, 6.0)
    assert values.tolist() == [[0.0, 1.0], [0.5, 1.0], [1.0, 1.0], [0.5, 1.5], [-1.0, 3.0]]
    assert rates.tolist() == [[0.5, 0.0], [0.5, 0.0], [-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]]
    values, rates = at(stairs([[0.1, 0.2], [0.3, -0.4]], 5.0), 0.0, 4.95, 5.0 - 1e-9, 5.0, 20.0)
    assert values[:, 0].tolist() == [0.1, 0.1, 0.3, 0.3, 0.3] and values[-1, 1] == -0.4 and not rates.any()
    course = chirp([0.2, 0.1], 0.5, 10.0)
    # The phase 2 pi (f / 2 T) t^2 has made 2.5 turns at the end, a quarter of which at half the time.
    values, rates = at(course, 0.0, 5.0, 10.0)
    torch.testing.assert_close(values[:, 0], 0.2 * torch.tensor([0.0, math.sin(1.25 * math.pi), 0.0]).double())
    assert rates[-1, 0].item() == pytest.approx(-0.2 * 2 * math.pi * 0.5)  # the last frequency, half a turn on
    later, sooner = at(course, 3.0 + 1e-5, 3.0 - 1e-5)[0]
    torch.testing.assert_close(at(course, 3.0)[1, 0], (later - sooner) / 2e-5, rtol=1e-6, atol=0)
    targets = torch.tensor(rim([-1.0, 0.0], [3.0, 1.0], 0.2))
    on_edge = ((targets - torch.tensor([1.0, 0.5])).abs() / torch.tensor([2.4, 0.6])).amax(-1)
    torch.testing.assert_close(on_edge, torch.ones(16))  # centre 1 and 0.5, half 2.4 and 0.6
    assert len({tuple(row) for row in targets.tolist()}) == 16


def test_a_flight_shows_errors_and_rates_of_its_course():
    task = Tracking(Xi().signature, Step([[9.0, 9.0]]), observe_rate=True, error_scale=0.5)
    flight = Flight(task, ramps([0.0, 10.0], [[0.0, 1.0], [1.0, 0.0]])).with_reference(Step([[7.0, 7.0]]))
    x, t = torch.zeros(1, 6), torch.tensor([[2.0]])
    x[0, 0] = 0.1
    params = task.sample(torch.Size((1,)), torch.Generator())
    seen = flight.observation(x, params, t)[0]
    assert seen[6:].tolist() == pytest.approx([(0.2 - 0.1) / 0.5, 0.8 / 0.5, 0.1, -0.1])
    assert flight.reference(params, t)[0].tolist() == pytest.approx([0.2, 0.8])
