"""Windows, their trajectories and sensitivities, the linear model of their errors, and the unit of a hidden state."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from first_order import DT, LIBRARY, TWO, Y0, A, B, column, inputs, motion

from dynasindy.findings import note
from dynasindy.sindy import Refinement, Regression, SindyModel, shooting
from dynasindy.sindy.model import _units_of_guess
from dynasindy.sindy.named_libraries import build_library, polynomial
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import (
    Descent,
    Estimate,
    Flow,
    RunsAway,
    Windows,
    choose_stretches,
    linearise_windows,
    move,
    relative_step,
    shooting_covariance,
    substeps_for,
)
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

INPUTS = inputs(4)


def test_windows_that_run_away_are_counted_and_the_first_is_named():
    # y' = y^2 from 1 is 1 / (1 - t): it passes all bounds after a second, from -1 and from 0.1 it does not.
    data = Transitions.from_trajectory(torch.ones(61, 1).double(), torch.zeros(60, 1).double(), 0.1)
    windows = Windows.of(data, Descent(20))
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 0.0, 1.0), column(0.1, 1.0, -1.0))
    parameters = Parameters.where(torch.tensor([[False], [False], [False], [True]]))
    flow = Flow.of(estimate, parameters, windows)
    assert flow.lost().tolist() == [False, True, False]
    assert flow.predicted[2, -1].item() == pytest.approx(-1 / (1 + 2.0), rel=1e-4)
    with pytest.raises(RunsAway, match="number 1"):
        linearise_windows(flow)


@pytest.mark.parametrize("joined", [True, False])
def test_a_step_of_a_linear_problem_ends_at_its_least_squares_solution(joined):
    # y' = c is linear in all unknowns: the start and c, 0.5 s from sample to sample.
    y = np.random.default_rng(3).normal(size=8)
    data = Transitions.from_trajectory(torch.from_numpy(y).unsqueeze(-1), torch.zeros(7, 1).double(), 0.5)
    parameters = Parameters.where(torch.tensor([[False], [False], [True], [False]]))
    estimate = Estimate(LIBRARY, column(0.0, 0.0, 3.0, 0.0), torch.zeros(1, 1).double())
    flow = Flow.of(estimate, parameters, Windows.of(data, Descent(7, joined)))
    model = linearise_windows(flow, torch.tensor([2.0]).double())
    found = move(flow, model, torch.arange(len(model.scale)))
    start, slope = np.linalg.lstsq(np.stack([np.ones(8), 0.5 * np.arange(8)], -1), y, rcond=None)[0]
    assert found.xi[2, 0].item() == pytest.approx(slope) and found.nodes.item() == pytest.approx(start)
    assert model.cost == pytest.approx(np.square((y - 3.0 * 0.5 * np.arange(8)) / 2.0).sum())


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
    for seed in range(12):
        found = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, pushed(seed, 1000), Descent(20, joined))
        known, model = shooting_covariance(found), linearise_windows(found)
        fits.append(found.estimate.xi[:2, 0])
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
    flow = refine_trajectory(LIBRARY, column(A, B, 0.0, 0.0), TWO, data, Descent(20, joined))
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


@pytest.mark.parametrize("joined", [True, False])
def test_slopes_that_do_not_stay_in_memory_are_computed_part_by_part(joined, monkeypatch):
    y = motion(A, B, Y0, INPUTS)
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(INPUTS)[:, None], DT)
    windows = Windows.of(data, Descent(3, joined))
    estimate = Estimate(LIBRARY, column(A, B, 0.1, 0.0), torch.from_numpy(y[:-1:3])[:, None] + 0.1)
    at_once, parts = (Flow.of(estimate, Parameters.where(TWO), windows) for _ in range(2))
    wanted = linearise_windows(at_once)
    monkeypatch.setattr(shooting, "MOST_SLOPES", 0)
    monkeypatch.setattr(shooting, "CHUNK", 20)
    found = linearise_windows(parts)
    assert "s" not in vars(parts) and not bool(parts.lost().any())
    torch.testing.assert_close(found.moves, wanted.moves, rtol=1e-9, atol=1e-12)
    normal = [model.triangle.mT @ model.triangle for model in (found, wanted)]
    torch.testing.assert_close(*normal, rtol=1e-9, atol=1e-9)


def test_stretches_of_a_long_recording_are_two_windows_long_at_least():
    for wanted, window, stretches in ((30, 10, 1), (10, 10, 1), (40, 10, 2), (60, 10, 3)):
        chosen = choose_stretches(1000, wanted, window)
        begins = int(chosen.int().diff(prepend=torch.zeros(1)).eq(1).sum())
        assert (int(chosen.sum()), begins) == (wanted, stretches)


# y' = a y + 5: the fastest rate is |a|. An error of 1e-7 wants steps of 0.1 / |a|, at most 10; stability 1.5 / |a|.
@pytest.mark.parametrize(
    ("a", "dt", "steps"),
    [(-2, 0.01, 1), (10, 0.01, 1), (-11, 0.01, 2), (-30, 0.01, 3), (-50, 0.1, 10), (-300, 0.1, 20), (-1e5, 0.1, 100)],
)
def test_steps_follow_the_fastest_rate(a, dt, steps):
    x, u = torch.linspace(-1, 1, 9, dtype=torch.float64)[:, None], torch.zeros(9, 1).double()
    assert substeps_for(relative_step(LIBRARY, column(float(a), 0.0, 5.0, 0.0), x, u, dt)) == steps


TANKS = Signature(("upper", "lower"), ("m", "m"), ("u",), (1.0, 1.0))
FILL, OUT, IN, DRAIN = 0.30, 0.20, 0.25, 0.10
"""upper' = FILL u - OUT upper, lower' = IN upper - DRAIN lower [1/s]."""


def table(library, given):
    """Return coefficients `(n_features, n_x)` of equations by state and function."""
    xi = torch.zeros(len(library), library.signature.n_x, dtype=torch.float64)
    for state, terms in given.items():
        for name, size in terms.items():
            xi[library.index(name), library.signature.state_index(state)] = size
    return xi


def levels(u, dt, fine=50):
    """Levels of the two tanks under a held flow, by many small steps of Euler and their midpoint."""
    x, path = np.array([0.4, 0.3]), []
    for held in u:
        path.append(x.copy())
        for _ in range(fine):
            middle = x + 0.5 * dt / fine * np.array([FILL * held - OUT * x[0], IN * x[0] - DRAIN * x[1]])
            slope = np.array([FILL * held - OUT * middle[0], IN * middle[0] - DRAIN * middle[1]])
            x = x + dt / fine * slope
    return np.array([*path, x])


def log(noise, seed=0, samples=300, dt=0.5):
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.uniform(0, 1, samples // 10), 10)
    seen = levels(u, dt) + noise * generator.normal(size=(len(u) + 1, 2))
    seen[:, 0] = np.nan
    return Transitions.from_trajectory(torch.from_numpy(seen), torch.from_numpy(u[:, None]), dt)


PLAIN = ["u", "upper", "lower"]
CHAIN = {"upper": {"u": 1.0}, "lower": {"upper": 1.0}}
BENT = "max(0, upper - 0.5)"


@pytest.mark.parametrize(
    ("words", "given", "fixed", "hidden", "free"),
    [
        (PLAIN, CHAIN, (), (True, False), True),
        (PLAIN, CHAIN, (), (False, False), False),
        # A coefficient that is given holds the unit of what it multiplies, and of what it fills.
        (PLAIN, CHAIN, (("upper", 1),), (True, False), False),
        (PLAIN, CHAIN, (("u", 0),), (True, False), False),
        # One that drains it does not: it is a rate in any unit.
        (PLAIN, {"upper": {"u": 1.0, "upper": -1.0}}, (("upper", 0),), (True, False), True),
        # So do a sine and a bend at a level.
        (["u", "sin(upper)"], {"upper": {"u": 1.0}, "lower": {"sin(upper)": 1.0}}, (), (True, False), False),
        (["u", BENT], {"upper": {"u": 1.0}, "lower": {BENT: 1.0}}, (), (True, False), False),
        # Of a state in no equation there is nothing to say.
        (PLAIN, {"lower": {"u": 1.0}}, (), (True, False), False),
        # Two hidden states, one of which is by a given equation the rate of the other, have one unit together.
        (PLAIN, {"upper": {"lower": 1.0}, "lower": {"u": 1.0}}, (("lower", 0),), (True, True), True),
    ],
)
def test_what_holds_the_unit_of_a_hidden_state(words, given, fixed, hidden, free):
    library = build_library(words, TANKS)
    xi = table(library, given)
    may = torch.ones_like(xi, dtype=torch.bool)
    for name, state in fixed:
        may[library.index(name if name in library.names else words[1]), state] = False
    chosen, unscaled = _units_of_guess(library, xi, may, torch.tensor(hidden))
    assert int(chosen.sum()) == int(free) and not bool(chosen[~may].any())
    assert set(unscaled) == ({n for n, h in zip(TANKS.state_names, hidden, strict=True) if h} if free else set())


def fit(data, unit, fixed=None):
    initial = {"upper": {"u": 0.2 * unit, "upper": -0.1}, "lower": {"upper": 0.3 / unit, "lower": -0.2}}
    allowed = {"upper": ["u", "upper"], "lower": ["upper", "lower"]}
    refinement = Refinement("trajectory", error="simulation", rounds=0)
    known = {"allowed": allowed, "fixed": fixed, "initial": initial}
    model = SindyModel(TANKS, partial(polynomial, degree=1), Regression("bic"), refinement, **known)
    return model, model.fit(data)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_two_tanks_are_found_in_the_unit_of_the_first_guess(unit):
    """The oracle are the coefficients that moved the tanks; of two of them the data tell the product alone."""
    model, report = fit(log(0.01), unit)
    at = {(model.library.names[f], s): k for k, (f, s) in enumerate(zip(*model.covariance[:2], strict=True))}
    at = {(name, int(s)): k for (name, s), k in at.items()}
    size = model.coefficients[model.covariance.features, model.covariance.states]
    share = model.covariance.shares(model.coefficients)
    # Which tank is the faster one the lower level does not tell.
    drains = sorted((at["upper", 0], at["lower", 1]), key=lambda k: float(size[k]))
    for k, real in zip(drains, (-OUT, -DRAIN), strict=True):
        assert abs(float(size[k]) - real) < 4 * float(share[k] * size[k].abs()) < 0.3 * abs(real)
    fill = float(model.coefficients[model.library.index("u"), 0])
    assert fill == 0.2 * unit and fill * float(size[at["upper", 1]]) == pytest.approx(FILL * IN, rel=0.1)
    assert float(share.max()) < 0.1
    assert note("fit.unscaled", states=["upper"]) in report.findings
