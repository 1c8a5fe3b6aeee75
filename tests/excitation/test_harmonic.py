"""Harmonic signals hold the frequencies they were given, and inputs share none."""

import torch

from dynasindy.excitation import Multisine, Sphs


def _lines(u: torch.Tensor) -> list[set[int]]:
    power = torch.fft.rfft(u, dim=0).abs()
    return [set((power[:, i] > 1e-6 * power.max()).nonzero().flatten().tolist()) for i in range(u.shape[1])]


def test_harmonics_of_the_inputs_interleave():
    first, second = _lines(Sphs(2, duration=10.0, harmonics=4, amplitude=1.0).samples(0.01))
    assert first == {1, 3, 5, 7}
    assert second == {2, 4, 6, 8}


def test_schroeder_phases_make_a_smaller_peak_than_equal_phases():
    signal = Sphs(1, harmonics=16, amplitude=1.0)
    crest_of_equal_phases = (2 * 16) ** 0.5
    u = signal.samples(0.001)
    crest = float(u.abs().max() / u.square().mean().sqrt())
    assert crest < 0.4 * crest_of_equal_phases


def test_a_multisine_uses_its_whole_range():
    u = Multisine(2, amplitude=1.0, seed=5).samples(0.001)
    assert bool((u.abs().amax(0) > 0.98).all())
