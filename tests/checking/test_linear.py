"""Loops rest where they should, and their eigenvalues are those on paper."""

import numpy as np
import pytest
import torch
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

from dynasindy.checking.linear_loop import Linear, covariance_at, find_rest, guess_rest, linearise, loop_margins

A = np.array([[1.0, 0.1], [0.0, 1.0]])
B = np.array([[0.005], [0.1]])


def targets(*values):
    return torch.tensor([[value] for value in values], dtype=torch.float64)


def test_the_eigenvalues_are_those_of_the_polynomial_on_paper(loops):
    # z^2 - tr z + det of A - B k, k = (2, 2.5): tr = 2 - 0.01 - 0.25, det = 1 - 0.01 - 0.25 + 0.1 * 2 * 0.1.
    linear = find_rest(loops(), targets(0.0, 0.7)).linear
    expected = np.roots([1, -(2 - 0.01 - 0.25), 1 - 0.01 - 0.25 + 0.02])
    for k in range(2):
        np.testing.assert_allclose(np.sort_complex(linear.eigenvalues[k]), np.sort_complex(expected), atol=1e-8)
    np.testing.assert_allclose(linear.radius, np.abs(expected).max(), atol=1e-8)
    np.testing.assert_allclose(linear.b[0], B, atol=1e-9)
    np.testing.assert_allclose(linear.e[0], -B @ [[2.0, 2.5]], atol=1e-8)
    np.testing.assert_allclose(linear.c[0], [[-2.0, -2.5]], atol=1e-8)
    np.testing.assert_allclose(linear.f[0], [[-2.0, -2.5]], atol=1e-8)


def test_a_law_that_pushes_the_wrong_way_is_not_stable(loops, law):
    assert find_rest(loops(law(-0.5, 1.0)), targets(0.2)).linear.radius > 1.01


def test_a_loop_with_an_observer_has_the_eigenvalues_of_law_and_filter(loops):
    # The separation principle, with the filter of scipy: x+ = A x + B u, gain L of its steady covariance.
    loop = loops(observer={})
    found = find_rest(loop, targets(0.3))
    noise = np.diag([(0.01 * 2) ** 2, (0.05 * 3) ** 2]) * 0.1
    prior = solve_discrete_are(A.T, np.array([[1.0], [0.0]]), noise, [[1e-4]])
    gain = prior[:, :1] / (prior[0, 0] + 1e-4)
    expected = [np.linalg.eigvals(A - B @ [[2.0, 2.5]]), np.linalg.eigvals(A - gain @ np.array([[1.0, 0.0]]) @ A)]
    expected = np.sort_complex(np.concatenate(expected))
    values = found.linear.eigenvalues[0]
    np.testing.assert_allclose(np.sort_complex(values[np.abs(values) > 1e-3]), expected, atol=1e-6)
    posterior = prior - gain * prior[:1]
    np.testing.assert_allclose(covariance_at(loop, found.z)[0], posterior, rtol=1e-5)


@pytest.mark.parametrize("k_v", [2.5, 9.0, 20.15, 20.25])
def test_a_difference_equation_is_stable_inside_the_unit_circle_and_has_the_margins_of_its_map(loops, carts, law, k_v):
    """p += 0.1 v, v += 0.1 u under u = g (2 (r - p) - k v): z^2 - (2 - 0.1 g k) z + 1 - 0.1 g k + 0.02 g.

    By Jury's criterion it is stable where 4 - 0.2 g k + 0.02 g > 0: until g = 4 / (0.2 k - 0.02), and k = 20.1.
    """
    linear = find_rest(loops(law(2.0, k_v), carts(step=0.1)), targets(0.0)).linear
    expected = np.roots([1, -(2 - 0.1 * k_v), 1 - 0.1 * k_v + 0.02])
    np.testing.assert_allclose(np.sort_complex(linear.eigenvalues[0]), np.sort_complex(expected), atol=1e-7)
    assert (linear.radius[0] < 1) == (k_v < 20.1)
    if k_v < 20.1:
        assert loop_margins(linear.row(0))[0].gain == pytest.approx(4 / (0.2 * k_v - 0.02), rel=1e-6)


