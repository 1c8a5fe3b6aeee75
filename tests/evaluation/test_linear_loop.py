"""Loops rest where they should, and their eigenvalues are those on paper."""

import math

import numpy as np
import pytest
import torch
from carts import Law, make_cart, make_loop
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

from dynasindy.control import Controller
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Step, Tracking, TrackingReward
from dynasindy.evaluation.check import Settings, check, check_verdict
from dynasindy.evaluation.closed_loop import ClosedLoop
from dynasindy.evaluation.linear_loop import (
    Linear,
    find_rest,
    loop_margins,
    open_loop_response,
    sensitivity,
)
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature

A = np.array([[1.0, 0.1], [0.0, 1.0]])
B = np.array([[0.005], [0.1]])


def targets(*values):
    return torch.tensor([[value] for value in values], dtype=torch.float64)


def test_the_eigenvalues_are_those_of_the_polynomial_on_paper():
    # z^2 - tr z + det of A - B k, k = (2, 2.5): tr = 2 - 0.01 - 0.25, det = 1 - 0.01 - 0.25 + 0.1 * 2 * 0.1.
    linear = find_rest(make_loop(), targets(0.0, 0.7)).linear
    expected = np.roots([1, -(2 - 0.01 - 0.25), 1 - 0.01 - 0.25 + 0.02])
    for k in range(2):
        np.testing.assert_allclose(np.sort_complex(linear.eigenvalues[k]), np.sort_complex(expected), atol=1e-8)
    np.testing.assert_allclose(linear.radius, np.abs(expected).max(), atol=1e-8)
    np.testing.assert_allclose(linear.b[0], B, atol=1e-9)
    np.testing.assert_allclose(linear.e[0], -B @ [[2.0, 2.5]], atol=1e-8)
    np.testing.assert_allclose(linear.c[0], [[-2.0, -2.5]], atol=1e-8)
    np.testing.assert_allclose(linear.f[0], [[-2.0, -2.5]], atol=1e-8)


def test_a_loop_with_an_observer_has_the_eigenvalues_of_law_and_filter():
    # The separation principle, with the filter of scipy: x+ = A x + B u, gain L of its steady covariance.
    loop = make_loop(observer={})
    found = find_rest(loop, targets(0.3))
    noise = np.diag([(0.01 * 2) ** 2, (0.05 * 3) ** 2]) * 0.1
    prior = solve_discrete_are(A.T, np.array([[1.0], [0.0]]), noise, [[1e-4]])
    gain = prior[:, :1] / (prior[0, 0] + 1e-4)
    expected = [np.linalg.eigvals(A - B @ [[2.0, 2.5]]), np.linalg.eigvals(A - gain @ np.array([[1.0, 0.0]]) @ A)]
    expected = np.sort_complex(np.concatenate(expected))
    values = found.linear.eigenvalues[0]
    np.testing.assert_allclose(np.sort_complex(values[np.abs(values) > 1e-3]), expected, atol=1e-6)
    posterior = prior - gain * prior[:1]
    np.testing.assert_allclose(loop.steady_covariance(found.z)[0], posterior, rtol=1e-5)


@pytest.mark.parametrize("k_v", [2.5, 9.0, 20.15, 20.25])
def test_a_difference_equation_is_stable_inside_the_unit_circle_and_has_the_margins_of_its_map(k_v):
    """p += 0.1 v, v += 0.1 u under u = g (2 (r - p) - k v): z^2 - (2 - 0.1 g k) z + 1 - 0.1 g k + 0.02 g.

    By Jury's criterion it is stable where 4 - 0.2 g k + 0.02 g > 0: until g = 4 / (0.2 k - 0.02), and k = 20.1.
    """
    linear = find_rest(make_loop(Law(2.0, k_v), make_cart(step=0.1)), targets(0.0)).linear
    expected = np.roots([1, -(2 - 0.1 * k_v), 1 - 0.1 * k_v + 0.02])
    np.testing.assert_allclose(np.sort_complex(linear.eigenvalues[0]), np.sort_complex(expected), atol=1e-7)
    assert (linear.radius[0] < 1) == (k_v < 20.1)
    if k_v < 20.1:
        assert loop_margins(linear.row(0))[0].gain == pytest.approx(4 / (0.2 * k_v - 0.02), rel=1e-6)


