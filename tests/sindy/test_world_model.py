"""Every world model, and its errors of prediction on plants whose motion is known in closed form."""

import math

import numpy as np
import pytest
import torch
from alternating import Alternating
from plants import Linear, held_motion, scipy_motion

from dynasindy.sindy import Oracle, SindyModel
from dynasindy.sindy.world_model import one_step_error, open_loop
from dynasindy.systems import Signature, integrate
from dynasindy.systems.transitions import Transitions


def test_of_a_difference_equation_it_moves_by_its_steps():
    """Two steps of -0.6 x + u: 0.36 x + 0.4 u."""
    x, u = torch.tensor([[1.0], [-2.0]]), torch.tensor([[0.5], [0.0]])
    plant = Alternating()
    found = integrate(Oracle(plant.signature, plant), x, u, 1.0, 1)[0]
    assert found.flatten().tolist() == pytest.approx([0.56, -0.72])


MATRIX, PULL = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [3.0]])


def recording(dt: float = 0.1, seed: int = 0, n: int = 40) -> Transitions:
    """Two segments of the exact motion under held inputs."""
    generator, parts = np.random.default_rng(seed), []
    for _ in range(2):
        u = generator.uniform(-1, 1, (n, 1))
        states = held_motion(MATRIX, PULL, generator.normal(size=2), u, dt)
        parts.append(Transitions.from_trajectory(torch.from_numpy(states), torch.from_numpy(u), dt))
    return Transitions.cat(parts)


def test_the_error_of_a_wrong_model_is_that_of_its_matrix_exponential():
    data, wrong = recording(), MATRIX + np.array([[0.0, 0.0], [0.5, 0.1]])
    predicted = np.array([held_motion(wrong, PULL, x, u, 0.1)[1] for x, u in zip(data.x, data.u, strict=True)])
    expected = np.sqrt(np.mean((predicted - data.x_next.numpy()) ** 2, 0)) / np.std(data.x_next.numpy(), 0, ddof=1)
    assert np.allclose(one_step_error(Linear(wrong, PULL), data, substeps=10), expected, rtol=1e-6)


def test_open_loop_starts_anew_with_each_segment_and_reads_inputs_only():
    data, wrong = recording(), MATRIX + np.array([[0.0, 0.0], [0.5, 0.1]])
    parts = [held_motion(wrong, PULL, data.x[k], data.u[k : k + 40], 0.1)[1:] for k in (0, 40)]
    assert np.allclose(open_loop(Linear(wrong, PULL), data, substeps=10), np.concatenate(parts), atol=1e-7)


def swing() -> SindyModel:
    """a' = b, b' = -9 sin a - 0.3 b + 2 u, as a sparse model."""
    model = SindyModel(Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0)), ["b", "sin(a)", "u"])
    model.set_coefficients(torch.tensor([[1.0, -0.3], [0.0, -9.0], [0.0, 2.0]]))
    return model


def test_substeps_of_predictions_and_simulations_approach_scipy_by_fourth_order():
    model, inputs = swing(), [0.5, -1.0, 0.8]
    x0, u = torch.tensor([[0.8, 0.5]], dtype=torch.float64), torch.tensor(inputs, dtype=torch.float64)
    rates = lambda _, x, u: [x[1], -9 * math.sin(x[0]) - 0.3 * x[1] + 2 * u]  # noqa: E731
    exact = scipy_motion(rates, [0.8, 0.5], inputs, 0.3, 1e-11, 1e-12)
    errors = []
    for substeps in (1, 2, 4, 32):
        with torch.no_grad():
            path = model.simulate(x0, u.reshape(1, 3, 1), 0.3, substeps)
            once = model.predict(x0, u[:1].unsqueeze(0), 0.3, substeps)
        assert path.shape == (1, 4, 2) and torch.equal(path[:, 0], x0) and torch.allclose(path[:, 1], once, rtol=1e-13)
        errors.append(float((once[0] - torch.from_numpy(exact[1])).abs().max()))
    assert np.allclose(path[0], exact, atol=1e-6)
    assert all(9 < coarse / fine < 40 for coarse, fine in zip(errors[:2], errors[1:3])) and errors[3] < 1e-7
