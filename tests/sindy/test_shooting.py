"""Trajectories of windows and their condensed linear model: closed forms, and one step to least squares."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from benchmarks.textbook_systems import CASES, cramer_rao
from first_order import DT, LIBRARY, SIGNATURE, TWO, Y0, A, B, column, inputs, motion

from dynasindy.data.rollout_data import disturb
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import (
    Descent,
    Estimate,
    Flow,
    RunsAway,
    cost_of,
    left_over,
    linearise_windows,
    move,
    shooting_covariance,
)
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.sindy.windows import Windows
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

INPUTS = inputs(4)


def test_condensing_leaves_the_slopes_of_one_long_trajectory():
    # Windows that join exactly are one trajectory: the moves of the nodes are the slopes of its closed form.
    y = motion(A, B, Y0, INPUTS)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(INPUTS)[:, None], DT)
    windows = Windows.of(data, 10)
    estimate = Estimate(LIBRARY, column(A, B, 0.0, 0.0), torch.from_numpy(y[:40:10])[:, None])
    model = linearise_windows(Flow.of(estimate, Parameters.where(TWO), windows), torch.ones(1).double())
    place, slopes = np.array([Y0, A, B]), []
    for step in 1e-5 * np.eye(3):
        up, down = (motion(p[1], p[2], p[0], INPUTS) for p in (place + step, place - step))
        slopes.append((up - down) / 2e-5)
    slopes = np.array(slopes).T
    assert np.allclose(model.moves[:, 0, :3], slopes[:40:10], atol=1e-6)
    assert np.allclose(model.moves[:, 0, 3], 0.0, atol=1e-6)
    # The triangle holds the start's own error and those of all 40 samples.
    square = (model.triangle[:, :3] * model.scale).numpy()
    assert np.allclose(square.T @ square, slopes.T @ slopes, rtol=1e-4, atol=1e-6)
    assert model.cost < 1e-9


def test_the_cost_counts_samples_starts_and_gaps_each_by_its_weight():
    # y' = 0: every state stays where its window begins.
    x = torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0, 32.0]).double().unsqueeze(-1)
    data = Transitions.from_trajectory(x, torch.zeros(5, 1).double(), 0.1)
    windows = Windows.of(data, 2)
    nodes = torch.tensor([1.5, 5.0, 17.0]).double().unsqueeze(-1)
    none = torch.zeros(4, 1).double()
    parameters = Parameters.where(torch.tensor([[False], [False], [True], [False]]))
    flow = Flow.of(Estimate(LIBRARY, none, nodes), parameters, windows)
    model = linearise_windows(flow, torch.tensor([2.0]).double())
    samples = (2 - 1.5) ** 2 + (4 - 1.5) ** 2 + (8 - 5) ** 2 + (16 - 5) ** 2 + (32 - 17) ** 2
    start = (1 - 1.5) ** 2
    gaps = (1.5 - 5) ** 2 + (5 - 17) ** 2
    assert model.cost == pytest.approx((samples + start + 10 * 2 * gaps) / 2.0**2)
    free = linearise_windows(flow)
    assert free.sigma.item() == pytest.approx((samples / 5) ** 0.5)
    # The first node moves by itself; each other one closes its gap and follows: by the start, 0.2 s of the constant.
    expected = [[1.0, 0.0, 0.0], [1.0, 0.2, -3.5], [1.0, 0.4, -15.5]]
    torch.testing.assert_close(model.moves[:, 0], torch.tensor(expected).double())


def test_a_step_solves_the_linear_problem_of_starts_and_coefficients():
    # y' = c is linear in all unknowns: one undamped step is the least-squares line, whatever the nodes.
    generator = np.random.default_rng(0)
    y = generator.normal(size=8)
    data = Transitions.from_trajectory(torch.from_numpy(y).unsqueeze(-1), torch.zeros(7, 1).double(), 0.5)
    windows = Windows.of(data, 3)
    parameters = Parameters.where(torch.tensor([[False], [False], [True], [False]]))
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 3.0, 0.0), torch.from_numpy(generator.normal(size=(3, 1))))
    flow = Flow.of(estimate, parameters, windows)
    model = linearise_windows(flow, torch.ones(1).double())
    found = move(flow, model, torch.arange(2))
    slope, start = np.polyfit(0.5 * np.arange(8), y, 1)
    assert found.xi.flatten().tolist() == pytest.approx([0, 0, slope, 0], abs=1e-9)
    assert found.nodes.flatten().tolist() == pytest.approx([start + 1.5 * k * slope for k in range(3)], abs=1e-9)
    # Without the constant the best start is the mean, and an infinite damping leaves the start where it is.
    mean = move(flow, model, torch.tensor([0]))
    assert mean.xi[2, 0] == 0 and mean.nodes[0, 0].item() == pytest.approx(y.mean())
    still = move(flow, model, torch.arange(2), damping=1e12)
    assert still.xi[2, 0].item() == pytest.approx(3.0, rel=1e-6)
    assert still.nodes[0, 0].item() == pytest.approx(estimate.nodes[0, 0].item(), abs=1e-6)


def test_windows_that_run_away_are_counted_and_the_first_is_named():
    # y' = y^2 from 1 is 1 / (1 - t): it passes all bounds after a second, from -1 and from 0.1 it does not.
    data = Transitions.from_trajectory(torch.ones(61, 1).double(), torch.zeros(60, 1).double(), 0.1)
    windows = Windows.of(data, 20)
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 0.0, 1.0), column(0.1, 1.0, -1.0))
    parameters = Parameters.where(torch.tensor([[False], [False], [False], [True]]))
    flow = Flow.of(estimate, parameters, windows)
    assert flow.lost().tolist() == [False, True, False]
    assert flow.predicted[2, -1].item() == pytest.approx(-1 / (1 + 2.0), rel=1e-4)
    with pytest.raises(RunsAway, match="windows"):
        linearise_windows(flow)


def test_a_trial_that_runs_away_in_windows_on_their_own_costs_more_than_anything():
    # As above; at a trial, which is given its weights, the descent asks for the cost and turns back.
    data = Transitions.from_trajectory(torch.ones(61, 1).double(), torch.zeros(60, 1).double(), 0.1)
    windows = Windows.of(data, 20, joined=False)
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 0.0, 1.0), column(0.1, 1.0, -1.0))
    parameters = Parameters.where(torch.tensor([[False], [False], [False], [True]]))
    trial = linearise_windows(Flow.of(estimate, parameters, windows), torch.ones(1).double())
    assert not trial.cost < 1e300


def test_a_gap_of_a_hidden_state_is_weighed_by_the_errors_of_the_others():
    # Both states stand still; the second is seen by nobody, so its gaps count as those of the first do.
    two = Signature(("y", "h"), ("-", "-"), ("u",), (1.0, 1.0))
    library = Library(two, [CONSTANT])
    x = torch.stack([torch.tensor([0.0, 1.0, 0.0, 3.0, 0.0]), torch.full((5,), torch.nan)], -1).double()
    windows = Windows.of(Transitions.from_trajectory(x, torch.zeros(4, 1).double(), 0.1), 2)
    nodes = torch.tensor([[0.5, 2.0], [1.5, 6.0]]).double()
    parameters = Parameters.where(torch.ones(1, 2, dtype=torch.bool))
    model = linearise_windows(Flow.of(Estimate(library, torch.zeros(1, 2).double(), nodes), parameters, windows))
    errors = [0.5, -0.5, 1.5, -1.5]
    sigma = math.sqrt(np.square(errors).mean())
    spread = nodes.std(0, correction=0)
    gaps = (1.0 / sigma) ** 2 + (4.0 / (sigma / spread[0] * spread[1])) ** 2
    start = (0.5 / sigma) ** 2
    assert model.cost == pytest.approx(4 + start + 20 * float(gaps))
    # A start that nothing measured depends on stays where it is, within the spread of its state, which is 2.
    square = model.triangle[:, :4] * model.scale
    assert (square.mT @ square)[1].tolist() == pytest.approx([0.0, 0.25, 0.0, 0.0])


def test_windows_that_are_not_joined_have_a_start_each():
    y = np.random.default_rng(1).normal(size=8)
    data = Transitions.from_trajectory(torch.from_numpy(y).unsqueeze(-1), torch.zeros(7, 1).double(), 0.5)
    windows = Windows.of(data, 3, joined=False)
    parameters = Parameters.where(torch.tensor([[False], [False], [True], [False]]))
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 3.0, 0.0), torch.zeros(3, 1).double())
    flow = Flow.of(estimate, parameters, windows)
    model = linearise_windows(flow, torch.ones(1).double())
    found = move(flow, model, torch.arange(1))  # the starts are eliminated
    # Least squares of three lines of one slope, each through the samples of its window, its first one included.
    places = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 3), (1, 4), (1, 5), (1, 6), (2, 6), (2, 7)]
    rows = np.array([[float(w == j) for j in range(3)] + [0.5 * (k - 3 * w)] for w, k in places])
    theirs = np.linalg.lstsq(rows, y[[k for _, k in places]], rcond=None)[0]
    assert found.nodes.flatten().tolist() == pytest.approx(theirs[:3].tolist(), abs=1e-9)
    assert found.xi[2, 0].item() == pytest.approx(theirs[3], abs=1e-9)


def test_a_number_inside_a_function_moves_as_in_least_squares():
    # y' = 2 max(0, u - p) with u > p is linear in p: y = y0 + sum of 2 dt (u - p).
    rng = np.random.default_rng(2)
    u, y = rng.uniform(1.0, 2.0, 12), rng.normal(size=13)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(u)[:, None], 0.5)
    library = Library(SIGNATURE, [of("hinge", "u", frequency=0.4, fitted=True)])
    windows, parameters = Windows.of(data, 5), Parameters.where(torch.zeros(1, 1, dtype=torch.bool))
    estimate = Estimate(library, column(2.0), torch.from_numpy(rng.normal(size=(3, 1))))
    flow = Flow.of(estimate, parameters, windows)
    model = linearise_windows(flow, torch.ones(1).double())
    found = move(flow, model, torch.arange(2))
    time, driven = np.arange(13), np.concatenate([[0], np.cumsum(u)])
    start, number = np.linalg.lstsq(np.stack([np.ones(13), -1.0 * time], -1), y - driven, rcond=None)[0]
    assert 0.4 / 30 < number < 0.4 * 30
    assert found.library.shapes[0].frequency == pytest.approx(number)
    assert found.nodes[:, 0].tolist() == pytest.approx((start + driven - number * time)[[0, 5, 10]].tolist())
    assert found.xi.item() == 2.0 and estimate.library.shapes[0].frequency == 0.4


def test_the_start_of_a_state_that_forgets_it_within_a_sample_stays_near():
    # h follows u and y follows h, both within a sample: of where h began, e^-40 is left in what was measured.
    signature = Signature(("y", "h"), ("-", "-"), ("u",), (1.0, 1.0))
    library = Library(signature, [variable("y"), variable("h"), variable("u")])
    xi = torch.tensor([[-100.0, 0.0], [100.0, -100.0], [0.0, 80.0]], dtype=torch.float64)
    noisy = INPUTS + 0.01 * np.random.default_rng(8).normal(size=40)
    y = torch.from_numpy(np.stack([noisy, np.full(40, math.nan)], -1)).roll(1, 0)
    data = Transitions.from_trajectory(y, torch.from_numpy(INPUTS[:-1, None]), 0.4)
    windows = Windows.of(data, 10, substeps=40)
    estimate = Estimate(library, xi, torch.from_numpy(0.1 * INPUTS[:40:10, None].repeat(2, 1)))
    parameters = Parameters.where(torch.tensor([[False, False], [False, False], [False, True]]))
    flow = Flow.of(estimate, parameters, windows)
    model = linearise_windows(flow)
    moved = move(flow, model, torch.arange(len(model.scale)))
    assert float((moved.nodes - estimate.nodes).abs().max()) < 10
    assert float(moved.xi[2, 1]) == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize("joined", [True, False])
def test_a_coefficient_that_is_likely_to_be_small_counts_as_one_measurement_more(joined):
    # y' = c is linear in all unknowns: starts and c by least squares, with one row that says c = 0, 0.4 on either side.
    y = np.random.default_rng(3).normal(size=8)
    data = Transitions.from_trajectory(torch.from_numpy(y).unsqueeze(-1), torch.zeros(7, 1).double(), 0.5)
    windows = replace(Windows.of(data, 7, joined), likely=column(1.0, 1.0, 0.4, 1.0))
    parameters = Parameters.where(torch.tensor([[False], [False], [True], [False]]))
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 3.0, 0.0), torch.zeros(1, 1).double())
    model = linearise_windows(Flow.of(estimate, parameters, windows), torch.tensor([2.0]).double())
    found = move(Flow.of(estimate, parameters, windows), model, torch.arange(len(model.scale)))
    rows = np.concatenate([np.stack([np.ones(8), 0.5 * np.arange(8)], -1) / 2.0, [[0.0, 1 / 0.4]]])
    start, slope = np.linalg.lstsq(rows, np.append(y / 2.0, 0.0), rcond=None)[0]
    assert found.xi[2, 0].item() == pytest.approx(slope) and found.nodes.item() == pytest.approx(start)
    missed = np.square((y - 3.0 * 0.5 * np.arange(8)) / 2.0).sum()
    assert model.cost == pytest.approx(missed + (3.0 / 0.4) ** 2)
    bare = linearise_windows(Flow.of(estimate, parameters, replace(windows, likely=None)), torch.tensor([2.0]).double())
    assert left_over(model, windows) - left_over(bare, windows) == pytest.approx(0.5 * (3.0 / 0.4) ** 2)


@pytest.mark.parametrize(
    ("joined", "made_white"),
    [
        *((joined, made) for joined in (True, False) for made in ({}, {"lasting": column(0.6)[0]})),
        *((joined, {"likely": column(1.0, 0.5, 1.0, 1.0)}) for joined in (True, False)),
    ],
)
def test_the_cost_of_a_trial_is_that_of_its_linear_model(joined, made_white):
    # Steps are judged by it before there is a linear model.
    y = motion(A, B, Y0, INPUTS) + 0.1 * np.random.default_rng(9).normal(size=41)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(INPUTS)[:, None], DT)
    data.x_next[::3] = torch.nan
    windows = replace(Windows.of(data, 10, joined), **made_white)
    estimate = Estimate(LIBRARY, column(A, 1.0, 0.0, 0.1), windows.first.nan_to_num(0.2))
    flow, sigma = Flow.of(estimate, Parameters.where(TWO), windows), torch.tensor([0.3]).double()
    model = linearise_windows(flow, sigma)
    assert cost_of(flow, sigma) == pytest.approx(model.cost, rel=1e-12) and model.cost > 0.1


def test_standard_errors_are_those_of_cramer_and_rao_and_of_the_scatter_over_seeds():
    """Van der Pol's oscillator with 10 % of white noise: the bound says how small errors can be at all."""
    case, fits, stated, bounds = CASES["van_der_pol"], [], [], []
    library, truth = case.library(), case.truth()
    for seed, clean in enumerate(case.clean(20)):
        found = refine_trajectory(library, truth, truth != 0, disturb(clean, 0.1, 1000 + seed), Descent(20))
        known = shooting_covariance(found.flow)
        fits.append(found.coefficients[known.features, known.states])
        stated.append(known.errors)
        bounds.append(cramer_rao(library, truth, clean, 0.1 * clean.x_next.std(0)))
    told = torch.stack(stated).square().mean(0).sqrt()
    np.testing.assert_allclose(told / torch.stack(bounds).mean(0), 1.0, atol=0.5)
    ratio = told / torch.stack(fits).std(0)
    assert ((ratio > 0.5) & (ratio < 2)).all()


