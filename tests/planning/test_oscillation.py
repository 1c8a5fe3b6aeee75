"""Oscillations of linear plants whose periods are known in closed form."""

import math

import pytest
import torch

from dynasindy.planning.equilibria import fastest_doubling, fastest_oscillation
from dynasindy.systems import Pendulum, Signature, System


class Linear(System):
    """dx/dt = A x + B u, states in ranges of their own."""

    def __init__(self, a, b, scale=None):
        n = len(a)
        super().__init__(Signature(tuple("pvqwabcd"[:n]), ("-",) * n, ("u",), scale or (1.0,) * n))
        self.a, self.b = (torch.tensor(given, dtype=torch.float64) for given in (a, b))

    def forward(self, x, u):
        return x @ self.a.mT + u @ self.b.mT


def spring(hertz, damping):
    """Return the rows of p' = v, v' = -(2 pi f)^2 p - 2 z (2 pi f) v."""
    w = 2 * math.pi * hertz
    return [0.0, 1.0], [-w * w, -2 * damping * w]


def two(first, second):
    return [[*row, 0.0, 0.0] for row in first] + [[0.0, 0.0, *row] for row in second]


def of(system, outputs=(0,)):
    n = system.signature.n_x
    return fastest_oscillation(system, torch.zeros(n), torch.zeros(1), outputs)


@pytest.mark.parametrize("damping", [-0.05, 0.0, 0.14, 0.45])
def test_a_mass_on_a_spring_swings_with_its_damped_period(damping):
    """T = 1 / (f sqrt(1 - z^2))."""
    plant = Linear([*spring(9.4, damping)], [[0.0], [1.0]])
    assert of(plant) == pytest.approx(1 / (9.4 * math.sqrt(1 - damping**2)), rel=1e-6)


@pytest.mark.parametrize("damping", [0.55, 1.0, 3.0, -0.8])
def test_what_hardly_swings_has_no_oscillation(damping):
    assert of(Linear([*spring(9.4, damping)], [[0.0], [1.0]])) == math.inf


def test_a_lag_and_a_tank_have_no_oscillation():
    assert of(Linear([[-3.0, 1.0], [0.0, -50.0]], [[0.0], [50.0]])) == math.inf


def test_the_fastest_of_two_oscillations_counts_only_where_an_input_moves_it_or_an_output_shows_it():
    slow, fast = spring(1.0, 0.1), spring(20.0, 0.1)
    root = math.sqrt(1 - 0.01)
    pushed, free = [[0.0], [1.0], [0.0], [400.0]], [[0.0], [1.0], [0.0], [0.0]]
    assert of(Linear(two(slow, fast), pushed)) == pytest.approx(1 / (20 * root), rel=1e-6)
    assert of(Linear(two(slow, fast), free)) == pytest.approx(1 / root, rel=1e-6)
    assert of(Linear(two(slow, fast), free), outputs=(2,)) == pytest.approx(1 / (20 * root), rel=1e-6)


def test_it_is_the_same_in_millimetres():
    """A push of 1 m/s^2 is one of 1000 mm/s^2."""
    slow, fast = spring(1.0, 0.1), spring(20.0, 0.1)
    for push in (400.0, 1e-6):
        metres = Linear(two(slow, fast), [[0.0], [1.0], [0.0], [push]])
        small = Linear(two(slow, fast), [[0.0], [1.0], [0.0], [1e3 * push]], (1.0, 1.0, 1e3, 1e3))
        assert of(metres) == pytest.approx(of(small), rel=1e-6)


def test_a_pendulum_swings_where_it_hangs_and_falls_where_it_stands():
    """Omega' = -9.81 sin(theta) - 0.5 Omega + 12 u."""
    hanging, standing, one = torch.zeros(2), torch.tensor([math.pi, 0.0]), torch.zeros(1)
    swing = 2 * math.pi / math.sqrt(9.81 - 0.25**2)
    assert fastest_oscillation(Pendulum(), hanging, one, [0]) == pytest.approx(swing, rel=1e-5)
    assert fastest_oscillation(Pendulum(), standing, one, [0]) == math.inf


def test_a_model_that_is_infinite_there_has_none():
    class Root(Linear):
        def forward(self, x, u):
            return super().forward(x, u) + (x - 1e-3).sqrt()

    assert of(Root([*spring(9.4, 0.1)], [[0.0], [1.0]])) == math.inf


def test_a_difference_equation_whose_sign_changes_swings_every_two_steps():
    class Alternating(Linear):
        step = 0.25

    a, b = [[-1.6 / 0.25]], [[4.0]]
    assert of(Linear(a, b)) == math.inf
    assert of(Alternating(a, b)) == pytest.approx(0.5)


def test_a_deviation_doubles_as_the_fastest_mode_says_that_an_input_moves_or_an_output_shows():
    """q' = 3 q - 5 w + u, w' = -w, and a state of its own that nobody needs, v' = 40 v."""
    plant = Linear([[3.0, 0.0, -5.0], [0.0, 40.0, 0.0], [0.0, 0.0, -1.0]], [[1.0], [0.0], [0.0]])
    of_first, of_second = (fastest_doubling(plant, torch.zeros(3), torch.zeros(1), outputs) for outputs in ([0], [1]))
    assert of_first == pytest.approx(math.log(2) / 3) and of_second == pytest.approx(math.log(2) / 40)
    assert fastest_doubling(Pendulum(), torch.zeros(2), torch.zeros(1), [0]) == math.inf
