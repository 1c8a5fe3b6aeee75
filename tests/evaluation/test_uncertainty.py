"""Coefficients are drawn, and what becomes of the loop is what paper says."""

import math

import numpy as np
import pytest
import torch

from dynasindy.evaluation.check import _spread, _variants
from dynasindy.evaluation.linear_loop import find_rest
from dynasindy.sindy import Refinement, SindyModel
from dynasindy.sindy.covariance import Covariance
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions


def test_coefficients_of_the_data_are_drawn_and_no_other(carts):
    model = carts(friction=0.5, spring=2.0)
    found = _variants(model, 4, 0)[0]
    share = (found[:, :, 1] / model.coefficients[:, 1] - 1).abs()
    assert 0 < float(share.max()) <= 0.05
    np.testing.assert_array_equal(found[:, :, 0], model.coefficients[:, 0].expand(4, -1))


def test_draws_spread_and_go_together_as_the_covariance_of_the_fit_says(carts):
    model = carts(friction=0.5, spring=2.0)
    assert _variants(model, 1, 1)[1] == "each within 5 % of itself, as the model tells no standard errors"
    wanted = torch.tensor([[0.01, -0.009], [-0.009, 0.04]], dtype=torch.float64)
    places = torch.tensor([1, 2]), torch.tensor([1, 1])  # friction and spring
    model.covariance = Covariance(*places, torch.linalg.cholesky(wanted))
    drawn, how = _variants(model, 4000, 1)
    np.testing.assert_allclose(torch.cov(drawn[:, 1:, 1].mT), wanted, rtol=0.1)
    assert drawn[:, 0].std(0).max() == drawn[:, :, 0].std(0).max() == 0  # what is known, and what was not fitted
    assert how == "from the covariance of the fit, with standard errors of 10 to 20 %"


@pytest.mark.parametrize("method", [None, "integral", "trajectory", "one_step"])
def test_equations_that_are_all_given_have_no_uncertainty(method):
    u = torch.rand(200, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    x = torch.cat([u[:1] * 0, (0.1 * u).cumsum(0)])
    data = Transitions(x[:-1], u, x[1:], 0.1, torch.zeros(200, dtype=torch.long))
    refinement = None if method is None else Refinement(method)
    plant = Signature(("a",), ("-",), ("u",), (1.0,))
    model = SindyModel(plant, ["a", "u"], known={"a": "u"}, refinement=refinement)
    assert model.fit(data).accuracy == [] and model.covariance is None and model.equations() == ["a' = u"]
    assert torch.equal(_variants(model, 3, seed=0)[0], model.coefficients.expand(3, 2, 1))


def test_error_and_eigenvalues_with_other_plants_are_those_of_paper(loops, carts):
    # Rest at p = 2 r b / (s + 2 b) with the force's coefficient b and the spring s.
    model = carts(spring=1.0)
    loop, r = loops(model=model), torch.tensor([[0.3], [0.0]])
    plants = [(1.2, 1.0), (0.8, 1.0), (1.0, 1.2), (1.0, 0.8)]
    xi = model.coefficients.expand(4, -1, -1).clone()
    xi[:, [0, 2], 1] *= torch.tensor(plants).double()
    found = _spread(loop, r, find_rest(loop, r), xi)
    for k, (b, s) in enumerate(plants):
        assert found.farthest[k].item() == pytest.approx(0.3 - 0.6 * b / (s + 2 * b), abs=1e-7)
        flow = torch.linalg.matrix_exp(0.1 * torch.tensor([[0.0, 1.0, 0.0], [-s, 0.0, b], [0.0, 0.0, 0.0]])).double()
        closed = flow[:2, :2].numpy() + flow[:2, 2:].numpy() @ np.array([[-2.0, -2.5]])
        assert found.worst[k].item() == pytest.approx(np.abs(np.linalg.eigvals(closed)).max(), abs=1e-5)
    none = _spread(loop, r[:0], find_rest(loop, r).select(torch.zeros(2, dtype=torch.bool)), xi)
    assert none.worst.tolist() == [math.inf] * 4  # no target is held