def pushed(seed: int, n: int = 1500, lasts: float = 0.3) -> Transitions:
    """y' = A y + B u + d, where d is random and lasts for some tenths of a second; y has a little noise."""
    rng, y, d, u = np.random.default_rng(seed), [0.0], 0.0, inputs(n // 10)
    part, phi = math.exp(-DT / lasts), math.exp(A * DT)
    for held in u:
        d = part * d + 0.1 * math.sqrt(1 - part**2) * rng.normal()
        y.append(phi * y[-1] + (phi - 1) / A * (B * held + d))
    y = np.array(y) + 0.002 * rng.normal(size=len(y))
    return Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(u)[:, None], DT)


@pytest.mark.parametrize("joined", [True, False])
def test_standard_errors_are_those_of_the_scatter_where_errors_last(joined):
    fits, stated, alone = [], [], []
    for seed in range(20):
        found = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, pushed(seed), Descent(20, joined))
        known, model = shooting_covariance(found.flow), linearise_windows(found.flow)
        fits.append(found.coefficients[:2, 0])
        stated.append(known.errors)
        inverse = torch.linalg.inv(model.triangle[:-1, :-1])
        alone.append((inverse.square().sum(-1).sqrt() / model.scale)[-2:])
    scatter = torch.stack(fits).std(0)
    ratio, textbook = (torch.stack(each).square().mean(0).sqrt() / scatter for each in (stated, alone))
    assert ((ratio > 0.5) & (ratio < 2)).all()
    assert (textbook < 0.5).all()  # which takes every sample for a witness of its own


