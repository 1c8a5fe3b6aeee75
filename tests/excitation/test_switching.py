"""Switching signals hold their levels and jump at different times on different inputs."""

import pytest
import torch

from dynasindy.excitation import HeldRandom, Prbs


def test_levels_are_held_for_the_time_given():
    u = HeldRandom(2, duration=10.0, hold=0.5, amplitude=1.0, seed=1).samples(0.01)
    jumps = [(u[1:, i] != u[:-1, i]).nonzero().flatten() + 1 for i in range(2)]
    assert set(jumps[0].diff().tolist()) == {50}
    assert not set(jumps[0].tolist()) & set(jumps[1].tolist())


def test_a_binary_sequence_has_two_levels_and_both_occur():
    u = Prbs(1, amplitude=0.25, offset=0.5, hold=0.2, seed=2).samples()
    assert sorted(torch.unique(u).tolist()) == [0.25, 0.75]


def test_a_signal_is_the_loop_over_its_holds():
    """Input i jumps i / n_u of a hold earlier; every hold takes the next level."""
    held = HeldRandom(2, duration=3.0, hold=0.5, amplitude=1.0, seed=4)
    levels = held.levels
    assert levels.shape == (9, 2) and bool((levels.abs() <= 1).all()) and levels.unique().numel() == 18
    for step in range(60):
        t = 0.05 * step
        expected = [levels[int((step + 0.0001) / 10), 0].item(), levels[int((step + 5.0001) / 10), 1].item()]
        assert held.signal(torch.tensor(t, dtype=torch.float64)).tolist() == expected
    after = held.signal(torch.tensor([4.5, 0.0], dtype=torch.float64))
    assert torch.equal(after[0], after[1])  # nine levels of half a second, then again


def test_levels_fill_the_range_evenly_and_both_ends_come_as_often():
    uniform = HeldRandom(2, duration=1000.0, hold=0.5, seed=0).levels
    assert abs(float(uniform.mean())) < 0.03 and abs(float(uniform.std()) - 3**-0.5) < 0.02
    assert float(uniform.min()) < -0.99 and float(uniform.max()) > 0.99
    binary = Prbs(2, duration=1000.0, hold=0.5, seed=0).levels
    assert sorted(binary.unique().tolist()) == [-1.0, 1.0] and abs(float(binary.mean())) < 0.06
    for levels in (uniform, binary):
        assert abs(float(torch.corrcoef(levels.mT)[0, 1])) < 0.06


def test_half_a_second_is_held_by_default_and_a_time_must_be_positive():
    assert Prbs(1).hold == 0.5
    with pytest.raises(ValueError, match=r"hold 0.0 s"):
        Prbs(1, hold=0.0)