def test_a_late_input_is_another_state():
    # Fractional delays sample as A x + B1 u_old + B0 u_now, the textbook's form.
    loop = make_loop(model=make_cart(delay=0.13))
    linear = find_rest(loop, targets(0.0)).linear
    late = 0.03
    flow = cont2discrete((np.array([[0.0, 1.0], [0, 0]]), np.array([[0.0], [1.0]]), np.eye(2), 0), 0.1 - late)[:2]
    old = np.array([[1, 0.1 - late], [0, 1]]) @ np.array([[late**2 / 2], [late]])
    k = np.array([[-2.0, -2.5]])
    whole = np.block([[A, old, flow[1]], [np.zeros((1, 2)), np.zeros((1, 1)), np.ones((1, 1))], [k, np.zeros((1, 2))]])
    np.testing.assert_allclose(linear.a[0], whole, atol=1e-8)


def test_of_several_rests_the_one_that_is_reached_counts():
    """v' = p - p^3 - v + u with u = (r - p) / 10 rests near 0, from where it goes away, and near -1 and 1."""
    model = SindyModel(make_loop().signature, ["force", "v", "p", "p^3"], known={"p": "v"})
    model.set_coefficients(torch.tensor([[0, 1], [1, -1], [0, 1], [0, -1]]).double())
    loop = make_loop(Law(0.1, 0.0), model)
    found = find_rest(loop, targets(0.1))
    ends = sorted(np.roots([-1, 0, 0.9, 0.01]).real)
    assert bool(found.still.all()) and float(found.z[0, loop.parts["x"]][0]) == pytest.approx(ends[2], rel=1e-6)
    assert found.linear.radius < 1


def test_a_spring_pulls_a_law_off_its_target_and_an_integral_brings_it_back():
    # k (r - p) = s p, so p = 2 / 3 r with s = 1.
    pulled = find_rest(make_loop(model=make_cart(spring=1.0)), targets(0.3))
    assert bool(pulled.still.all())
    np.testing.assert_allclose(pulled.z[0], [0.2, 0.0], atol=1e-7)
    np.testing.assert_allclose(pulled.u[0], [0.2], atol=1e-7)
    # The integral J has p = r where k J = s r.
    held = find_rest(make_loop(model=make_cart(spring=1.0), integral={"band": 0.5, "limit": 0.4}), targets(0.3))
    np.testing.assert_allclose(held.z[0], [0.3, 0.0, 0.15], atol=1e-6)


def test_a_loop_that_nothing_stops_has_no_rest():
    assert not bool(find_rest(make_loop(Law(0.0, 0.0, bias=0.5)), targets(0.3), seconds=1.0).still.any())


@pytest.mark.parametrize(("seconds", "first", "last"), [(40.0, 351, 400), (10.0, 76, 100), (3.2, 25, 32)])
def test_the_error_of_a_loop_without_rest_is_that_of_its_last_five_seconds_or_quarter(seconds, first, last):
    # p = 0.5 t^2 / 2 from its target on, with control periods of 0.1 s.
    found = find_rest(make_loop(Law(0.0, 0.0, bias=0.5)), targets(0.3), seconds=seconds)
    expected = np.mean([0.25 * (0.1 * k) ** 2 for k in range(first, last + 1)])
    assert found.error.item() == pytest.approx(expected, rel=1e-6)


DT = 0.1


def closed(a, b, k):
    """Return the loop of u = -k x."""
    n = len(a)
    return Linear(DT, a - b @ k, b, -k, np.zeros((n, n)), np.zeros((b.shape[1], n)))


def lqr(a, b, q, r):
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


LQR = lqr(A, B, np.diag([1.0, 0.1]), np.array([[0.5]]))
COUPLED = np.array([[1.1, 0.2, 0.0], [0.0, 0.7, 0.3], [0.1, 0.0, 0.9]])
INPUTS = np.array([[0.1, 0.0], [0.5, 0.1], [0.0, 0.4]])
TWO = lqr(COUPLED, INPUTS, np.eye(3), np.eye(2))


# An oscillation of 3 rad/s whose rate is fed back: the phase of the loop is positive below its resonance.
TURN = 0.98 * np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
RATE = np.array([[0.0, 0.5]])


