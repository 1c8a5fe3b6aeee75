"""States and rates are guessed from measurements by local cubics, exact for cubics, and by a first model."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynasindy.findings import weak
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.library import CONSTANT, Constraints, Library, variable
from dynasindy.sindy.reconstruction import (
    rate_states,
    reconstruct,
    simulate_hidden_states,
)
from dynasindy.systems import Signature
from dynasindy.systems.smoothing import local_cubic
from dynasindy.systems.transitions import Transitions

DT = 0.05
SIGNATURE = Signature(("a", "w", "h"), ("rad", "rad/s", "-"), ("u",), (1.0, 1.0, 1.0))
LIBRARY = Library(SIGNATURE, [CONSTANT, *(variable(n) for n in ("a", "w", "h", "u"))])
NAN = math.nan


def cubic(t: np.ndarray, derivative: int = 0) -> np.ndarray:
    return np.polyval(np.polyder([2.0, -3.0, 0.5, 1.0], derivative), t)


def recording(*columns: np.ndarray, u: np.ndarray | None = None) -> Transitions:
    x = torch.from_numpy(np.stack(columns, -1))
    held = torch.zeros(len(x) - 1, 1).double() if u is None else torch.from_numpy(u)[:, None]
    return Transitions.from_trajectory(x, held, DT)


def lost(n: int) -> np.ndarray:
    return np.full(n, NAN)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize(("n", "length"), [(5, 5), (6, 9), (40, 5), (40, 25), (40, 101)])
def test_a_local_cubic_is_exact_for_cubics_up_to_the_ends(n, length, derivative):
    t = DT * np.arange(n)
    np.testing.assert_allclose(local_cubic(cubic(t), length, DT, derivative), cubic(t, derivative), atol=1e-9)


def test_a_rate_is_the_derivative_of_the_angle_that_was_measured():
    t = DT * np.arange(30)
    data = recording(cubic(t), lost(30), lost(30))
    guess = reconstruct(data, {1: 0})
    np.testing.assert_allclose(guess.x[:, 0], cubic(t[:-1]), atol=1e-9)
    np.testing.assert_allclose(guess.x[:, 1], cubic(t[:-1], 1), atol=1e-8)
    np.testing.assert_allclose(guess.x_next[:, 1], cubic(t[1:], 1), atol=1e-8)
    # What nobody saw and nobody can derive is zero.
    assert not bool(guess.x[:, 2].any()) and not bool(guess.x_next[:, 2].any())
    assert not bool(reconstruct(data, {}).x[:, 1].any())


def test_a_rate_that_was_measured_is_itself_and_lost_samples_are_filled():
    t = DT * np.arange(30)
    line = 2.0 * t - 1
    line[[4, 5, 17]] = NAN
    guess = reconstruct(recording(cubic(t), line, cubic(-t)), {1: 0})
    np.testing.assert_allclose(guess.x[:, 1], 2 * t[:-1] - 1, atol=1e-9)
    np.testing.assert_allclose(guess.x_next[:, 2], cubic(-t[1:]), atol=1e-9)


def test_rates_are_read_off_the_equations_that_are_known():
    def found(**known: str) -> dict[int, int]:
        return rate_states(LIBRARY, Constraints.build(LIBRARY, known, {}, {}))

    assert found(a="w") == {1: 0} and found(a="h", w="a") == {2: 0, 0: 1}
    assert found() == {} and found(a="u") == {} and found(a="1") == {}
    # Twice the state is not its rate, nor is the rate of an equation that has more.
    for fixed, known in (({"a": {"w": 2.0}}, ["w"]), ({"a": {"w": 1.0}}, ["w", "u"])):
        assert rate_states(LIBRARY, Constraints.build(LIBRARY, {}, {"a": known}, fixed)) == {}
    assert rate_states(LIBRARY, Constraints.build(LIBRARY, {}, {"a": ["w"]}, {"a": {"w": 1.0}})) == {1: 0}


def test_a_hidden_state_is_led_by_the_states_that_were_measured():
    # h' = -2 h + 3 a + 4 u with a held: each interval has its closed form; each segment begins at zero.
    rng = np.random.default_rng(1)
    a, u = np.full(25, 1.5), rng.normal(size=24)
    data = Transitions.cat([recording(k * a, 0 * a, lost(25), u=u) for k in (1.0, -2.0)])
    xi = torch.zeros(5, 3).double()
    xi[[3, 1, 4], 2] = torch.tensor([-2.0, 3.0, 4.0]).double()
    guess = reconstruct(data, {})
    found = simulate_hidden_states(LIBRARY, xi, data, guess, {})
    phi, expected = math.exp(-2 * DT), []
    for k in (1.0, -2.0):
        h = 0.0
        for held in u:
            expected.append(h := phi * h + (1 - phi) / 2 * (3 * 1.5 * k + 4 * held))
    np.testing.assert_allclose(found.x_next[:, 2], expected, atol=1e-5)
    np.testing.assert_allclose(found.x[1:24, 2], expected[:23], atol=1e-5)
    assert found.x[[0, 24], 2].tolist() == [0, 0]
    assert torch.equal(found.x[:, :2], guess.x[:, :2]) and torch.equal(found.x_next[:, :2], guess.x_next[:, :2])


def test_what_the_model_says_of_measured_states_does_not_lead():
    # h' = a, a recorded as a line, so h is its integral; the model's own a' = -3 would run elsewhere.
    t = DT * np.arange(40)
    data = recording(t, 0 * t, lost(40))
    xi = torch.zeros(5, 3).double()
    xi[1, 2], xi[0, 0] = 1.0, -3.0
    found = simulate_hidden_states(LIBRARY, xi, data, reconstruct(data, {}), {})
    np.testing.assert_allclose(found.x_next[:, 2], t[1:] ** 2 / 2, atol=1e-9)


PERIOD, N = 0.02, 600
ONE = Signature(("y",), ("-",), ("u",), (1.0,))


def recorded(rate, size, columns, late=0, noise=0.0):
    """Integrate `size` states by scipy under inputs held for ten samples that act `late` samples later."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, N // 10), 10)
    acting = np.concatenate([np.full(late, u[0]), u])[:N]
    x, samples = np.full(size, 0.3), []
    edges = [0, *(np.flatnonzero(np.diff(acting)) + 1), N - 1]
    for k, end in pairwise(edges):
        times = PERIOD * np.arange(end - k + 1)
        found = solve_ivp(lambda t, x: rate(x, acting[k]), times[[0, -1]], x, t_eval=times, rtol=1e-9, atol=1e-12)  # noqa: B023
        samples.append(found.y[:, :-1].T)
        x = found.y[:, -1]
    samples.append(x[None])
    x = np.concatenate(samples)[:, columns]
    x = x + noise * x.std(0) * rng.normal(size=x.shape)
    return Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u[:-1, None]), PERIOD)


def test_a_delay_at_the_end_of_what_was_looked_for_is_said_to_be_one():
    """The inputs act 0.06 s late; 0.04 s at most are looked for."""
    data = recorded(lambda x, u: np.array([3 * u - 2 * x[0]]), 1, [0], late=3)
    model = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=2 * PERIOD))
    report = model.fit(data)
    assert model.delay == pytest.approx(0.04)
    assert weak("fit.longest_delay", seconds=pytest.approx(0.04)) in report.findings
    longer = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=5 * PERIOD))
    assert "fit.longest_delay" not in [each.code for each in longer.fit(data).findings]
    assert longer.delay == pytest.approx(0.06)


@pytest.mark.parametrize("substeps", [1, 2])
def test_without_a_time_a_delay_beyond_two_control_periods_is_found_where_a_regression_tells_it(substeps):
    """The inputs act three samples, 0.06 s, late; a control period has one or two samples."""
    data = replace(recorded(lambda x, u: np.array([3 * u - 2 * x[0]]), 1, [0], late=3), substeps=substeps)
    model = SindyModel(ONE, "polynomial", Regression("bic"), Refinement("auto", longest_delay=None))
    model.fit(data)
    assert model.delay == pytest.approx(0.06)
