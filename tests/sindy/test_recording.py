"""What is left of a recording for a fit: rows whose inputs are known, and no more than a regression needs."""

import numpy as np
import torch

from dynasindy.sindy.reconstruction import BRIEF, DelayedRecording
from dynasindy.systems.transitions import Transitions


def recorded(n: int) -> DelayedRecording:
    """Return a counter as state and input, a tenth of a second between samples, whose inputs may act 0.5 s later."""
    count = torch.arange(n + 1, dtype=torch.float64)[:, None]
    data = Transitions.from_trajectory(count, count[:-1], 0.1)
    return DelayedRecording.of(data, data, {}, 0.5)


def test_rows_are_read_under_the_inputs_of_before_from_the_first_one_that_knows_them():
    seen = recorded(20).measured(0.3)
    np.testing.assert_allclose(seen.x[:, 0], np.arange(5, 20))
    np.testing.assert_allclose(seen.u[:, 0], np.arange(2, 17), atol=1e-9)


def test_a_long_recording_is_cut_to_stretches_and_a_short_one_stays():
    short, long = recorded(100), recorded(3 * BRIEF)
    assert short.brief(0.5) is short
    brief = long.brief(0.5)
    assert len(brief.data) == BRIEF and len(brief.data.segment.unique()) == 10
    assert int((~brief.known).sum()) == 10 * 5, "five rows of each stretch do not know the input of 0.5 s before"


def test_a_recording_that_is_called_noisy_is_guessed_smoother_and_stays_so_when_cut():
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=(3 * BRIEF + 1, 1)))
    data = Transitions.from_trajectory(noise, noise[:-1], 0.1)
    smooth = DelayedRecording.of(data, data, {}, 0.0).smoothed()
    assert float(smooth.guess.x.std()) < 0.5 * float(data.x.std()) and smooth.brief(0.0).noisy
    jumping = DelayedRecording.of(data, data, {}, 0.0)
    assert jumping.smoothed(0.1) is jumping  # a difference equation may jump as noise does
