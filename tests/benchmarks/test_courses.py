"""Courses and starts that no policy was trained for."""

import math

import pytest
import torch
from benchmarks.courses import Flight, chirp, ramps, rim, stairs

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking


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


def test_a_flight_without_a_course_keeps_the_references_of_its_task():
    flight = Flight(Tracking(Xi().signature, Step([[0.3, 0.2]])))
    params = flight.sample(torch.Size((1,)), torch.Generator())
    assert flight.reference(params, torch.zeros(1, 1))[0].tolist() == pytest.approx([0.3, 0.2])
