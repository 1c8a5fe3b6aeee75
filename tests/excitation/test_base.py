"""Every excitation keeps its levels, is a policy, and moves its inputs apart."""

import math

import pytest
import torch
from tensordict import TensorDict

from dynasindy.excitation import Chirp, HeldRandom, Multisine, Prbs, PrintedChirp, Sphs, SquaredChirp

MOVING = [Chirp, HeldRandom, Multisine, Prbs, Sphs, SquaredChirp]


@pytest.mark.parametrize("kind", [*MOVING, PrintedChirp])
def test_signals_stay_within_offset_and_amplitude(kind):
    u = kind(2, amplitude=(0.3, 0.2), offset=(-0.1, 0.3)).samples(0.01)
    assert u.shape == (1000, 2)
    assert bool(((u - torch.tensor([-0.1, 0.3])).abs() <= torch.tensor([0.3, 0.2]) + 1e-6).all())


@pytest.mark.parametrize("kind", MOVING)
def test_inputs_are_told_apart(kind):
    """The same signal on two inputs would be correlated by 1."""
    u = kind(2, amplitude=0.5).samples(0.01)
    assert abs(torch.corrcoef(u.mT)[0, 1]) < 0.5


@pytest.mark.parametrize("kind", MOVING)
def test_as_a_policy_it_reads_the_step_count_and_holds_the_input(kind):
    excitation = kind(2, duration=4.0, dt=0.05)
    out = excitation(TensorDict({"step_count": torch.tensor([[0], [7]])}, batch_size=[2]))
    assert out["action"].dtype == torch.float32
    assert torch.allclose(out["action"].double(), excitation.samples()[[0, 7]], atol=1e-7)
    assert excitation.n_steps == 80


def test_levels_beyond_the_range_are_clipped():
    assert float(Chirp(1, amplitude=0.8, offset=0.6).samples().max()) == 1.0


def test_the_seed_makes_the_signal():
    first, again, other = (Multisine(2, seed=s).samples() for s in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.allclose(first, other)


@pytest.mark.parametrize(
    "settings",
    [{"duration": -1.0}, {"dt": 0.0}, {"amplitude": (0.1, 0.2, 0.3)}, {"offset": (1.5, 0.0)}, {"amplitude": math.nan}],
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(ValueError, match="excitation got"):
        Chirp(2, **settings)


def test_an_input_number_of_zero_is_refused():
    with pytest.raises(ValueError, match="0 inputs"):
        Chirp(0)


def test_negative_bands_no_harmonics_and_no_hold_are_refused():
    with pytest.raises(ValueError, match="band"):
        Chirp(1, band=(0.0, -1.0))
    with pytest.raises(ValueError, match="0 harmonics"):
        Sphs(1, harmonics=0)
    with pytest.raises(ValueError, match="hold"):
        Prbs(1, hold=math.nan)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Chirp(2, 1e15),
        lambda: Chirp(2, 10.0, 1e-15),
        lambda: HeldRandom(2, hold=1e-15),
        lambda: Sphs(2, harmonics=10**12),
        lambda: Chirp(2).samples(1e-15),
    ],
)
def test_experiments_that_memory_cannot_hold_are_refused(make):
    with pytest.raises(ValueError, match=r"excitation\.duration=.* would take .* GB; allowed is"):
        make()
