"""Statistics over seeds against SciPy and against known sampling distributions."""

import numpy as np
import pytest
import torch
from scipy import stats

from dynasindy.evaluation.statistics import bootstrap_interval, interquartile_mean


@pytest.mark.parametrize("n", [1, 3, 4, 10, 13])
def test_interquartile_mean_is_scipy_trimmed_mean(n: int) -> None:
    values = torch.randn(5, n, dtype=torch.float64, generator=torch.Generator().manual_seed(n))
    expected = stats.trim_mean(values.numpy(), 0.25, axis=-1)
    np.testing.assert_allclose(interquartile_mean(values).numpy(), expected, rtol=1e-12)


def test_interquartile_mean_ignores_one_wild_seed() -> None:
    assert interquartile_mean(torch.tensor([1.0, 2.0, 3.0, 1e9])).item() == 2.5


def test_interval_of_a_mean_matches_the_normal_theory() -> None:
    scores = torch.randn(400, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    low, high = bootstrap_interval(scores, statistic=lambda x: x.mean(-1), resamples=4000)
    half = 1.96 * scores.std() / 20
    assert low.item() == pytest.approx((scores.mean() - half).item(), abs=0.012)
    assert high.item() == pytest.approx((scores.mean() + half).item(), abs=0.012)


def test_resampling_stays_within_each_task() -> None:
    # Two tasks of different scale without spread over seeds: stratified resampling leaves nothing to vary.
    scores = torch.tensor([[0.0, 100.0]]).expand(6, 2)
    low, high = bootstrap_interval(scores)
    assert low == high == 50.0


def test_interval_is_seeded_and_leaves_the_global_generator_alone() -> None:
    scores = torch.rand(8, 3, generator=torch.Generator().manual_seed(1))
    before = torch.random.get_rng_state()
    assert bootstrap_interval(scores, seed=4) == bootstrap_interval(scores, seed=4)
    assert bootstrap_interval(scores, seed=4) != bootstrap_interval(scores, seed=5)
    assert torch.equal(before, torch.random.get_rng_state())


def test_interval_works_along_a_learning_curve() -> None:
    curve = torch.rand(7, 5, 1, generator=torch.Generator().manual_seed(2))
    low, high = bootstrap_interval(curve)
    middle = interquartile_mean(curve.flatten(-2))
    assert low.shape == high.shape == (7,)
    assert ((low <= middle) & (middle <= high)).all()


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="confidence is 95"):
        bootstrap_interval(torch.zeros(3, 1), confidence=95)
    with pytest.raises(ValueError, match="n_seeds, n_tasks"):
        bootstrap_interval(torch.zeros(3))
