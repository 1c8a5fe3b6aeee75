"""Switching signals hold their levels and jump at different times on different inputs."""

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
