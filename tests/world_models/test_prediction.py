"""Errors of prediction on plants whose motion is known in closed form."""

import math

import numpy as np
import torch
from scipy.linalg import expm

from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.prediction import nrmse, one_step_error, open_loop

MATRIX = np.array([[0.0, 1.0], [-4.0, -0.4]])


class Linear(System):
    """x' = A x + (0, 3) u."""

    def __init__(self, matrix):
        super().__init__(Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0)))
        self.matrix = torch.from_numpy(matrix)

    def forward(self, x, u):
        return x @ self.matrix.to(x).mT + torch.cat([torch.zeros_like(u), 3 * u], -1)


class Explosion(Linear):
    """x' = x^3, infinite after a finite time."""

    def forward(self, x, u):
        return x**3


def recording(dt: float = 0.1, seed: int = 0, n: int = 40) -> Transitions:
    """Two segments of the exact motion under held inputs."""
    step = expm(dt * np.block([[MATRIX, np.array([[0.0], [3.0]])], [np.zeros((1, 3))]]))
    generator, parts = np.random.default_rng(seed), []
    for _ in range(2):
        u, states = generator.uniform(-1, 1, (n, 1)), [generator.normal(size=2)]
        for held in u:
            states.append(step[:2, :2] @ states[-1] + step[:2, 2:] @ held)
        parts.append(Transitions.from_trajectory(torch.from_numpy(np.array(states)), torch.from_numpy(u), dt))
    return Transitions.cat(parts)


def test_the_true_model_errs_by_its_integration_only_and_that_by_fourth_order():
    data = recording()
    model = Linear(MATRIX)
    coarse, fine = one_step_error(model, data), one_step_error(model, data, substeps=2)
    assert float(coarse.max()) < 1e-4
    assert bool(((coarse / fine > 12) & (coarse / fine < 20)).all())
    assert float(nrmse(open_loop(model, data, substeps=20), data).max()) < 1e-8


def test_the_error_of_a_wrong_model_is_that_of_its_matrix_exponential():
    data, wrong = recording(), MATRIX + np.array([[0.0, 0.0], [0.5, 0.1]])
    step = expm(0.1 * np.block([[wrong, np.array([[0.0], [3.0]])], [np.zeros((1, 3))]]))
    predicted = data.x.numpy() @ step[:2, :2].T + data.u.numpy() @ step[:2, 2:].T
    expected = np.sqrt(np.mean((predicted - data.x_next.numpy()) ** 2, 0)) / np.std(data.x_next.numpy(), 0, ddof=1)
    assert np.allclose(one_step_error(Linear(wrong), data, substeps=10), expected, rtol=1e-6)


def test_open_loop_starts_anew_with_each_segment_and_reads_inputs_only():
    data, wrong = recording(), MATRIX + np.array([[0.0, 0.0], [0.5, 0.1]])
    step = expm(0.1 * np.block([[wrong, np.array([[0.0], [3.0]])], [np.zeros((1, 3))]]))
    expected = []
    for k in range(80):
        x = data.x[k].numpy() if k in (0, 40) else expected[-1]
        expected.append(step[:2, :2] @ x + step[:2, 2:] @ data.u[k].numpy())
    assert np.allclose(open_loop(Linear(wrong), data, substeps=10), expected, atol=1e-7)


def test_relative_errors_are_those_of_the_formula():
    x = torch.tensor([[0.0, 0.0], [1.0, 5.0], [2.0, 5.0], [3.0, 5.0]], dtype=torch.float64)
    data = Transitions.from_trajectory(x, torch.zeros(3, 1), 0.1)
    error = nrmse(data.x_next + torch.tensor([0.5, 0.0]), data)
    assert error.tolist() == [0.5, 0.0]  # 1, 2, 3 deviate by 1


def test_a_prediction_that_overflows_has_an_infinite_error():
    data = recording(n=60)
    predicted = open_loop(Explosion(MATRIX), data)
    assert not bool(predicted.isfinite().all())
    assert nrmse(predicted, data).tolist() == [math.inf, math.inf]
