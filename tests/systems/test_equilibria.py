"""Rests and modes of plants whose rests are known in closed form or published."""

import math

import numpy as np
import pytest
import torch
from plants import Linear, Plant
from scipy.linalg import expm

from dynasindy.systems import Pendulum, System, Tras, Xi
from dynasindy.systems.equilibria import Equilibria, LocalModes, find_equilibria, growth, modes

CART = Plant("s v m", lambda s, v, m, u, w: [v, 3.0 * (u + 0.5 * w) - 0.5 * v * v, v], (1.0, 2.0, 5.0), "u w")
"""A driven cart whose mileage counts on."""


def test_a_pendulum_rests_where_its_torque_balances_gravity():
    targets = torch.tensor([[-0.8], [0.1], [0.9]])
    rests = find_equilibria(Pendulum(), [0], targets, torch.zeros(2), 0.05)
    torch.testing.assert_close(rests.x, torch.cat([targets, torch.zeros(3, 1)], -1).double(), atol=1e-6, rtol=0)
    torch.testing.assert_close(rests.u, 9.81 / 12.0 * torch.sin(targets.double()), atol=1e-6, rtol=0)
    wanted = torch.tensor([[0.0, 1.0], [-9.81 * math.cos(0.1), -0.5]], dtype=torch.float64)
    torch.testing.assert_close(rests.a[1], wanted, atol=1e-5, rtol=0)
    torch.testing.assert_close(rests.b[1], torch.tensor([[0.0], [12.0]], dtype=torch.float64), atol=1e-5, rtol=0)
    assert rests.middle() == 1 and rests.moved.tolist() == [True, True]


def test_a_target_beyond_the_inputs_has_no_rest():
    strong, weak = Pendulum(), Pendulum(max_torque=5.0)
    targets = torch.tensor([[0.2], [1.2]])  # the second takes 9.1 N m
    assert len(find_equilibria(strong, [0], targets, torch.zeros(2), 0.05)) == 2
    rests = find_equilibria(weak, [0], targets, torch.zeros(2), 0.05)
    assert rests.targets.tolist() == [[pytest.approx(0.2)]] and rests.unheld.tolist() == [[pytest.approx(1.2)]]
    assert rests.needed.tolist() == [[pytest.approx(9.81 * math.sin(1.2) / 5.0)]]


POND = Plant("y z", lambda y, z, u: [u - y + z / 1000, 0.02 * y.square()], (1.0, 100.0))
"""A level that a pump holds, of water that warms whatever is done."""


def test_what_moves_by_less_than_a_thousandth_of_its_range_per_second_rests():
    limits = torch.tensor([[-10.0], [10.0]])
    rests = find_equilibria(POND, [0], torch.tensor([[1.0], [2.2], [2.3], [4.0]]), torch.zeros(2), 0.05, limits)
    assert rests.targets.flatten().tolist() == pytest.approx([1.0, 2.2])  # 2e-4 y^2 ranges per second
    torch.testing.assert_close(rests.u[:, 0], rests.x[:, 0] - rests.x[:, 1] / 1000, atol=1e-3, rtol=0)


ARM = Plant("a w", lambda a, w, u: [w, 8.0 * u.square() - 9.0 * torch.sin(a) - 0.5 * w], (1.0, 3.0))
"""An arm that a propeller lifts, whichever way it turns."""


@pytest.mark.parametrize(("low", "high", "sign"), [(0.1, 0.9, 1.0), (-0.9, -0.1, -1.0)])
def test_rests_have_inputs_between_their_ends(low, high, sign):
    targets = torch.tensor([[0.2], [0.5], [0.9]])  # 0.9 takes an input of 0.9387
    rests = find_equilibria(ARM, [0], targets, torch.zeros(2), 0.05, torch.tensor([[low], [high]]))
    wanted = sign * (9.0 * torch.sin(targets[:2].double()) / 8.0).sqrt()
    torch.testing.assert_close(rests.u, wanted, atol=1e-6, rtol=0)
    assert rests.unheld.tolist() == [[pytest.approx(0.9)]]


