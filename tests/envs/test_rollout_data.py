"""A recording of a plant is the plant's own motion, without what touched a stop."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from dynasindy.control.sensing import Sensing
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import ControlEnv, Step, Tracking
from dynasindy.systems import Tras, rk4
from dynasindy.systems.base import Signature, System
from dynasindy.systems.steps import Stops
from dynasindy.systems.transitions import Transitions


class Oscillator(System):
    """q'' = -4 q - 0.4 q' + 3 u."""

    A = np.array([[0.0, 1.0], [-4.0, -0.4]])
    B = np.array([[0.0], [3.0]])

    def __init__(self, stops=None):
        super().__init__(Signature(("q", "v"), ("rad", "rad/s"), ("u",), (1.0, 1.0)), stops)

    def forward(self, x, u):
        return x @ torch.from_numpy(self.A).to(x).mT + u @ torch.from_numpy(self.B).to(x).mT


def exact(u: np.ndarray, dt: float, x0: np.ndarray) -> np.ndarray:
    """The matrix exponential of [A B; 0 0]: the motion under held inputs."""
    step = expm(dt * np.block([[Oscillator.A, Oscillator.B], [np.zeros((1, 3))]]))
    states = [x0]
    for held in u:
        states.append(step[:2, :2] @ states[-1] + step[:2, 2:] @ held)
    return np.array(states)


def inputs(n: int = 60) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (n, 1)))


def test_a_linear_plant_moves_as_the_matrix_exponential_says():
    u, start = inputs(), np.array([0.3, -0.2])
    data = record_plant(Oscillator(), u, 0.05, x0=torch.from_numpy(start))
    motion = exact(u.numpy(), 0.05, start)
    assert np.allclose(data.x, motion[:-1], atol=1e-9) and np.allclose(data.x_next, motion[1:], atol=1e-9)
    assert torch.equal(data.u, u) and data.dt == 0.05 and data.segment.unique().tolist() == [0]


def test_a_recording_starts_at_rest_in_double_precision_without_gradients():
    data = record_plant(Oscillator(), inputs(3).float().requires_grad_(), 0.05)
    assert data.x[0].tolist() == [0.0, 0.0]
    assert data.x.dtype == data.u.dtype == torch.float64 and not data.x_next.requires_grad


def test_samples_that_touch_a_stop_are_left_out_and_split_the_recording():
    plant = Oscillator(Stops((0,), (1,), (-0.5,), (0.5,)))
    u = torch.cat([torch.full((20, 1), 1.0), torch.zeros(40, 1)]).double()
    data = record_plant(plant, u, 0.05)
    free = exact(u.numpy(), 0.05, np.zeros(2))
    before = int(np.argmax(free[1:, 0] >= 0.5))  # transitions that end below the stop
    assert 0 < before < len(data) < 60
    assert bool((data.x_next[:, 0].abs() < 0.5).all())
    assert np.allclose(data.x_next[:before], free[1 : before + 1], atol=1e-9)
    assert data.segment.tolist() == [0] * before + [1] * (len(data) - before)


def test_noise_does_not_leak_over_a_gap():
    clean = record_plant(Oscillator(), inputs(60), 0.05)
    clean = clean.select(torch.arange(60) != 30)
    noisy = clean.disturbed(0.1, seed=3)
    assert not torch.equal(noisy.x[30] - clean.x[30], noisy.x_next[29] - clean.x_next[29])
    assert clean.disturbed(0.0, seed=3) is clean


def test_noise_is_its_seeds_numbers_times_the_spread_of_each_state():
    clean = record_plant(Oscillator(), inputs(20), 0.05)
    noisy, rng = clean.disturbed(0.2, seed=7), torch.Generator().manual_seed(7)
    after, first = (torch.randn(20, 2, generator=rng, dtype=torch.float64) for _ in range(2))
    spread = torch.from_numpy(np.std(clean.x_next.numpy(), 0, ddof=1))
    torch.testing.assert_close(noisy.x_next, clean.x_next + 0.2 * spread * after)
    torch.testing.assert_close(noisy.x[0], clean.x[0] + 0.2 * spread * first[0])
    torch.testing.assert_close(noisy.x[1:], clean.x[1:] + 0.2 * spread * after[:-1])
    assert torch.equal(noisy.u, clean.u)


def rollout(u, steps):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.0, 0.0]])), dtype=torch.float64)
    policy = TensorDictModule(lambda o: torch.tensor(u), in_keys=["observation"], out_keys=["action"])
    return env.rollout(steps, policy)


def test_each_period_gives_its_own_rows_inputs_and_flag():
    """Four periods of two samples; the second and the last touched a stop."""
    start = torch.tensor([[0.0], [2.0], [4.0], [6.0]])
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [4.0]], [[5.0], [6.0]], [[7.0], [8.0]]])
    rows = TensorDict(
        {
            "state": start,
            "action": torch.tensor([[0.1, -0.1], [0.2, -0.2], [0.3, -0.3], [0.4, -0.4]]),
            "next": {"samples": samples, "at_stop": torch.tensor([[False], [True], [False], [True]])},
        },
        [4],
    )
    data = Transitions.from_periods(rows, 0.025)
    assert data.x.flatten().tolist() == [0, 1, 4, 5] and data.x_next.flatten().tolist() == [1, 2, 5, 6]
    expected = torch.tensor([[0.1, -0.1], [0.1, -0.1], [0.3, -0.3], [0.3, -0.3]])
    assert torch.equal(data.u.float(), expected) and data.u.dtype == data.x.dtype == data.x_next.dtype == torch.float64
    assert data.segment.tolist() == [0, 0, 1, 1] and data.dt == 0.025


def test_every_logged_sample_becomes_a_transition_of_the_plant():
    data = Transitions.from_periods(rollout([0.2, 0.4], 20), 0.01)
    assert len(data) == 100 and data.dt == 0.01
    assert torch.allclose(rk4(Tras(), data.x, data.u, 0.01), data.x_next, rtol=1e-12)


def test_periods_at_a_stop_are_left_out_and_break_the_segment():
    rows = rollout([1.0, 1.0], 80)
    at_stop = rows["next", "at_stop"].flatten()
    assert 0 < at_stop.sum() < 80
    data = Transitions.from_periods(rows, 0.01)
    assert len(data) == 5 * int((~at_stop).sum())
    follows = data.segment[1:] == data.segment[:-1]
    assert torch.equal(data.x[1:][follows], data.x_next[:-1][follows])


def test_an_observer_reads_the_first_measurement_and_that_at_the_end_of_each_period():
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [torch.nan]]])
    rows = TensorDict(
        {
            "measurement": torch.tensor([[0.5], [2.0]]),
            "action": torch.tensor([[0.1], [0.2]]),
            "next": {"samples": samples},
        },
        [2],
    )
    y, u = Sensing.measured(rows)
    torch.testing.assert_close(y, torch.tensor([[0.5], [2.0], [torch.nan]]), equal_nan=True)
    assert u.flatten().tolist() == pytest.approx([0.1, 0.2])
