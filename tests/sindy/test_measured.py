"""States are guessed from measurements by local cubics, which are exact for cubics, and by a first model."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.sindy.constraints import Constraints
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.reconstruction import (
    LENGTHS,
    LONGEST_BUMP,
    SHORTEST_BUMP,
    RegressionData,
    best_length,
    has_gaps,
    interpolate_gaps,
    lag_signals,
    local_cubic,
    rate_states,
    reconstruct,
    settle_lag_states,
    simulate_hidden_states,
    start_lag_states,
    with_rate_ranges,
)
from dynasindy.sindy.regression import DEPENDENT, simpson_form
from dynasindy.sindy.weak_form import weak_form
from dynasindy.systems.base import Signature
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


def test_fewer_samples_than_a_cubic_needs_are_taken_as_they_are():
    line = np.array([1.0, 3.0, 5.0, 7.0])
    assert local_cubic(line, 5, 0.5, 1).tolist() == [4.0] * 4
    assert local_cubic(line, 5, 0.5, 0).tolist() == line.tolist()
    assert local_cubic(line[:1], 5, 0.5, 1).tolist() == [0.0] and local_cubic(line[:1], 5, 0.5, 0).tolist() == [1.0]


def test_lost_samples_lie_on_the_line_between_their_neighbours():
    assert interpolate_gaps(np.array([NAN, 1.0, NAN, NAN, 4.0, 8.0, NAN])).tolist() == [1, 1, 2, 3, 4, 8, 8]
    assert interpolate_gaps(lost(3)) is None


def test_the_length_weighs_the_noise_against_the_bend():
    t, noise = DT * np.arange(400), np.random.default_rng(0).normal(size=400)
    slow, fast = np.sin(0.3 * t), np.sin(9 * t)
    assert best_length(slow + 0.1 * noise) == LENGTHS[-1]
    assert best_length(fast + 1e-3 * noise) <= 9 < best_length(fast + 0.3 * noise) <= 35
    # As long as it pays: the error at samples that are left out is hardly above the least.
    errors = {}
    noisy = fast + 0.1 * noise
    for length in (7, 9, 13, 17, 25):
        half, places = length // 2, np.arange(-(length // 2), length // 2 + 1)
        rest = places[places != 0]
        left_out = [noisy[k] - np.polyfit(rest, noisy[k + rest], 3)[-1] for k in range(half, len(noisy) - half)]
        errors[length] = np.square(left_out).mean()
    least = min(errors.values())
    assert best_length(noisy) == max(n for n, e in errors.items() if e <= 1.1 * least)
    assert best_length(noise[:6]) == 5 and best_length(noise[:3]) == 5


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


def store(spread=None):
    """A library of T' = -0.2 (T - b) + u, b' = (T - b) / 4, and its constraints and coefficients."""
    signature = Signature(("T", "b"), ("K", "K"), ("u",), (1.0, 1.0))
    library = Library(signature, [variable("T"), variable("u"), of("ahead", "T", "b")])
    constraints = Constraints.build(library, {}, {"b": ["(T - b)"]} if spread is None else spread, {})
    return library, constraints, torch.tensor([[0.0, 0.0], [1.0, 0.0], [-0.2, 0.25]], dtype=torch.float64)


def test_a_state_follows_if_its_equation_may_have_nothing_else():
    library, constraints, _ = store()
    assert lag_signals(library, constraints) == {"b": "T"}
    assert lag_signals(*store({"b": ["(T - b)", "u"]})[:2]) == {} == lag_signals(*store({"b": ["T"]})[:2])
    assert lag_signals(*store({"T": ["(T - b)"], "b": ["T"]})[:2]) == {}  # T' of itself and of what follows it
    fixed = Constraints.build(library, {}, {"b": []}, {"b": {"(T - b)": 0.25}})
    assert lag_signals(library, fixed) == {"b": "T"}


def test_where_a_state_that_follows_began_is_told_by_the_rates_that_it_acts_on():
    """Both stretches obey the equations exactly, b from 30 K and from -20 K while T is at 80 K and at 10 K."""
    library, _, xi = store()
    a = torch.tensor([[-0.2, 0.2], [0.25, -0.25]], dtype=torch.float64)
    parts = []
    for start in ([80.0, 30.0], [10.0, -20.0]):
        times = 0.02 * torch.arange(401, dtype=torch.float64)
        path = torch.linalg.matrix_exp(times[:, None, None] * a) @ torch.tensor(start, dtype=torch.float64)
        parts.append(Transitions.from_trajectory(path, torch.zeros(400, 1).double(), 0.02))
    true = Transitions.cat(parts)
    rest = settle_lag_states(true, {1: 0})
    assert torch.equal(rest.x[:, 1], true.x[:, 0]) and torch.equal(rest.x_next[:, 1], true.x_next[:, 0])
    assert settle_lag_states(true, {}) is true
    b = true.x.clone(), true.x_next.clone()
    for part, off in zip((slice(0, 400), slice(400, 800)), (50.0, 30.0), strict=True):  # as if it began at rest
        left = off * torch.exp(-0.25 * 0.02 * torch.arange(401).double())
        b[0][part, 1] += left[:-1]
        b[1][part, 1] += left[1:]
    found = start_lag_states(library, xi, replace(true, x=b[0], x_next=b[1]), {1: 0})
    np.testing.assert_allclose(found.x, true.x, atol=1e-2)
    np.testing.assert_allclose(found.x_next, true.x_next, atol=1e-2)


def test_functions_of_angles_have_a_prior_where_there_is_noise():
    data = recording(cubic(np.arange(40.0)))
    library = Library(Signature(("a",), ("rad",), ("u",), (1.0,)), [of("sin", "a"), variable("u")])
    assert RegressionData.of(data, data, {}).shares(library) is None
    told = RegressionData.of(data, data, {}, noisy=True).shares(library)
    assert told is not None and told.isfinite().tolist() == [True, False]


def test_segments_are_guessed_apart():
    t = DT * np.arange(20)
    parts = [recording(cubic(t), lost(20), t), recording(100 - 7 * t, lost(20), t)]
    guess = reconstruct(Transitions.cat(parts), {1: 0})
    np.testing.assert_allclose(guess.x[:19, 1], cubic(t[:-1], 1), atol=1e-7)
    np.testing.assert_allclose(guess.x[19:, 1], -7.0, atol=1e-7)


def test_what_was_measured_throughout_stays_as_it_is():
    data = recording(*np.random.default_rng(0).normal(size=(3, 12)))
    assert torch.equal(reconstruct(data, {1: 0}).x, data.x) and not bool(has_gaps(data))
    data.x_next[-1, 0] = NAN
    assert bool(has_gaps(data)) and not bool(reconstruct(data, {1: 0}).x_next.isnan().any())


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


def test_a_hidden_state_of_a_difference_equation_is_led_by_where_each_step_begins():
    """h[k+1] = -0.6 h[k] + 0.3 a[k] + 0.4 u[k], which no differential equation follows."""
    rng = np.random.default_rng(1)
    a, u = rng.normal(size=25), rng.normal(size=24)
    data, guess = recording(a, 0 * a, lost(25), u=u), recording(a, 0 * a, 0 * a, u=u)
    xi = torch.zeros(5, 3).double()
    xi[[3, 1, 4], 2] = torch.tensor([-1.6, 0.3, 0.4], dtype=torch.float64) / DT
    found = simulate_hidden_states(LIBRARY.with_step(DT), xi, data, guess, {})
    h, expected = 0.0, []
    for begin, held in zip(a[:-1], u, strict=True):
        expected.append(h := -0.6 * h + 0.3 * begin + 0.4 * held)
    np.testing.assert_allclose(found.x_next[:, 2], expected, atol=1e-12)


def test_what_the_model_says_of_measured_states_does_not_lead():
    # h' = a, a recorded as a line, so h is its integral; the model's own a' = -3 would run elsewhere.
    t = DT * np.arange(40)
    data = recording(t, 0 * t, lost(40))
    xi = torch.zeros(5, 3).double()
    xi[1, 2], xi[0, 0] = 1.0, -3.0
    found = simulate_hidden_states(LIBRARY, xi, data, reconstruct(data, {}), {})
    np.testing.assert_allclose(found.x_next[:, 2], t[1:] ** 2 / 2, atol=1e-9)


def test_the_rate_of_a_measured_angle_stays_as_it_was_differentiated():
    # A first model that is wrong of the rate, w' = -9, must not undo what the angle tells; h' = w is led by the rate.
    t = DT * np.arange(40)
    data, xi = recording(cubic(t), lost(40), lost(40)), torch.zeros(5, 3).double()
    xi[0, 1], xi[2, 2] = -9.0, 1.0
    found = simulate_hidden_states(LIBRARY, xi, data, reconstruct(data, {1: 0}), {1: 0})
    np.testing.assert_allclose(found.x[:, 1], cubic(t[:-1], 1), atol=1e-8)
    np.testing.assert_allclose(found.x_next[:, 1], cubic(t[1:], 1), atol=1e-8)
    expected = np.cumsum(DT / 2 * (cubic(t[:-1], 1) + cubic(t[1:], 1)))  # the rate moves evenly between samples
    np.testing.assert_allclose(found.x_next[:, 2], expected, atol=1e-7)
    # The rate of a state that was not measured either is seen in no form.
    blind = recording(lost(40), lost(40), t)
    assert bool(simulate_hidden_states(LIBRARY, xi, blind, reconstruct(blind, {1: 0}), {1: 0}).x_next[:, 1].all())


def test_without_a_hidden_state_there_is_nothing_to_imagine_and_a_model_that_runs_away_is_not_followed():
    t = DT * np.arange(10)
    data = recording(t, lost(10), t)
    data.x_next[3, 1] = 1.0
    guess = reconstruct(data, {})
    assert simulate_hidden_states(LIBRARY, torch.zeros(5, 3).double(), data, guess, {}) is guess
    unseen = recording(t, t, lost(10))
    said_nothing = simulate_hidden_states(LIBRARY, torch.zeros(5, 3).double(), unseen, reconstruct(unseen, {}), {})
    assert not bool(said_nothing.x_next[:, 2].any()), "a first model that says nothing of a hidden state leaves it"
    hidden = recording(1e120 + t, t, lost(10))
    mad = Library(SIGNATURE, [variable("a", 3)])
    xi = torch.tensor([[0.0, 0.0, 1.0]]).double()
    assert not bool(simulate_hidden_states(mad, xi, hidden, reconstruct(hidden, {}), {}).x_next[:, 2].any())


def test_rows_are_those_of_the_weak_form_only_where_a_state_was_not_measured():
    t = DT * np.arange(60)
    data = recording(cubic(t), cubic(t, 1), np.sin(t))
    xi = torch.zeros(5, 3).double()

    def field(x, u):
        return LIBRARY(x, u) @ xi

    seen = RegressionData.of(data, data, {1: 0})
    assert (seen.half, seen.dependent) == (0, DEPENDENT)
    torch.testing.assert_close(seen.rows(LIBRARY, field), simpson_form(LIBRARY, field, data))
    gaps = recording(cubic(t), lost(60), np.sin(t))
    guess = reconstruct(gaps, {1: 0})
    seen = RegressionData.of(guess, gaps, {1: 0})
    assert SHORTEST_BUMP <= seen.half <= LONGEST_BUMP and seen.dependent > DEPENDENT
    torch.testing.assert_close(seen.rows(LIBRARY, field), weak_form(LIBRARY, gaps, guess, {1: 0}, seen.half))


@pytest.mark.parametrize(("rate", "noise", "half"), [(15.0, 1e-6, SHORTEST_BUMP), (0.01, 0.1, LONGEST_BUMP)])
def test_the_bump_is_longer_for_noise_and_within_bounds(rate, noise, half):
    t = DT * np.arange(400)
    a = np.sin(rate * t) + noise * np.random.default_rng(0).normal(size=400)
    data = recording(a, lost(400), a)
    assert RegressionData.of(reconstruct(data, {1: 0}), data, {1: 0}).half == half


def test_a_hidden_state_that_follows_fast_is_imagined_in_as_many_steps_as_it_needs():
    # h' = y - h under y = 1 approaches 1 by e^-4 in a sample of 4 s; one Runge-Kutta step would multiply by 5.
    signature = Signature(("y", "h"), ("V", "V"), ("u",), (1.0, 1.0))
    library = Library(signature, [variable("y"), variable("h")])
    seen = torch.tensor([[1.0, math.nan]] * 6).double()
    data = Transitions.from_trajectory(seen, torch.zeros(5, 1).double(), 4.0)
    guess = reconstruct(data, {})
    found = simulate_hidden_states(library, torch.tensor([[0.0, 1.0], [0.0, -1.0]]).double(), data, guess, {})
    assert found.x_next[:, 1].tolist() == pytest.approx([1 - math.exp(-4 * k) for k in range(1, 6)], abs=1e-3)


def test_a_rate_without_a_sensor_has_the_range_in_which_its_state_moved():
    """Of a = 3 sin 2t the rate is 6 cos 2t."""
    t = DT * np.arange(400)
    data = recording(3 * np.sin(2 * t), lost(400), lost(400))
    found = with_rate_ranges(SIGNATURE, data, {"a": "w"})
    assert found.x_scale == (1.0, pytest.approx(6.0, rel=0.01), 1.0)
    assert with_rate_ranges(SIGNATURE, data, {"a": "2 w", "h": "u"}).x_scale == SIGNATURE.x_scale
    seen = recording(3 * np.sin(2 * t), 6 * np.cos(2 * t), lost(400))
    assert with_rate_ranges(SIGNATURE, seen, {"a": "w"}).x_scale == SIGNATURE.x_scale
