"""Transitions keep rows in order and know which of them follow each other."""

import pytest
import torch

from dynasindy.systems.transitions import Transitions


def _line(n: int, start: float = 0.0) -> Transitions:
    x = (start + torch.arange(n + 1.0, dtype=torch.float64)).unsqueeze(-1)
    return Transitions.from_trajectory(x, torch.zeros(n, 1, dtype=torch.float64), 0.1)


def test_trajectory_rows_follow_each_other():
    data = _line(5)
    assert len(data) == 5
    assert torch.equal(data.x_next[:-1], data.x[1:])
    assert data.segment.unique().tolist() == [0]


def test_an_input_for_every_state_is_allowed_and_the_last_one_not_used():
    data = Transitions.from_trajectory(torch.zeros(4, 2), torch.zeros(4, 1), 0.1)
    assert data.u.shape == (3, 1)


def test_a_gap_begins_a_new_segment():
    kept = _line(6).select(torch.tensor([True, True, False, True, True, True]))
    assert kept.segment.tolist() == [0, 0, 1, 1, 1]
    assert kept.x.squeeze(-1).tolist() == [0, 1, 3, 4, 5]


def test_joined_recordings_stay_apart():
    both = Transitions.cat([_line(2), _line(3, start=9.0)])
    assert both.segment.tolist() == [0, 0, 1, 1, 1]


def test_samples_within_control_periods_become_fine_transitions():
    start = torch.tensor([[0.0], [2.0], [7.0]])
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [4.0]], [[8.0], [9.0]]])
    data = Transitions.from_samples(start, torch.tensor([[0.1], [0.2], [0.3]]), samples, 0.01)
    assert data.x.squeeze(-1).tolist() == [0, 1, 2, 3, 7, 8]
    assert data.x_next.squeeze(-1).tolist() == [1, 2, 3, 4, 8, 9]
    assert data.segment.tolist() == [0, 0, 0, 0, 1, 1]
    assert torch.allclose(data.u.squeeze(-1), torch.tensor([0.1, 0.1, 0.2, 0.2, 0.3, 0.3]))


def test_last_keeps_the_newest_rows():
    assert _line(5).last(2).x.squeeze(-1).tolist() == [3, 4]


@pytest.mark.parametrize("dt", [0.0, -0.1])
def test_a_sampling_time_that_is_not_positive_is_refused(dt):
    with pytest.raises(ValueError, match="dt > 0"):
        Transitions.from_trajectory(torch.zeros(3, 1), torch.zeros(2, 1), dt)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="shapes"):
        Transitions(torch.zeros(3, 2), torch.zeros(4, 1), torch.zeros(3, 2), 0.1, torch.zeros(3, dtype=torch.int64))


def test_recordings_of_different_rates_are_not_joined():
    slow = Transitions.from_trajectory(torch.zeros(3, 1), torch.zeros(2, 1), 0.2)
    with pytest.raises(ValueError, match="sampling times"):
        Transitions.cat([_line(2), slow])
