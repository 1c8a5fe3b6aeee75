"""What is missing from a library is named."""

import numpy as np
import pytest
import torch

from dynasindy.data.simulated import record
from dynasindy.excitation import Multisine
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.diagnosis import diagnose
from dynasindy.sindy.library import Library, of
from dynasindy.sindy.regression import simpson_form
from dynasindy.systems.base import Signature, System


class _Slide(System):
    """A mass with Coulomb friction: v' = u - 0.2 v - 0.3 sign(v)."""

    def __init__(self):
        super().__init__(Signature(("s", "v"), ("m", "m/s"), ("u",), (1.0, 1.0)))

    def forward(self, x, u):
        return torch.stack([x[..., 1], u[..., 0] - 0.2 * x[..., 1] - 0.3 * torch.tanh(20 * x[..., 1])], -1)


def _fitted(library):
    data = record(_Slide(), Multisine(1, 20.0, amplitude=0.9, seed=2).samples(0.01), 0.01)
    model = SindyModel(_Slide().signature, library, Regression("bic"), Refinement())
    model.fit(data)
    return model, data


def test_friction_that_no_function_holds_is_named():
    model, data = _fitted(["s", "v", "u"])
    (missing,) = diagnose(model, data)
    assert missing.state == "v"
    assert missing.function == "tanh(20 v)"
    assert missing.share > 0.9
    assert "tanh(20 v)" in str(missing)


def test_a_complete_library_has_nothing_missing():
    assert diagnose(*_fitted(["s", "v", "u", "tanh(20 v)"])) == []


def test_the_share_is_that_of_numpy_s_least_squares_on_what_the_model_leaves():
    model, data = _fitted(["s", "v", "u"])
    (missing,) = diagnose(model, data)
    theta, dx = (part.numpy() for part in simpson_form(model.library, model, data))
    error = dx[:, 1] - theta @ model.coefficients[:, 1].numpy()
    assert missing.unexplained == pytest.approx(np.linalg.norm(error) / np.linalg.norm(dx[:, 1]), rel=1e-9)

    def left(columns):
        return np.sum((error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]) ** 2)

    active = theta[:, model.coefficients[:, 1].numpy() != 0]
    friction = Library(model.signature, [of("tanh", "v", frequency=20.0)])
    column = simpson_form(friction, model, data)[0].numpy()
    assert missing.share == pytest.approx(1 - left(np.hstack([active, column])) / left(active), rel=1e-6)


def test_an_equation_is_complete_below_the_least_part():
    model, data = _fitted(["s", "v", "u"])
    (missing,) = diagnose(model, data)
    assert diagnose(model, data, least=1.001 * missing.unexplained) == []
    assert diagnose(model, data, least=0.999 * missing.unexplained) == [missing]
