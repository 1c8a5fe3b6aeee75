import math

import pytest
import torch

from dynasindy.systems import Pendulum, Stops, integrate, rk4


def oscillator(x, u):
    return torch.stack((x[..., 1], -x[..., 0]), -1)


def error_after_one_second(steps):
    x = torch.tensor([1.0, 0.0], dtype=torch.float64)
    for _ in range(steps):
        x = rk4(oscillator, x, torch.zeros(1), 1 / steps)
    exact = torch.tensor([math.cos(1), -math.sin(1)], dtype=torch.float64)
    return (x - exact).norm().item()


def test_rk4_is_of_fourth_order():
    orders = [math.log2(error_after_one_second(n) / error_after_one_second(2 * n)) for n in (10, 20, 40)]
    assert orders == pytest.approx([4, 4, 4], abs=0.1)


def test_input_is_held_over_the_period():
    # x' = u with u = 3 held for 0.5 s moves by exactly 1.5, in equal samples.
    samples, _ = integrate(lambda x, u: u, torch.zeros(2, 1), torch.full((2, 1), 3.0), 0.5, 5)
    assert torch.allclose(samples[0, :, 0], torch.tensor([0.3, 0.6, 0.9, 1.2, 1.5]))


def test_undamped_pendulum_keeps_its_energy():
    pendulum = Pendulum(damping=0.0)
    x = torch.tensor([2.0, 0.0], dtype=torch.float64)
    energy = lambda x: 0.5 * x[1] ** 2 - 9.81 * torch.cos(x[0])  # noqa: E731
    start = energy(x)
    for _ in range(1000):
        x = rk4(pendulum, x, torch.zeros(1, dtype=torch.float64), 0.01)
    assert abs(energy(x) - start) < 1e-6


def test_a_stop_holds_the_position_and_zeroes_the_outward_rate_only():
    stops = Stops((0,), (1,), (-1.0,), (1.0,))
    x = torch.tensor([[1.2, 0.5], [1.2, -0.5], [-3.0, -0.5], [0.5, 2.0]])
    held, touched = stops.apply(x)
    assert held.tolist() == [[1.0, 0.0], [1.0, -0.5], [-1.0, 0.0], [0.5, 2.0]]
    assert touched.tolist() == [True, True, True, False]


def test_touching_within_the_period_is_reported():
    stops = Stops((0,), (1,), (-1.0,), (1.0,))
    x = torch.tensor([[0.9, 2.0], [0.0, 0.1]])
    samples, touched = integrate(lambda x, u: torch.stack((x[..., 1], 0 * x[..., 1]), -1), x, x, 0.1, 5, stops)
    assert touched.tolist() == [True, False]
    assert samples[0, -1].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("stops", [((0,), (1,), (1.0,), (-1.0,)), ((0, 1), (1,), (0.0,), (1.0,))])
def test_impossible_stops_are_refused(stops):
    with pytest.raises(ValueError, match="stops need"):
        Stops(*stops)
