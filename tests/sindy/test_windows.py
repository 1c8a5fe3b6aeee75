"""A recording is cut into windows: whole segments, what was not measured masked."""

import pytest
import torch

from dynasindy.sindy.windows import Windows
from dynasindy.systems.transitions import Transitions


def test_windows_cut_every_segment_and_mask_what_is_filled_up():
    x = torch.arange(8.0).unsqueeze(-1)
    one = Transitions.from_trajectory(x, 10 * x[:7], 0.1)
    windows = Windows.of(Transitions.cat([one, one.last(2)]), 3)
    assert windows.first.flatten().tolist() == [0, 3, 6, 5]
    assert windows.joined.tolist() == [False, True, True, False]
    assert windows.mask[..., 0].tolist() == [[1, 1, 1], [1, 1, 1], [1, 0, 0], [1, 1, 0]]
    assert windows.measured[windows.mask.bool()].tolist() == [1, 2, 3, 4, 5, 6, 7, 6, 7]
    assert windows.inputs[windows.mask.bool()].tolist() == [0, 10, 20, 30, 40, 50, 60, 50, 60]


def recording() -> Transitions:
    """Two states over eight transitions in two segments of five and three, some samples lost."""
    x = torch.arange(20.0).reshape(10, 2)
    x[2, 0] = x[3, 1] = torch.nan
    u = 100 + torch.arange(10.0).unsqueeze(-1)
    parts = [Transitions.from_trajectory(x[k:m], u[k:m], 0.1) for k, m in ((0, 6), (6, 10))]
    return Transitions.cat(parts)


def test_lost_samples_are_zeros_that_count_nothing():
    windows = Windows.of(recording(), 2)
    assert windows.rows.tolist() == [0, 2, 4, 5, 7]
    # What is lost: the first state two samples after the start, the second one three.
    assert windows.mask[..., 0].tolist() == [[1, 0], [1, 1], [1, 0], [1, 1], [1, 0]]
    assert windows.mask[..., 1].tolist() == [[1, 1], [0, 1], [1, 0], [1, 1], [1, 0]]
    assert windows.measured[0].tolist() == [[2, 3], [0, 5]] and windows.measured[1].tolist() == [[6, 0], [8, 9]]
    assert windows.measured[3].tolist() == [[14, 15], [16, 17]]
    assert windows.first.isnan().tolist() == [[False, False], [True, False], [False, False], [False] * 2, [False] * 2]
    assert windows.first[[0, 2, 3, 4]].tolist() == [[0, 1], [8, 9], [12, 13], [16, 17]]


@pytest.mark.parametrize("joined", [True, False])
def test_a_window_joins_the_one_before_within_its_segment_alone(joined):
    windows = Windows.of(recording(), 2, joined, 3)
    assert windows.joined.tolist() == [False, joined, joined, False, joined]
    assert windows.inputs[..., 0].tolist() == [[100, 101], [102, 103], [104, 104], [106, 107], [108, 108]]
    assert (len(windows), windows.dt, windows.substeps) == (5, 0.1, 3)


def test_states_that_begin_and_end_with_the_recording_are_masked_where_they_are_filled_up():
    windows = Windows.of(recording(), 100)
    assert windows.mask.shape == (2, 100, 2) and windows.mask.sum((0, 1)).tolist() == [7, 7]
    assert not bool(windows.mask[0, 5:].any()) and not bool(windows.mask[1, 3:].any())
