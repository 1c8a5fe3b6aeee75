"""Harmonic signals hold the frequencies they were given, and inputs share none."""

import numpy as np
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


def test_schroeders_sum_is_its_formula_in_plain_numbers():
    """K = 3 harmonics of each of two inputs: 1, 3, 5 and 2, 4, 6 turns in 4 s, divided by the peak."""
    t = np.linspace(0, 4, 20001)
    given = Sphs(2, duration=4.0, harmonics=3, amplitude=1.0).signal(torch.from_numpy(t)).numpy()
    for column, numbers in enumerate(((1, 3, 5), (2, 4, 6))):
        phases = [2 * np.pi / 3 * i * (i + 1) / 2 for i in (1, 2, 3)]
        bare = sum(np.cos(2 * np.pi * n * t / 4 + phase) for n, phase in zip(numbers, phases, strict=True))
        np.testing.assert_allclose(given[:, column], bare / np.abs(bare).max(), atol=1e-5)
    assert np.abs(given).max() <= 1


def test_a_multisine_has_lines_of_one_height_and_phases_all_around():
    u = Multisine(2, duration=10.0, harmonics=4, amplitude=1.0, seed=3).samples(0.01)
    power = torch.fft.rfft(u, dim=0).abs()
    for column, lines in enumerate(([1, 3, 5, 7], [2, 4, 6, 8])):
        heights = power[lines, column]
        assert bool((heights / heights.mean() - 1 < 1e-6).all())
        assert (power[:, column] > 1e-6 * heights.max()).nonzero().flatten().tolist() == lines
    many = Multisine(2, harmonics=2000, seed=0).phases
    assert bool((many >= 0).all()) and float(many.max()) > 6.2 and abs(float(many.mean()) - torch.pi) < 0.1
    assert abs(float(torch.corrcoef(many.mT)[0, 1])) < 0.06


def test_eight_harmonics_and_one_at_least():
    assert Sphs(1).phases.shape == (8, 1) and Sphs(1, harmonics=1).phases.shape == (1, 1)
