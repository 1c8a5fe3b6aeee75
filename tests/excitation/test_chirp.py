"""The sweep that is meant sweeps; the one that is printed does not."""

import math

import pytest
import torch

from dynasindy.excitation import Chirp, PrintedChirp, SquaredChirp


def test_the_sweep_is_cos_pi_t_squared_over_t_up_to_its_phase():
    chirp = Chirp(3, duration=10.0, amplitude=1.0)
    t = torch.linspace(0, 10, 101, dtype=torch.float64)
    assert torch.allclose(chirp.signal(t)[:, 0], torch.cos(math.pi * t**2 / 10 - math.pi / 2))
    assert torch.allclose(chirp.signal(t)[:, 1], torch.cos(0.7 * math.pi * t**2 / 10))


def test_the_printed_form_stays_within_0_707_and_1():
    u = PrintedChirp(2, amplitude=1.0).samples(0.01)
    assert math.isclose(float(u.min()), math.cos(math.pi / 4), abs_tol=1e-6)
    assert torch.equal(u[:, 0], u[:, 1])


def test_the_squared_form_is_never_negative():
    u = SquaredChirp(2, amplitude=1.0).samples(0.01)
    assert float(u.min()) >= 0
    assert 0.49 < float(u.max()) <= 0.5


def test_a_sweep_is_its_formula_in_plain_numbers():
    chirp = Chirp(3, duration=8.0, band=(0.2, 1.5), amplitude=1.0)
    for t in (0.0, 1.3, 7.7):
        given = chirp.signal(torch.tensor(t, dtype=torch.float64)).tolist()
        for i, (stop, phase) in enumerate(((1.5, -math.pi / 2), (1.05, 0.0), (1.5, math.pi / 2))):
            turns = 0.2 * t + (stop - 0.2) * t * t / 16
            assert math.isclose(given[i], math.cos(2 * math.pi * turns + phase), abs_tol=1e-12)


def test_the_printed_and_the_squared_form_are_their_formulas():
    t = torch.tensor([0.0, 2.0, 9.0], dtype=torch.float64)
    printed = PrintedChirp(2, duration=10.0, amplitude=1.0).signal(t)
    expected = [math.cos(math.pi * share * (1 - share)) for share in (0.0, 0.2, 0.9)]
    assert torch.allclose(printed, torch.tensor(expected, dtype=torch.float64).unsqueeze(-1).expand(3, 2), atol=1e-12)
    squared = SquaredChirp(2, amplitude=1.0).signal(t)
    assert torch.allclose(squared, 0.5 * Chirp(2, amplitude=1.0).signal(t) ** 2, atol=1e-12)


@pytest.mark.parametrize("band", [(0.1,), (0.1, 0.2, 0.3), (-0.1, 1.0)])
def test_a_band_is_two_frequencies_from_zero_on(band):
    with pytest.raises(ValueError, match="chirp"):
        Chirp(1, band=band)
    assert Chirp(1, band=(0.0, 0.0)).start == 0.0
