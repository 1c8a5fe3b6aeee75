"""Regression and the weak form against all samples, PySINDy, brute force and plants of lines and parabolas."""

import itertools
import math

import numpy as np
import pysindy
import pytest
import torch

from dynasindy.sindy import Regression
from dynasindy.sindy.regression import (
    TriangularFactor,
    _eliminate,
    integral_form,
    least_squares,
    needed_at_edge,
    weak_form,
)
from dynasindy.systems.transitions import Transitions


def problem(n: int = 300, noise: float = 0.05, seed: int = 0):
    """Functions of very different sizes, three of eight active in each of two equations."""
    generator = np.random.default_rng(seed)
    theta = generator.normal(size=(n, 8)) * 10.0 ** np.arange(-3, 5)
    xi = np.zeros((8, 2))
    xi[[0, 3, 6], 0], xi[[1, 3, 7], 1] = [2e3, -1.5, 1e-3], [-300.0, 2.0, 2e-4]
    dx = theta @ xi + noise * generator.normal(size=(n, 2))
    return torch.from_numpy(theta), torch.from_numpy(dx), torch.from_numpy(xi)


def solve(regression: Regression, theta, dx):
    return regression.solve(
        TriangularFactor((theta, dx)), torch.ones(8, 2, dtype=torch.bool), torch.zeros(8, 2).double()
    )


def test_a_triangular_factor_holds_all_that_a_fit_needs():
    theta, dx, xi = problem()
    factor = TriangularFactor((theta, dx), block=70)
    both = torch.cat([theta, dx], -1)
    assert factor.count == 300 and factor.r.shape == (10, 10)
    assert torch.allclose(factor.r.mT @ factor.r, both.mT @ both, rtol=1e-10)
    assert torch.allclose(factor.norms(), both.norm(dim=0), rtol=1e-12)
    assert torch.allclose(factor.residual(xi), (dx - theta @ xi).norm(dim=0), rtol=1e-9)
    size = 10.0 ** torch.arange(-3, 5)
    expected = np.linalg.lstsq((theta / size).numpy(), dx.numpy(), rcond=None)[0]
    assert np.allclose(least_squares(factor.theta() / size, factor.targets()), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_samples_that_are_not_finite_are_refused_and_counted(bad):
    theta, dx, _ = problem()
    theta[3, 1] = theta[7, 2] = dx[7, 1] = bad
    with pytest.raises(ValueError, match="2 of 300"):
        TriangularFactor((theta, dx))


@pytest.mark.filterwarnings("ignore:Sparsity parameter is too big")
@pytest.mark.parametrize("threshold", [0.0, 0.5, 2.0, 10.0, 1e9])
def test_thresholding_equals_pysindy_on_the_same_data(threshold):
    theta, dx, _ = problem(noise=3.0)
    theirs = pysindy.STLSQ(threshold=threshold, alpha=0, normalize_columns=True, unbias=False)
    theirs.fit(theta.numpy(), dx.numpy())
    ours = solve(Regression(threshold=threshold), theta, dx)
    assert np.array_equal(ours.mT != 0, theirs.coef_ != 0)
    assert np.allclose(ours.mT, theirs.coef_, rtol=1e-8)


def criterion(theta, target, chosen, tolerance) -> float:
    """N ln(rss + tolerance^2) + k ln N, from numpy's own least squares."""
    rest = target - theta[:, chosen] @ np.linalg.lstsq(theta[:, chosen], target, rcond=None)[0] if chosen else target
    return len(target) * math.log(float(rest @ rest) + tolerance**2) + len(chosen) * math.log(len(target))


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.3])
def test_elimination_finds_the_best_of_all_256_subsets(noise):
    theta, dx, xi = problem(noise=noise)
    theta, dx = theta / theta.norm(dim=0), dx / dx.norm(dim=0)
    found = _eliminate(theta, dx, torch.ones(8, 2, dtype=torch.bool), 300, 1e-5)
    subsets = [list(s) for n in range(9) for s in itertools.combinations(range(8), n)]
    for i in range(2):
        best = min(subsets, key=lambda s: criterion(theta.numpy(), dx[:, i].numpy(), s, 1e-5))
        assert found[:, i].nonzero().flatten().tolist() == best
        expected = np.linalg.lstsq(theta[:, best].numpy(), dx[:, i].numpy(), rcond=None)[0]
        assert np.allclose(found[best, i], expected, rtol=1e-8)
    assert torch.equal(found != 0, xi != 0)


