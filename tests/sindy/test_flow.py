"""Trajectories of windows and their sensitivities: closed forms, and how many steps an interval is divided into."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from first_order import DT, LIBRARY, TWO, Y0, A, B, column, inputs, motion

from dynasindy.sindy.library import Library, variable
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import EXACT, Estimate, Flow, relative_step, substeps_for
from dynasindy.sindy.windows import Windows
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

INPUTS = inputs(4)


def test_a_flow_is_the_closed_form_and_its_errors_are_those_of_what_was_measured():
    y = motion(A, B, Y0, INPUTS)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(INPUTS)[:, None], DT)
    windows = Windows.of(data, 20)
    nodes = torch.from_numpy(y[:40:20])[:, None]
    flow = Flow.of(Estimate(LIBRARY, column(A, B, 0.0, 0.0), nodes + 0.5), Parameters.where(TWO), windows)
    decay = np.exp(A * DT * np.arange(1, 21))
    expected = y[1:].reshape(2, 20) + 0.5 * decay
    assert np.allclose(flow.predicted[..., 0], expected, atol=1e-9)
    assert np.allclose(flow.s[..., 0, 0], decay, atol=1e-9)
    assert flow.sigma().item() == pytest.approx(0.5 * np.sqrt(np.mean(decay**2)), rel=1e-6)
    # Half of the samples lost: the root mean square of the others.
    data.x_next[::2] = torch.nan
    flow = replace(flow, windows=Windows.of(data, 20))
    assert flow.sigma().item() == pytest.approx(0.5 * np.sqrt(np.mean(decay[1::2] ** 2)), rel=1e-6)
    data.x_next[:] = torch.nan
    assert replace(flow, windows=Windows.of(data, 20)).sigma().item() == EXACT


def test_sensitivities_of_a_window_are_chained_from_those_of_its_intervals():
    # y' = a y + b u: the end of an interval moves by e^(a dt), and that of k of them by e^(k a dt) and sums over u.
    y = motion(A, B, Y0, INPUTS)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(INPUTS)[:, None], DT)
    windows = Windows.of(data, 40)
    estimate = Estimate(LIBRARY, column(A, B, 0.0, 0.0), torch.tensor([[Y0]]).double())
    flow = Flow.of(estimate, Parameters.where(TWO), windows)
    assert np.allclose(flow.steps[..., 0, 0], math.exp(A * DT), atol=1e-9)
    for place, step in ((1, (1e-5, 0.0)), (2, (0.0, 1e-5))):
        up, down = (motion(A + sign * step[0], B + sign * step[1], Y0, INPUTS) for sign in (1, -1))
        assert np.allclose(flow.s[0, :, 0, place], (up - down)[1:] / 2e-5, atol=1e-7)


def test_coefficients_that_are_no_numbers_are_lost_in_all_windows():
    data = Transitions.from_trajectory(torch.zeros(21, 1).double(), torch.zeros(20, 1).double(), DT)
    estimate = Estimate(LIBRARY, column(math.nan, B, 0.0, 0.0), torch.zeros(2, 1).double())
    assert Flow.of(estimate, Parameters.where(TWO), Windows.of(data, 10)).lost().tolist() == [True, True]


# y' = a y + 5: the fastest rate is |a|. An error of 1e-7 wants steps of 0.1 / |a|, at most 10; stability 1.5 / |a|.
@pytest.mark.parametrize(
    ("a", "dt", "steps"),
    [(-2, 0.01, 1), (10, 0.01, 1), (-11, 0.01, 2), (-30, 0.01, 3), (-50, 0.1, 10), (-300, 0.1, 20), (-1e5, 0.1, 100)],
)
def test_steps_follow_the_fastest_rate(a, dt, steps):
    x, u = torch.linspace(-1, 1, 9, dtype=torch.float64)[:, None], torch.zeros(9, 1).double()
    assert substeps_for(relative_step(LIBRARY, column(float(a), 0.0, 5.0, 0.0), x, u, dt)) == steps


def test_a_difference_equation_has_no_motion_within_its_steps_however_fast_it_is():
    u = torch.zeros(1, 1).double()
    assert substeps_for(relative_step(LIBRARY, column(-50.0, 0.0, 0.0, 0.0), column(1.0), u, 0.1)) == 10
    assert relative_step(LIBRARY.with_step(0.1), column(-50.0, 0.0, 0.0, 0.0), column(1.0), u, 0.1) == 0.0


def test_steps_follow_the_rates_where_the_states_are():
    # y' = -y^2 has the rate 2 |y|; an oscillator of 40 rad/s has imaginary ones.
    u = torch.zeros(1, 1).double()
    falls = column(0, 0, 0, -1.0)
    assert [substeps_for(relative_step(LIBRARY, falls, column(y), u, 0.1)) for y in (0.1, 2.0)] == [1, 4]
    two = Signature(("y", "v"), ("-", "-"), ("u",), (1.0, 1.0))
    library = Library(two, [variable("y"), variable("v")])
    xi = torch.tensor([[0.0, -1600.0], [1.0, 0.0]]).double()
    assert substeps_for(relative_step(library, xi, torch.ones(1, 2).double(), u, 0.01)) == 4
    assert substeps_for(relative_step(LIBRARY, falls, column(math.nan), u, 0.1)) == 1