def test_a_state_that_nothing_depends_on_need_not_rest_and_spare_inputs_are_no_obstacle():
    rests = find_equilibria(CART, [1], torch.tensor([[0.4], [1.2]]), torch.zeros(3), 0.05)
    assert rests.moved.tolist() == [False, True, False] and len(rests) == 2
    torch.testing.assert_close(3 * (rests.u[:, 0] + 0.5 * rests.u[:, 1]), torch.tensor([0.08, 0.72]).double())


def test_growth_is_that_of_the_largest_deviation_in_ranges():
    assert growth(torch.tensor([[0.5]]).double(), torch.ones(1), 4.0) == pytest.approx(math.exp(2.0))
    double = torch.tensor([[0.0, 1.0], [0.0, 0.0]], dtype=torch.float64)  # a position of range 1, a rate of range 10
    scale = torch.tensor([1.0, 10.0], dtype=torch.float64)
    wanted = torch.linalg.matrix_norm(torch.as_tensor(expm([[0.0, 30.0], [0.0, 0.0]])), 2)  # in ranges: 10 * 3 s
    assert growth(double, scale, 3.0) == pytest.approx(float(wanted))
    assert growth(torch.tensor([[1000.0]]).double(), torch.ones(1), 10.0) == math.inf  # e^10000 is no double


def spring(hertz, damping):
    """Return the rows of p' = v, v' = -(2 pi f)^2 p - 2 z (2 pi f) v."""
    w = 2 * math.pi * hertz
    return [0.0, 1.0], [-w * w, -2 * damping * w]


def two(first, second):
    return [[*row, 0.0, 0.0] for row in first] + [[0.0, 0.0, *row] for row in second]


def of(system, outputs=(0,)):
    signature = system.signature
    return LocalModes(system, torch.zeros(signature.n_x), torch.zeros(signature.n_u), outputs).oscillation


@pytest.mark.parametrize("damping", [-0.05, 0.0, 0.14, 0.45])
def test_a_mass_on_a_spring_swings_with_its_damped_period(damping):
    """T = 1 / (f sqrt(1 - z^2))."""
    plant = Linear([*spring(9.4, damping)], [[0.0], [1.0]])
    assert of(plant) == pytest.approx(1 / (9.4 * math.sqrt(1 - damping**2)), rel=1e-6)


@pytest.mark.parametrize("damping", [0.55, 1.0, 3.0, -0.8])
def test_what_hardly_swings_has_no_oscillation(damping):
    assert of(Linear([*spring(9.4, damping)], [[0.0], [1.0]])) == math.inf


def test_the_fastest_of_two_oscillations_counts_only_where_an_input_moves_it_or_an_output_shows_it():
    slow, fast = spring(1.0, 0.1), spring(20.0, 0.1)
    root = math.sqrt(1 - 0.01)
    # Each of two inputs pushes a mass of its own.
    pushed, free = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 400.0]], [[0.0], [1.0], [0.0], [0.0]]
    assert of(Linear(two(slow, fast), pushed)) == pytest.approx(1 / (20 * root), rel=1e-6)
    assert of(Linear(two(slow, fast), free)) == pytest.approx(1 / root, rel=1e-6)
    assert of(Linear(two(slow, fast), free), outputs=(2,)) == pytest.approx(1 / (20 * root), rel=1e-6)


def test_a_pendulum_swings_where_it_hangs_and_falls_where_it_stands():
    """Omega' = -9.81 sin(theta) - 0.5 Omega + 12 u."""
    hanging, standing, one = torch.zeros(2), torch.tensor([math.pi, 0.0]), torch.zeros(1)
    swing = 2 * math.pi / math.sqrt(9.81 - 0.25**2)
    assert LocalModes(Pendulum(), hanging, one, [0]).oscillation == pytest.approx(swing, rel=1e-5)
    assert LocalModes(Pendulum(), standing, one, [0]).oscillation == math.inf