def test_an_integrator_has_the_margins_of_paper():
    # x+ = x + 0.1 u, u = -4 x: 1 + k L = 0 where 0.4 k = 2. L = 0.4 / (z - 1) has gain 1 where 2 sin(w dt / 2) = 0.4,
    # and its phase there is -90 deg - w dt / 2.
    (found,) = loop_margins(closed(np.array([[1.0]]), np.array([[DT]]), np.array([[4.0]])))
    angle = 2 * math.asin(0.2)
    assert found.gain == pytest.approx(5) and found.lower == 0
    assert found.phase == pytest.approx(math.degrees(math.pi / 2 - angle / 2))
    assert found.delay == pytest.approx((math.pi / 2 - angle / 2) / (angle / DT))
    # S = (z - 1) / (z - 0.6), and |S - 1/2| = |z - 1.4| / |2 (z - 0.6)| is largest at z = -1.
    assert found.disk == pytest.approx(2 * 1.6 / 2.4, rel=1e-6)


@pytest.mark.parametrize(("a", "b", "k"), [(A, B, np.array([[1.0, 1.1]])), (TURN, np.array([[0.0], [1.0]]), RATE)])
def test_a_delay_of_whole_periods_beyond_the_margin_is_too_long(a, b, k):
    (found,) = loop_margins(closed(a, b, k))
    for periods in range(1, 15):
        late = np.zeros((2 + periods, 2 + periods))
        late[:2, :2], late[:2, 2:3] = a, b
        late[np.arange(2, 1 + periods), np.arange(3, 2 + periods)] = 1
        late[-1, :2] = -k
        assert (np.abs(np.linalg.eigvals(late)).max() < 1) == (periods * DT < found.delay)


@pytest.mark.parametrize(("a", "b", "k"), [(A, B, LQR), (COUPLED, INPUTS, TWO), (TURN, np.array([[0.0], [1.0]]), RATE)])
def test_python_control_finds_the_same(a, b, k):
    control = pytest.importorskip("control")
    linear = closed(a, b, k)
    for i, found in enumerate(loop_margins(linear)):
        opened = a - b @ k + b[:, i : i + 1] @ k[i : i + 1]
        loop = control.ss(opened, b[:, i : i + 1], k[i : i + 1], 0, DT)
        gains, phases, *_ = control.stability_margins(loop, returnall=True)
        disk, _, _ = control.disk_margins(loop, np.linspace(1e-3, math.pi / DT, 4000))
        # It leaves out half the sampling rate, and finds a gain of 1e-10 in the rounding of a double integrator.
        theirs = [gain for gain in gains if 1e-6 < gain < 1e6]
        assert all(pytest.approx(gain, rel=1e-4) in (found.gain, found.lower) for gain in theirs)
        assert found.phase == pytest.approx(min(abs(phases)), rel=1e-4)
        assert found.disk == pytest.approx(disk, rel=1e-3)


def test_the_loop_is_that_which_is_open_at_one_input_alone():
    omega = np.array([0.3, 2.0, 20.0])
    linear = closed(COUPLED, INPUTS, TWO)
    for i in range(2):
        opened = COUPLED - INPUTS @ TWO + INPUTS[:, i : i + 1] @ TWO[i : i + 1]
        expected = [
            (TWO[i] @ np.linalg.solve(np.exp(1j * w * DT) * np.eye(3) - opened, INPUTS[:, i])).item() for w in omega
        ]
        np.testing.assert_allclose(open_loop_response(linear, omega)[:, i], expected, rtol=1e-9)
        np.testing.assert_allclose(sensitivity(linear, omega)[:, i], 1 / (1 + np.array(expected)), rtol=1e-9)


def test_a_long_flight_under_noise_spreads_as_much():
    loop = make_loop(observer={"delay": 1})
    held = find_rest(loop, torch.zeros(1, 1))
    gain = held.linear.row(0).noise_gain()
    assert gain[0, 1] == 0  # the rate is not measured
    generator = torch.Generator().manual_seed(2)
    z, covariance = held.z.expand(400, -1), held.covariance.expand(400, -1, -1)
    inputs = []
    for k in range(220):
        noise = torch.randn(400, 2, generator=generator, dtype=torch.float64) * torch.tensor([0.01, 0.5])
        z, covariance, u = loop.step(z, covariance, torch.zeros(400, 1), noise=noise)
        inputs += [u] if k >= 100 else []
    assert torch.stack(inputs).std().item() == pytest.approx(0.01 * gain[0, 0], rel=0.03)


