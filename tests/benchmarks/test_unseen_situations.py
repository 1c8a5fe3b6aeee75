"""What is asked of policies in situations that they were not trained for."""

import math

import pytest
import torch
from benchmarks import unseen_situations
from benchmarks.unseen_situations import Flight, chirp, ramps, rim, stairs

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking


def still(tensordict):
    return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))


def plant(observe_rate=False):
    return ControlEnv(Xi(), Tracking(Xi().signature, Step([[0.0, 0.0]]), observe_rate=observe_rate), dt=0.25)


def test_holding_flies_every_situation_within_and_beyond_its_box():
    noise = (1e-3,) * 6
    judged = list(unseen_situations.judge_holding(plant(), still, (-0.4, -0.2), (0.4, 0.3), noise, 0))
    flown = {name: result for name, _, result, _ in judged}
    assert list(flown) == ["step", "edges", "beyond", "away", "noise_in_flight", "staircase"]
    assert {name: len(result.references) for name, result in flown.items()} == {
        **dict.fromkeys(("step", "away", "noise_in_flight"), 64), "edges": 16, "beyond": 16, "staircase": 1,
    }  # fmt: skip
    assert flown["step"].references.abs().amax() <= 0.4
    torch.testing.assert_close(flown["edges"].references.amax((0, 1)), torch.tensor([0.4, 0.3]))
    torch.testing.assert_close(flown["beyond"].references.amin((0, 1)), torch.tensor([-0.48, -0.25]))
    assert not flown["step"].trajectory["state"][:, 0].any() and flown["away"].trajectory["state"][:, 0].all()


def test_with_sensors_the_noise_is_what_the_observer_has_to_filter():
    env = plant()
    names = env.system.signature.state_names
    observer = Observer(Xi(), Sensors({name: {} for name in names[:2]}, rates={"alpha_a": "Omega_a"}), env)
    sensing, noise = Sensing(env, observer, torch.Generator().manual_seed(0)), (0.01, 0.03, 9.0, 9.0, 9.0, 9.0)
    flown = {
        name: result.trajectory
        for name, _, result, _ in unseen_situations.judge_holding(
            env, still, (-0.4, -0.2), (0.4, 0.3), noise, 0, sensing
        )
    }
    errors = {name: (t["measurement"] - t["state"]).flatten(0, 1) for name, t in flown.items()}
    torch.testing.assert_close(errors["noise_in_flight"].std(0)[:2], torch.tensor(noise[:2]), rtol=0.05, atol=0)
    assert not errors["away"][:, :2].any() and errors["noise_in_flight"][:, 2:].isnan().all()


def test_each_stair_is_judged_by_its_end():
    *_, (name, _, result, errors) = unseen_situations.judge_following(plant(observe_rate=True), still)
    assert name == "staircase" and errors.shape == (len(unseen_situations.LEVELS), 2)
    steps = round(unseen_situations.STAIR / 0.25)
    ends = result.outputs[0].reshape(len(unseen_situations.LEVELS), steps, 2)[
        :, -round(unseen_situations.HELD / 0.25) :
    ]
    wanted = (torch.tensor(unseen_situations.LEVELS).unsqueeze(1) - ends).abs().mean(1)
    torch.testing.assert_close(errors, wanted)


def at(course, *seconds):
    """The course at single times, `(2, n, n_r)`: values, then rates."""
    return torch.stack(course(torch.tensor(seconds, dtype=torch.float64).unsqueeze(-1)))


def test_ramps_meet_their_targets_in_straight_lines():
    values, rates = at(ramps([0.0, 2.0, 6.0], [[0.0, 1.0], [1.0, 1.0], [-1.0, 3.0]]), 0.0, 1.0, 2.0, 3.0, 6.0)
    assert values.tolist() == [[0.0, 1.0], [0.5, 1.0], [1.0, 1.0], [0.5, 1.5], [-1.0, 3.0]]
    assert rates.tolist() == [[0.5, 0.0], [0.5, 0.0], [-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]]


def test_stairs_hold_one_target_after_the_other_even_where_time_is_rounded():
    values, rates = at(stairs([[0.1, 0.2], [0.3, -0.4]], 5.0), 0.0, 4.95, 5.0 - 1e-9, 5.0, 20.0)
    assert values[:, 0].tolist() == [0.1, 0.1, 0.3, 0.3, 0.3] and values[-1, 1] == -0.4
    assert not rates.any()


def test_the_chirp_sweeps_evenly_and_its_rate_is_its_derivative():
    course = chirp([0.2, 0.1], 0.5, 10.0)
    # The phase 2 pi (f / 2 T) t^2 has made 2.5 turns at the end, a quarter of which at half the time.
    values, rates = at(course, 0.0, 5.0, 10.0)
    torch.testing.assert_close(values[:, 0], 0.2 * torch.tensor([0.0, math.sin(1.25 * math.pi), 0.0]).double())
    assert rates[-1, 0].item() == pytest.approx(-0.2 * 2 * math.pi * 0.5)  # the last frequency, half a turn on
    later, sooner = at(course, 3.0 + 1e-5, 3.0 - 1e-5)[0]
    slope = (later - sooner) / 2e-5
    torch.testing.assert_close(at(course, 3.0)[1, 0], slope, rtol=1e-6, atol=0)


def test_the_rim_is_the_edge_of_the_box_made_larger_about_its_centre():
    targets = torch.tensor(rim([-1.0, 0.0], [3.0, 1.0], 0.2))
    assert len({tuple(row) for row in targets.tolist()}) == 16
    assert targets.amin(0).tolist() == pytest.approx([-1.4, -0.1])  # centre 1 and 0.5, half 2.4 and 0.6
    assert targets.amax(0).tolist() == pytest.approx([3.4, 1.1])
    on_edge = ((targets - torch.tensor([1.0, 0.5])).abs() / torch.tensor([2.4, 0.6])).amax(-1)
    torch.testing.assert_close(on_edge, torch.ones(16))


def test_a_flight_shows_errors_and_rates_of_its_course():
    task = Tracking(Xi().signature, Step([[9.0, 9.0]]), observe_rate=True, error_scale=0.5)
    flight = Flight(task, ramps([0.0, 10.0], [[0.0, 1.0], [1.0, 0.0]])).with_reference(Step([[7.0, 7.0]]))
    x, t = torch.zeros(1, 6), torch.tensor([[2.0]])
    x[0, 0] = 0.1
    params = task.sample(torch.Size((1,)), torch.Generator())
    seen = flight.observation(x, params, t)[0]
    assert seen[6:].tolist() == pytest.approx([(0.2 - 0.1) / 0.5, 0.8 / 0.5, 0.1, -0.1])
    assert flight.reference(params, t)[0].tolist() == pytest.approx([0.2, 0.8])


def test_a_flight_begins_within_its_part_of_the_ranges_and_on_both_sides_of_zero():
    env = ControlEnv(Xi(), Flight(Tracking(Xi().signature, Step([[0.1, 0.1]])), spread=0.5))

    def still(tensordict):
        return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))

    starts = evaluate(env, still, Scenario("away", Step([[0.2, 0.2]]), 200, 0.1)).trajectory["state"][:, 0]
    share = starts / torch.tensor(Xi().signature.x_scale)
    assert share.abs().max() <= 0.5
    assert (share.amin(0) < -0.45).all() and (share.amax(0) > 0.45).all()
