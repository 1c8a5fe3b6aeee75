"""Bagging gives the spread that repeated experiments would give, and the same one for the same seed."""

import pytest
import torch

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models import Regression, SindyModel
from dynasindy.world_models.ensemble import bag

SIGNATURE = Signature(("a",), ("-",), ("u",), (1.0,))
NOISE, N = 0.05, 1000


def _data(seed: int) -> Transitions:
    """a' = -a + 2 u, with independent errors of the change, so that least squares is unbiased."""
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(N, 1, generator=generator, dtype=torch.float64)
    u = torch.randn(N, 1, generator=generator, dtype=torch.float64)
    change = -x + 2 * u + NOISE * torch.randn(N, 1, generator=generator, dtype=torch.float64)
    return Transitions(x, u, x + 1e-4 * change, 1e-4, torch.arange(N))


def _model(data: Transitions) -> SindyModel:
    model = SindyModel(SIGNATURE, ["a", "u", "a^2"], Regression("bic"))
    model.fit(data)
    return model


def test_the_spread_is_that_of_the_textbook():
    """Independent regressors of unit variance: standard error = noise / sqrt(N)."""
    data = _data(0)
    ensemble = bag(_model(data), data, n_members=200, seed=1)
    assert ensemble.spread[:2, 0].tolist() == pytest.approx([NOISE / N**0.5] * 2, rel=0.4)
    assert ensemble.median[:2, 0].tolist() == pytest.approx([-1.0, 2.0], abs=0.01)


def test_functions_that_do_not_belong_are_rarely_used():
    data = _data(3)
    ensemble = bag(_model(data), data, n_members=50, seed=1)
    assert ensemble.inclusion[0, 0] == 1.0
    assert ensemble.inclusion[2, 0] < 0.6
    assert ensemble.consensus()[2, 0] == 0.0


def test_the_seed_makes_the_ensemble():
    data = _data(0)
    first, again, other = (bag(_model(data), data, 5, seed=s).members for s in (4, 4, 5))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_no_members_or_too_few_transitions_are_refused():
    data = _data(0)
    with pytest.raises(ValueError, match="0 members"):
        bag(_model(data), data, n_members=0)
    with pytest.raises(ValueError, match="25 blocks of 10 transitions"):
        bag(_model(data), data.last(10))