def test_a_late_input_is_another_state(loops, carts):
    # Fractional delays sample as A x + B1 u_old + B0 u_now, the textbook's form.
    loop = loops(model=carts(delay=0.13))
    linear = find_rest(loop, targets(0.0)).linear
    late = 0.03
    flow = cont2discrete((np.array([[0.0, 1.0], [0, 0]]), np.array([[0.0], [1.0]]), np.eye(2), 0), 0.1 - late)[:2]
    old = np.array([[1, 0.1 - late], [0, 1]]) @ np.array([[late**2 / 2], [late]])
    k = np.array([[-2.0, -2.5]])
    whole = np.block([[A, old, flow[1]], [np.zeros((1, 2)), np.zeros((1, 1)), np.ones((1, 1))], [k, np.zeros((1, 2))]])
    np.testing.assert_allclose(linear.a[0], whole, atol=1e-8)


def test_a_spring_pulls_a_law_off_its_target_and_an_integral_brings_it_back(loops, carts):
    # k (r - p) = s p, so p = 2 / 3 r with s = 1.
    pulled = find_rest(loops(model=carts(spring=1.0)), targets(0.3))
    assert bool(pulled.still.all())
    np.testing.assert_allclose(pulled.z[0], [0.2, 0.0], atol=1e-7)
    np.testing.assert_allclose(pulled.u[0], [0.2], atol=1e-7)
    # The integral J has p = r where k J = s r.
    held = find_rest(loops(model=carts(spring=1.0), integral={"band": 0.5, "limit": 0.4}), targets(0.3))
    np.testing.assert_allclose(held.z[0], [0.3, 0.0, 0.15], atol=1e-6)


def test_a_plant_with_other_coefficients_rests_elsewhere(loops, carts):
    loop = loops(model=carts(spring=1.0))
    start = find_rest(loop, targets(0.3, 0.3))
    xi = loop.plant.model.coefficients.repeat(2, 1, 1)
    xi[1, 2, 1] = -2.0
    found = find_rest(loop.varied(xi), targets(0.3, 0.3), start)
    np.testing.assert_allclose(found.z[:, 0], [0.2, 0.15], atol=1e-7)


def test_a_loop_that_nothing_stops_has_no_rest(loops, law):
    assert not bool(find_rest(loops(law(0.0, 0.0, bias=0.5)), targets(0.3), seconds=1.0).still.any())


@pytest.mark.parametrize(("seconds", "first", "last"), [(10.0, 81, 100), (3.2, 25, 32), (0.4, 4, 4)])
def test_the_error_of_a_loop_without_rest_is_that_of_its_last_two_seconds_or_quarter(loops, law, seconds, first, last):
    # p = 0.5 t^2 / 2 from its target on, with control periods of 0.1 s.
    found = find_rest(loops(law(0.0, 0.0, bias=0.5)), targets(0.3), seconds=seconds)
    expected = np.mean([0.25 * (0.1 * k) ** 2 for k in range(first, last + 1)])
    assert found.error.item() == pytest.approx(expected, rel=1e-6)


def test_slopes_that_are_not_finite_count_as_none():
    odd = np.array([[[np.inf, -np.inf], [np.nan, 2.0]]])
    found = Linear(odd, odd, odd, odd, odd, 0.1).finite()
    for matrix in (found.a, found.b, found.c, found.e, found.f):
        assert matrix.tolist() == [[[0.0, 0.0], [0.0, 2.0]]]


def test_the_guess_is_where_the_model_rests(loops, carts):
    z = guess_rest(loops(model=carts(spring=1.0, delay=0.1)), targets(0.3, -0.2))
    np.testing.assert_allclose(z, [[0.3, 0.0, 0.3], [-0.2, 0.0, -0.2]], atol=1e-8)


def test_what_a_loop_moves_is_told(loops, carts):
    loop = loops(model=carts(spring=1.0))
    z = torch.tensor([[0.3, 0.0]], dtype=torch.float64)
    _, moved, u = linearise(loop, z, loop.uncertain(z), targets(0.5))
    assert u.item() == pytest.approx(0.4) and moved[0, 1].item() == pytest.approx(0.01, rel=0.01)