@pytest.mark.parametrize("joined", [True, False])
def test_a_window_is_left_out_of_standard_errors_as_a_whole(joined):
    """Of twelve windows ten parts, the first two of them of two windows: least squares on closed forms without each.

    Windows that join are one trajectory, whose measured start always counts; each of the others has a start of its own.
    """
    data = pushed(0, 240)
    flow = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, data, Descent(20, joined)).flow
    starts = 1 if joined else 12
    y, u = torch.cat([data.x[:1], data.x_next])[:, 0].numpy(), data.u[:, 0].numpy().reshape(starts, -1)
    place = torch.cat([flow.estimate.nodes[:starts, 0], flow.estimate.xi[:2, 0]]).numpy()

    def predicted(p):
        return np.stack([motion(p[-2], p[-1], p[k], u[k]) for k in range(starts)])

    measured = np.stack([y[k * u.shape[1] : (k + 1) * u.shape[1] + 1] for k in range(starts)])
    slopes = [(predicted(place + by) - predicted(place - by)) / 2e-5 for by in 1e-5 * np.eye(len(place))]
    rows = np.stack([*slopes, measured - predicted(place)], -1)
    always = rows[:1, 0] if joined else np.zeros((1, len(place) + 1))
    windows = np.split(rows[0, 1:], 12) if joined else list(rows)
    parts = np.split(np.arange(12), [2, *range(4, 12)])
    moved = []
    for part in parts:
        left = np.concatenate([always, *(window for k, window in enumerate(windows) if k not in part)])
        moved.append(np.linalg.lstsq(left[:, :-1], left[:, -1], rcond=1e-12)[0][-2:])
    wanted = np.sqrt(0.9 * len(parts) * np.var(moved, 0))
    np.testing.assert_allclose(shooting_covariance(flow).errors, wanted, rtol=0.01)


def test_a_single_window_still_tells_standard_errors():
    found = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, pushed(0, 60), Descent(60))
    assert len(found.flow.windows) == 1 and (shooting_covariance(found.flow).errors > 0).all()


def test_a_fit_that_leaves_no_function_tells_no_standard_errors():
    flow = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, pushed(0, 60), Descent(60)).flow
    none = replace(flow, parameters=flow.parameters.take(torch.tensor([], dtype=torch.long)))
    assert shooting_covariance(none) is None
