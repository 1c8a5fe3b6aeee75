"""Code of a sparse model is that of its equations as they are now."""

import pytest
import torch

from dynasindy.systems import Xi, integrate
from dynasindy.systems.compiler import compiler
from dynasindy.world_models import SindyModel


def drawn(rows=5):
    rng = torch.Generator().manual_seed(0)
    x = torch.randn(rows, 6, generator=rng, dtype=torch.float64) * torch.tensor(Xi().signature.x_scale).double()
    return x, 2 * torch.rand(rows, 2, generator=rng, dtype=torch.float64) - 1


def model(factor=1.0, **given):
    found, (x, u) = SindyModel(Xi().signature, **given), drawn(400)
    found.fit_derivatives(x, u, Xi()(x, u))
    found.set_coefficients(factor * found.coefficients)
    return found


@pytest.mark.parametrize("machine_code", [False, True])
def test_a_model_moves_by_its_coefficients_as_they_are_now(machine_code):
    """The oracle is the library times the coefficients, integrated by torch."""
    found, (x, u) = model(machine_code=machine_code), drawn()
    assert (found.compiled(x, u) is None) == (not machine_code or compiler() is None)

    def _change(k):
        if k == 1:
            found.set_coefficients(2.0 * found.coefficients)
        elif k == 2:
            found.coefficients[0] = 0.5  # in place
        elif k == 3:
            found.load_state_dict(model(3.0).state_dict())

    for k in range(4):
        _change(k)
        wanted, _ = integrate(lambda x, u: found.library(x, u) @ found.coefficients, x, u, 0.05, 2)
        torch.testing.assert_close(integrate(found, x, u, 0.05, 2)[0], wanted, rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(found(x, u), found.library(x, u) @ found.coefficients, rtol=1e-9, atol=1e-12)


def test_coefficients_that_are_not_finite_are_refused_by_all_code():
    found, (x, u) = model(), drawn()
    found.coefficients[2, 1] = torch.nan
    for _ in range(2):
        with pytest.raises(ValueError, match="1 coefficients are not finite"):
            found.compiled(x, u)
        with pytest.raises(ValueError, match="1 coefficients are not finite"):
            found(x, u)
