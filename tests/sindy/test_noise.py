"""Noise of sensors, random pushes and errors that last."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from dynasindy.sindy.library import Library, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement, looks_noisy
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

N = 20_000


def noisy(*errors: np.ndarray, segments: np.ndarray | None = None) -> bool:
    """What is said of a model that says that nothing moves, where states move by these errors at each step."""
    n, n_x = len(errors[0]), len(errors)
    names = tuple(f"y{k}" for k in range(n_x))
    library = Library(Signature(names, ("-",) * n_x, ("u",), (1.0,) * n_x), [variable(names[0])])
    x = torch.zeros(n, n_x, dtype=torch.float64)
    labels = torch.zeros(n, dtype=torch.int64) if segments is None else torch.from_numpy(segments)
    moved = torch.from_numpy(np.stack(errors, -1))
    data = Transitions(x, torch.zeros(n, 1, dtype=torch.float64), moved, 0.1, labels)
    return looks_noisy(library, torch.zeros(1, n_x, dtype=torch.float64), data)


def white(seed: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n)


def sensor(seed: int, n: int = N) -> np.ndarray:
    """Errors of single steps that white noise of a sensor makes, of variance 1."""
    return np.diff(white(seed, n + 1))


def test_noise_of_a_sensor_is_told_from_errors_that_last_and_from_random_pushes():
    lasting = 20 * np.sin(np.arange(N) / 50)
    assert noisy(sensor(0))
    assert not noisy(lasting) and not noisy(np.full(N, 0.5)) and not noisy(white(1))


def test_changes_across_two_segments_are_none():
    errors = np.tile([1.0, 1.0, 1.0, -2.0, -2.0, -2.0], 10)  # within each segment nothing changes
    assert not noisy(errors, segments=np.arange(60) // 3)
    alternating = np.tile([1.0, -1.0], 30)
    assert noisy(alternating) and not noisy(alternating, segments=np.arange(60))


@pytest.mark.parametrize(("w", "damping", "dt"), [(8.0, 0.4, 0.25), (8.0, 0.7, 0.1875), (8.0, 0.4, 0.05)])
def test_a_clean_log_with_long_steps_and_an_input_that_jumps_at_each_is_not_noisy(w, damping, dt):
    """The motion is that of a'' = w^2 (u - a) - 2 damping w a', by its matrix exponential."""
    step = expm(dt * np.array([[0, 1, 0], [-(w**2), -2 * damping * w, w**2], [0, 0, 0]]))
    rng, x = np.random.default_rng(0), [np.zeros(2)]
    u = rng.uniform(-1, 1, 600)
    for held in u:
        x.append((step @ [*x[-1], held])[:2])
    signature = Signature(("a", "b"), ("m", "m/s"), ("u",), (1.0, w))
    model = SindyModel(signature, ["a", "b", "u"], Regression("bic"), Refinement("auto"), known={"a": "b"})
    found = model.fit(Transitions.from_trajectory(torch.from_numpy(np.array(x)), torch.from_numpy(u)[:, None], dt))
    assert model.delay == 0 and "fit.single_steps" in [each.code for each in found.findings]
    assert model.coefficients[:, 1].tolist() == pytest.approx([-(w**2), -2 * damping * w, w**2], rel=1e-5)
