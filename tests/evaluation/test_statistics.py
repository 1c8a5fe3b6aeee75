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


def test_interval_is_scipy_s_percentile_bootstrap() -> None:
    scores = np.random.default_rng(4).gamma(2.0, size=20)

    def middle(x: np.ndarray, axis: int = -1) -> np.ndarray:
        return stats.trim_mean(x, 0.25, axis=axis)

    theirs = stats.bootstrap(
        (scores,), middle, confidence_level=0.8, n_resamples=20_000, method="percentile", random_state=0
    ).confidence_interval
    low, high = bootstrap_interval(torch.from_numpy(scores).unsqueeze(-1), confidence=0.8, resamples=20_000)
    width = theirs.high - theirs.low
    assert low.item() == pytest.approx(theirs.low, abs=0.03 * width)
    assert high.item() == pytest.approx(theirs.high, abs=0.03 * width)


@pytest.mark.parametrize(("confidence", "interval"), [(0.45, (0.5, 0.5)), (0.55, (0.0, 1.0))])
def test_of_two_seeds_the_mean_is_at_each_end_in_a_quarter_of_the_resamples(confidence, interval) -> None:
    found = bootstrap_interval(torch.tensor([[0.0], [1.0]]), lambda x: x.mean(-1), confidence, resamples=10_000)
    assert (found[0].item(), found[1].item()) == interval


def test_by_default_two_thousand_resamples_give_95_percent() -> None:
    scores = torch.rand(9, 2, generator=torch.Generator().manual_seed(0))
    assert bootstrap_interval(scores) == bootstrap_interval(scores, interquartile_mean, 0.95, 2000, 0)