def test_a_difference_equation_whose_sign_changes_swings_every_two_steps():
    class Alternating(Linear):
        step = 0.25

    a, b = [[-1.6 / 0.25]], [[4.0]]
    assert of(Linear(a, b)) == math.inf
    assert of(Alternating(a, b)) == pytest.approx(0.5)


def test_a_deviation_doubles_as_the_fastest_mode_says_that_an_input_moves_or_an_output_shows():
    """q' = 3 q - 5 w + u, w' = -w, and a state of its own that nobody needs, v' = 40 v."""
    plant = Linear([[3.0, 0.0, -5.0], [0.0, 40.0, 0.0], [0.0, 0.0, -1.0]], [[1.0], [0.0], [0.0]])
    of_first, of_second = (
        LocalModes(plant, torch.zeros(3), torch.zeros(1), outputs).doubling for outputs in ([0], [1])
    )
    assert of_first == pytest.approx(math.log(2) / 3) and of_second == pytest.approx(math.log(2) / 40)
    assert LocalModes(Pendulum(), torch.zeros(2), torch.zeros(1), [0]).doubling == math.inf


OUTPUTS = (0, 1)


def equilibria_of(system: System, targets: torch.Tensor) -> Equilibria:
    return find_equilibria(system, OUTPUTS[: targets.shape[-1]], targets, torch.zeros(system.signature.n_x), 0.05)


def test_a_plant_whose_only_state_is_held_rests_where_its_input_makes_up_for_its_loss():
    """x' = -2 x + 3 u rests at x with u = 2 x / 3."""
    found = equilibria_of(Linear([[-2.0]], [[3.0]]), torch.tensor([[0.3]]))
    assert float(found.x) == pytest.approx(0.3) and float(found.u) == pytest.approx(0.2)


def test_equilibria_of_xi_are_those_known():
    known = {-0.5: (-0.157, -0.131), -0.25: (-0.139, 0.044), 0.0: (-0.122, 0.210), 0.4: (-0.100, 0.432)}
    reference = torch.tensor([[0.3, pitch] for pitch in known])
    found = equilibria_of(Xi(), reference)
    torch.testing.assert_close(found.u.float(), torch.tensor(list(known.values())), atol=1e-3, rtol=0)
    torch.testing.assert_close(found.x[:, :2], reference.double())


@pytest.mark.parametrize("system", [Tras(), Xi()])
def test_a_system_stays_at_its_equilibrium(system):
    found = equilibria_of(system, torch.rand(12, 2) - 0.5)
    assert found.x.shape == (12, 6)
    scale = torch.tensor(system.signature.x_scale)
    assert (system(found.x, found.u) / scale).abs().max() < 1e-8


def test_a_reference_that_is_no_number_has_no_equilibrium():
    found = equilibria_of(Tras(), torch.tensor([[0.0, float("nan")], [0.1, 0.0]]))
    assert found.targets.tolist() == [[pytest.approx(0.1), 0.0]] and len(found.unheld) == 1


def test_modes_of_a_difference_equation_are_logarithms_of_what_it_multiplies_by():
    """-0.6 every 0.1 s halves in turns of 0.2 s: log(0.6) / 0.1 + pi / 0.1 i; what is gone at once is gone fast."""
    a = torch.diag(torch.tensor([-1.6, -0.5, -1.0], dtype=torch.float64)) / 0.1
    found = modes(a, 0.1)
    assert complex(found[0]) == pytest.approx(complex(np.log(0.6), np.pi) / 0.1)
    assert complex(found[1]) == pytest.approx(np.log(0.5) / 0.1)
    assert float(found[2].real) == pytest.approx(np.log(1e-6) / 0.1)
    assert sorted(modes(a).real.tolist()) == pytest.approx([-16.0, -10.0, -5.0])
