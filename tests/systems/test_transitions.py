"""Transitions keep rows in order and know which of them follow each other."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from dynasindy.systems.transitions import Transitions


def _line(n: int, start: float = 0.0) -> Transitions:
    x = (start + torch.arange(n + 1.0, dtype=torch.float64)).unsqueeze(-1)
    return Transitions.from_trajectory(x, torch.zeros(n, 1, dtype=torch.float64), 0.1)


def _periods(start, u, samples) -> TensorDict:
    n = samples.shape[:-2].numel()
    following = {"samples": samples.flatten(0, -3), "at_stop": torch.zeros(n, 1, dtype=torch.bool)}
    return TensorDict(
        {"state": start.reshape(n, -1), "action": u.reshape(n, -1), "next": TensorDict(following, [n])}, [n]
    )


def test_batches_of_episodes_are_laid_end_to_end_as_a_loop_would():
    rng = torch.Generator().manual_seed(0)
    samples = torch.randn(2, 3, 4, 5, generator=rng, dtype=torch.float64)
    start = torch.cat([torch.randn(2, 1, 5, generator=rng, dtype=torch.float64), samples[:, :-1, -1]], 1)
    u = torch.randn(2, 3, 2, generator=rng, dtype=torch.float64)
    data = Transitions.from_periods(_periods(start, u, samples), 0.02)
    row = 0
    for episode in range(2):
        state = start[episode, 0]
        for period in range(3):
            for sample in samples[episode, period]:
                assert torch.equal(data.x[row], state) and torch.equal(data.x_next[row], sample)
                assert torch.equal(data.u[row], u[episode, period]) and data.segment[row] == episode
                state, row = sample, row + 1
    assert len(data) == row == 24 and data.dt == 0.02


def test_one_state_that_differs_breaks_a_stretch():
    start = torch.tensor([[0.0, 0.0], [1.0, 9.0], [2.0, 2.0]])
    rows = _periods(start, torch.zeros(3, 1), torch.tensor([[[1.0, 1.0]], [[2.0, 2.0]], [[3.0, 3.0]]]))
    assert Transitions.from_periods(rows, 0.1).segment.tolist() == [0, 1, 1]


def test_rows_kept_of_several_stretches_stay_apart_where_they_were_apart():
    both = Transitions.cat([_line(3), _line(3, start=9.0), _line(2, start=20.0)])
    assert both.segment.tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    kept = both.select(torch.tensor([True, True, True, True, False, True, True, True]))
    assert kept.segment.tolist() == [0, 0, 0, 1, 2, 3, 3]
    assert kept.x_next.squeeze(-1).tolist() == [1, 2, 3, 10, 12, 21, 22]


def test_joining_keeps_rows_inputs_and_rate_and_passes_over_an_empty_recording():
    empty = _line(2).select(torch.tensor([False, False]))
    first = Transitions.from_trajectory(torch.tensor([[0.0], [1.0]]).double(), torch.tensor([[0.5]]).double(), 0.1)
    both = Transitions.cat([first, empty, _line(2, start=5.0)])
    assert both.x.squeeze(-1).tolist() == [0, 5, 6] and both.x_next.squeeze(-1).tolist() == [1, 6, 7]
    assert both.u.squeeze(-1).tolist() == [0.5, 0, 0] and both.dt == 0.1
    assert both.segment.tolist() == [0, 1, 1]
    for refused, why in (([], "empty list"), ([first, replace(first, dt=0.2)], "sampling times")):
        with pytest.raises(ValueError, match=why):
            Transitions.cat(refused)


def test_rows_of_several_segments_know_where_theirs_begins_which_input_comes_next_and_which_are_taken_together():
    parts = [replace(_line(n), u=100.0 * n + torch.arange(float(n)).double().unsqueeze(-1)) for n in (3, 2, 1, 4)]
    data = Transitions.cat(parts)
    starts = [0, 0, 0, 3, 3, 5, 6, 6, 6, 6]
    assert data.segment_starts().tolist() == starts
    assert data.begins().tolist() == [k == start for k, start in enumerate(starts)]
    ends = [301.0, 302.0, 302.0, 201.0, 201.0, 100.0, 401.0, 402.0, 403.0, 403.0]
    assert data.with_linear_inputs().u_end.flatten().tolist() == ends
    pairs = data.decimate(2)
    assert pairs.dt == 0.2 and pairs.x.flatten().tolist() == [0, 0, 0, 2]
    assert pairs.x_next.flatten().tolist() == [2, 2, 2, 4] and pairs.segment.tolist() == [0, 1, 3, 3]
    assert pairs.u.flatten().tolist() == [300.5, 200.5, 400.5, 402.5]
    moving = data.with_linear_inputs().decimate(2)
    assert torch.cat([moving.u, moving.u_end], 1).tolist() == [[300, 302], [200, 201], [400, 402], [402, 403]]
