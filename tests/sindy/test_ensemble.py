"""Bagging gives the spread that repeated experiments would give, and the same one for the same seed."""

import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.ensemble import Ensemble, bag
from dynasindy.sindy.regression import RunningSums, simpson_form
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

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


def test_median_spread_inclusion_and_consensus_of_five_members():
    values = torch.tensor([[3.0, 0.0], [1.0, 2.0], [2.0, 0.0], [5.0, 0.0], [4.0, 4.0]], dtype=torch.float64)
    ensemble = Ensemble(values.unsqueeze(1))
    assert ensemble.median.tolist() == [[3.0, 0.0]] and ensemble.inclusion.tolist() == [[1.0, 0.4]]
    assert ensemble.spread.flatten().tolist() == pytest.approx([2.5**0.5, 3.2**0.5])
    values[0, 1] = 1.0  # three of five: 0, 0, 1, 2, 4
    shared = Ensemble(values.unsqueeze(1))
    assert shared.consensus().tolist() == [[3.0, 1.0]] and shared.consensus(0.61).tolist() == [[3.0, 0.0]]


@pytest.mark.parametrize("refinement", [None, Refinement(tolerance=1e-3)])
def test_members_are_the_fits_to_the_blocks_that_were_drawn(refinement):
    data = _data(2)
    model = SindyModel(SIGNATURE, ["a", "u", "a^2"], Regression(threshold=0.0), refinement, fixed={"a": {"u": 1.5}})
    model.fit(data)
    found = bag(model, data, n_members=3, blocks=4, seed=9)
    theta, dx = simpson_form(model.library, model, data)
    generator = torch.Generator().manual_seed(9)
    for member in found.members:
        rows = torch.cat([torch.arange(250) + 250 * k for k in torch.randint(4, (4,), generator=generator).tolist()])
        sums = RunningSums(3, 1)
        sums.add((theta[rows], dx[rows]))
        rule = model.regression if refinement is None else Regression("bic", tolerance=1e-3)
        expected = rule.solve(sums, model.constraints.free, model.constraints.offset)
        assert torch.equal(member != 0, expected != 0)
        torch.testing.assert_close(member, expected, rtol=1e-8, atol=1e-10)


def test_one_member_two_blocks_and_as_many_transitions_are_enough():
    data = _data(0)
    assert len(bag(_model(data), data.last(2), n_members=1, blocks=2).members) == 1
    with pytest.raises(ValueError, match="1 blocks of 1000"):
        bag(_model(data), data, n_members=1, blocks=1)