@pytest.mark.parametrize(("force", "slope"), [("tanh(100 v)", math.tanh(3.0) / 0.03), ("v |v|", 0.03)])
def test_a_loop_is_that_of_movements_of_a_hundredth_of_the_ranges(force, slope):
    """p+ = p + 0.1 v, v+ = v + 0.1 (u - 0.15 f(v)): over 3 cm/s of 3 m/s dry friction and drag have these slopes."""
    model = SindyModel(make_loop().signature, ["force", "v", force], known={"p": "v"})
    model.set_coefficients(torch.tensor([[0.0, 1.0], [1.0, 0.0], [0.0, -0.15]], dtype=torch.float64))
    model.library = model.library.with_step(0.1)
    linear = find_rest(make_loop(Law(2.0, 1.2), model=model), targets(0.0)).linear
    expected = np.linalg.eigvals([[1.0, 0.1], [-0.2, 1 - 0.12 - 0.015 * slope]])
    np.testing.assert_allclose(np.sort_complex(linear.eigenvalues[0]), np.sort_complex(expected), atol=1e-9)


@pytest.mark.parametrize(("each_period", "is_stable"), [(1e-6, True), (1e-3, False)])
def test_what_grows_by_less_than_a_flight_shows_does_not_decide(each_period, is_stable):
    """An eigenvalue outside of the unit circle, by which a deviation grows 1.0004 or 1.5 times in 400 periods."""
    linear = closed(np.diag([0.5, 1 + each_period]), np.zeros((2, 1)), np.zeros((1, 2)))
    assert bool(linear._replace(a=linear.a[None]).stable.all()) is is_stable


@pytest.mark.parametrize("swings", [False, True])
def test_what_neither_grows_nor_dies_out_leaves_a_loop_stable_and_is_weak_if_it_swings(swings):
    """The cart of the other tests beside a load that stays what it is, d' = 0, or one of 2 rad/s: eigenvalues on paper.

    All others have a radius of 1, of which two Runge-Kutta steps of a swing lose (0.05 s * 2 rad/s)^6 / 144 each.
    """
    signature = Signature(("p", "v", "d", "e"), ("m", "m/s", "N", "N/s"), ("force",), (2.0, 3.0, 1.0, 9.0))
    model = SindyModel(signature, ["force", "v", "d", "e"], known={"p": "v"})
    of_load = [[0, 0, 0, -4 * swings], [0, 0, swings, 0]]
    model.set_coefficients(torch.tensor([[0, 1, 0, 0], [1, 0, 0, 0], *of_load], dtype=torch.float64))
    task = Tracking(signature, Step([[0.0]]), ("p",), ("v",), TrackingReward((1.0,)), error_scale=0.7)

    def law(tensordict):
        seen = tensordict["observation"]
        return tensordict.set("action", 2.0 * 0.7 * seen[..., 4:5] - 2.5 * 3.0 * seen[..., 1:2])

    loop = ClosedLoop(Controller(law, ControlSetup(task, 0.1, 2)), model, 0.05)
    found = check(loop, Settings((-0.5,), (0.5,), draws=0, grid=2))
    assert bool(found.stable.all())
    assert float(found.rest.linear.radius[0]) == pytest.approx(1 - swings * 2 * 0.1**6 / 144, abs=1e-9)
    stability, *others = check_verdict(found)
    undamped = [(each.values["state"], each.values["seconds"]) for each in others if each.code == "check.undamped"]
    assert undamped == ([("d", pytest.approx(math.pi, rel=1e-3))] if swings else [])
    expected = np.abs(np.roots([1, -(2 - 0.01 - 0.25), 1 - 0.01 - 0.25 + 0.02])).max()
    assert (stability.severity, stability.values["neutral"]) == ("note", True)
    assert stability.values["radius"] == pytest.approx(expected, abs=1e-6)
    phase = next(each for each in others if each.code == "check.phase_margin")
    assert phase.values["value"] > 30 and phase.values["weak"] == 0
