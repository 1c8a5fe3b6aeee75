"""The sweep that is meant sweeps; the one that is printed does not."""

import math

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