@pytest.mark.parametrize("method", ["stlsq", "bic"])
def test_given_coefficients_stay_and_silent_functions_get_none(method):
    theta, dx, xi = problem(noise=0.0)
    theta[:, 5] = 0.0
    support, offset = torch.ones(8, 2, dtype=torch.bool), torch.zeros(8, 2, dtype=torch.float64)
    support[3, 0], offset[3, 0] = False, -1.4
    found = Regression(method, threshold=1e-3).solve(TriangularFactor((theta, dx)), support, offset)
    assert found[3, 0] == -1.4 and found[5].tolist() == [0.0, 0.0]
    expected = np.linalg.lstsq(
        theta[:, [0, 1, 2, 4, 6, 7]].numpy(), (dx[:, 0] + 1.4 * theta[:, 3]).numpy(), rcond=None
    )[0]
    if method == "stlsq":
        assert np.allclose(found[[0, 1, 2, 4, 6, 7], 0], expected, rtol=1e-7)
    assert torch.allclose(found[:, 1], xi[:, 1], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("count", [50, 400])
def test_a_term_is_worth_the_logarithm_of_the_number_of_samples(count):
    # Orthonormal columns: without the second term the squared residual grows from s to s + g, and it stays
    # if N ln((s + g) / s) > ln N, that is from g = s (N^(1/N) - 1) on.
    rest = 0.01
    just = rest * (count ** (1 / count) - 1)
    for share, kept in ((1.02, 2), (0.98, 1)):
        g = share * just
        theta = torch.eye(3, dtype=torch.float64)[:, :2]
        target = torch.tensor([[1.0], [g**0.5], [rest**0.5]], dtype=torch.float64)
        found = _eliminate(theta, target, torch.ones(2, 1, dtype=torch.bool), count, 1e-9)
        assert int((found != 0).sum()) == kept and found[0, 0].item() == pytest.approx(1.0)


def test_simpson_s_rule_takes_its_middle_from_the_hermite_interpolant():
    x, u = torch.tensor([[1.0], [2.0]]), torch.tensor([[3.0]])
    data = Transitions.from_trajectory(x, u, 0.8)
    theta, dx = integral_form(lambda x, u: x * x + u, data, lambda x, u: 10 * x)
    middle = 1.5 + 0.8 / 8 * (10 - 20)
    assert theta.item() == pytest.approx(((1 + 3) + 4 * (middle**2 + 3) + (4 + 3)) / 6)
    assert dx.item() == pytest.approx(1 / 0.8)


def test_no_function_goes_where_most_samples_lie_at_the_edge():
    x = torch.tensor([-1.0, 1.0]).double().repeat(50).unsqueeze(-1)  # a plant that rests at two places
    theta, free = torch.cat([torch.ones_like(x), x, 0 * x + 2], -1), torch.ones(3, 1, dtype=torch.bool)
    rows = (theta, 3 * x)
    assert bool(needed_at_edge(rows, x, free, torch.zeros(3, 1).double(), [0, 1, 2]).all())


def missed(theta, target, chosen):
    """Return the sum of squares that a least-squares fit by numpy leaves, and its coefficients."""
    xi = np.linalg.lstsq(theta[:, chosen], target, rcond=None)[0]
    return float(((target - theta[:, chosen] @ xi) ** 2).sum()), xi


def best_at_edge(theta, target, outer, ranks):
    """Drop functions one by one, least missed first, and return the set of least log(error) + prices at the edge."""
    inside, beyond, best, found = ~outer, outer, math.inf, None
    for rank in sorted(set(ranks)):
        chosen = [k for k, own in enumerate(ranks) if own <= rank]
        while chosen:
            _, xi = missed(theta[inside], target[inside], chosen)
            error = np.linalg.norm(target[beyond] - theta[beyond][:, chosen] @ xi) / np.linalg.norm(target[beyond])
            score = math.log(max(error, 1e-8)) + sum(0.1 if ranks[k] <= 1 else 0.2 for k in chosen)
            if score < best:
                best, found = score, list(chosen)
            rest = [[k for k in chosen if k != gone] for gone in chosen]
            chosen = min(rest, key=lambda some: missed(theta[inside], target[inside], some)[0]) if len(rest) > 1 else []
    return found


@pytest.mark.parametrize("seed", range(6))
def test_what_is_needed_at_the_edge_is_what_a_plain_loop_finds(seed):
    """A cubic plant of two states, whose squares and products are offered, too; 60 samples, as noisy as that."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(60, 2)) * [1.0, 3.0] + [0.5, 0.0]
    a, b = x.T
    theta, ranks = np.stack([np.ones(60), a, b, a * a, a * b, a**3], 1), [0, 1, 1, 2, 2, 3]
    noise = 10.0 ** -rng.integers(0, 3)
    dx = np.stack([b - 0.4 * a**3, 1 + 0.3 * a - 0.2 * a * b], 1) + noise * rng.normal(size=(60, 2))
    away = np.abs(x - np.sort(x, 0)[29])
    away = (away / away.max(0)).max(1)
    outer = away > np.quantile(away, 0.75)
    given = np.zeros((6, 2))
    given[1, 0] = 0.5  # known, and no matter of what is sought
    free = np.ones((6, 2), dtype=bool)
    free[1, 0] = False
    found = needed_at_edge(
        (torch.from_numpy(theta), torch.from_numpy(dx + theta @ given)),
        torch.from_numpy(x),
        torch.from_numpy(free),
        torch.from_numpy(given),
        ranks,
    )
    for i in range(2):
        places = np.flatnonzero(free[:, i])
        some = best_at_edge(theta[:, places], dx[:, i], outer, [ranks[k] for k in places])
        assert found[:, i].nonzero().flatten().tolist() == [int(places[k]) for k in some]


DT = 0.1


def chain(n: int, seed: int) -> Transitions:
    """Exact states of p' = v, v' = 2 u - 0.5, z' = 3 v under held inputs; v is a line in each interval."""
    rng = np.random.default_rng(seed)
    u, states = rng.normal(size=n), [rng.normal(size=3)]
    for held in u:
        p, v, z = states[-1]
        rate = 2 * held - 0.5
        moved = v * DT + 0.5 * rate * DT**2
        states.append(np.array([p + moved, v + rate * DT, z + 3 * moved]))
    return Transitions.from_trajectory(torch.from_numpy(np.array(states)), torch.from_numpy(u)[:, None], DT)


def theta(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    return torch.cat([torch.ones_like(x[:, :1]), x, u], -1)


def without(data: Transitions, *columns: int) -> Transitions:
    x, x_next = data.x.clone(), data.x_next.clone()
    x[:, columns] = x_next[:, columns] = torch.nan
    return Transitions(x, data.u, x_next, data.dt, data.segment)


CHAIN = torch.tensor([[0, -0.5, 0], [0, 0, 0], [1, 0, 3], [0, 0, 0], [0, 2, 0]], dtype=torch.float64)


@pytest.mark.parametrize("half", [1, 2, 5, 12])
def test_averaged_rates_are_the_averaged_functions_of_an_exact_plant(half):
    data = chain(40, 0)
    functions, rates = weak_form(theta, data, data, {}, half)
    torch.testing.assert_close(rates, functions @ CHAIN)
    # One row per quarter of half a bump, as far as whole bumps of 2 half - 1 samples reach.
    assert len(rates) == (39 - (2 * half - 1)) // max(1, half // 4) + 1


def test_a_rate_that_was_not_measured_is_the_second_difference_of_its_state():
    data = chain(60, 1)
    # The guess of v serves the functions alone: a wrong one changes the equations of p and z, not that of v.
    guess = Transitions(data.x.clone(), data.u, data.x_next.clone(), DT, data.segment)
    guess.x[:, 1] += 0.7
    guess.x_next[:, 1] += 0.7
    functions, rates = weak_form(theta, without(data, 1), guess, {1: 0}, 6)
    error = rates - functions @ CHAIN
    torch.testing.assert_close(error, torch.tensor([-0.7, 0.0, -2.1]).double().expand_as(error))
    # What was measured is no matter of the guess: a rate that was measured is differentiated once.
    guess.x[:, 0] += torch.randn(60, generator=torch.Generator().manual_seed(0))
    again = weak_form(theta, data, guess, {1: 0}, 6)[1]
    torch.testing.assert_close(again, weak_form(theta, data, data, {}, 6)[1])


def test_no_row_reaches_over_two_segments_and_short_ones_have_short_bumps():
    parts = [chain(30, 5), chain(1, 6), chain(7, 7), chain(2, 8)]
    functions, rates = weak_form(theta, whole := Transitions.cat(parts), whole, {}, 5)
    torch.testing.assert_close(rates, functions @ CHAIN)
    # A row needs two intervals; the bumps are of 9, 5 and 1 samples.
    apart = [weak_form(theta, part, part, {}, half) for part, half in zip(parts[::2] + parts[3:], (5, 3, 1))]
    torch.testing.assert_close(functions, torch.cat([f for f, _ in apart]))
    assert len(rates) == (29 - 9 + 1) + (6 - 5 + 1) + 1
    with pytest.raises(ValueError, match="two transitions"):
        weak_form(theta, parts[1], parts[1], {}, 5)


@pytest.mark.parametrize("half", [3, 8])
def test_the_weights_are_a_power_of_a_parabola_over_two_intervals_each(half):
    """A pulse of the input at one sample is seen with half the weights of the two intervals beside that sample's."""
    n, at = 41, 20
    u = torch.zeros(n, 1, dtype=torch.float64)
    u[at] = 1.0
    data = Transitions.from_trajectory(torch.zeros(n + 1, 3, dtype=torch.float64), u, DT)
    functions, _ = weak_form(theta, data, data, {}, half)
    weights = np.array([(1 - (j / half) ** 2) ** 4 for j in range(1 - half, half)])
    weights /= weights.sum()
    pulse = np.zeros(n - 1)
    pulse[[at - 1, at]] = 0.5
    expected = np.correlate(pulse, weights, "valid")[:: max(1, half // 4)]
    np.testing.assert_allclose(functions[:, -1].numpy(), expected, rtol=1e-12, atol=1e-15)
