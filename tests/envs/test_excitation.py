"""Every excitation keeps its levels, is a policy, and moves its inputs apart."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from dynasindy.envs import Aprbs, Chirp, Multisine

MOVING = [Chirp, Aprbs, Multisine]


@pytest.mark.parametrize("kind", MOVING)
def test_signals_stay_within_offset_and_amplitude(kind):
    u = kind(2, amplitude=(0.3, 0.2), offset=(-0.1, 0.3)).samples(0.01)
    assert u.shape == (1000, 2)
    assert bool(((u - torch.tensor([-0.1, 0.3])).abs() <= torch.tensor([0.3, 0.2]) + 1e-6).all())


@pytest.mark.parametrize("make", [np.array, torch.tensor, list])
def test_levels_may_be_an_array(make):
    excitation = Aprbs(2, amplitude=make([0.3, 0.2]), offset=make([-0.1, 0.3]))
    assert excitation.amplitude.tolist() == pytest.approx([0.3, 0.2])


@pytest.mark.parametrize("kind", MOVING)
def test_as_a_policy_it_reads_the_step_count_and_holds_the_input(kind):
    excitation = kind(2, duration=4.0, dt=0.05)
    out = excitation(TensorDict({"step_count": torch.tensor([[0], [7]])}, batch_size=[2]))
    assert out["action"].dtype == torch.float32
    assert torch.allclose(out["action"].double(), excitation.samples()[[0, 7]], atol=1e-7)
    assert excitation.n_steps == 80


def test_the_seed_makes_the_signal():
    first, again, other = (Multisine(2, seed=s).samples() for s in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.allclose(first, other)


def test_an_experiment_has_at_least_one_period_and_periods_are_rounded():
    assert Chirp(1, duration=0.05, dt=0.05).n_steps == 1
    with pytest.raises(ValueError, match="dt"):
        Chirp(1, duration=0.01, dt=0.05)
    assert Chirp(1, duration=0.29, dt=0.1).n_steps == 3


def test_a_range_may_reach_the_limit_and_must_not_lie_beyond_it():
    assert Chirp(1, amplitude=0.5, offset=0.5).samples().max() <= 1.0
    for amplitude in (0.5, -0.5):  # a negative amplitude turns the wave round
        with pytest.raises(ValueError, match="amplitude"):
            Chirp(1, amplitude=amplitude, offset=0.6)


@pytest.mark.parametrize("dt", [0.05, 2.0])
def test_times_that_are_not_given_follow_the_control_period(dt):
    assert [kind(1, duration=None, dt=dt).n_steps for kind in (Multisine, Aprbs)] == [200] * 2
    assert Chirp(1, duration=None, dt=dt, band=None).n_steps == 200
    held = Aprbs(1, duration=None, dt=dt, hold=None).samples()
    assert (held[:10] == held[0]).all() and (held[10:20] == held[10]).all() and held[10] != held[9]
    swept = Chirp(1, duration=None, dt=dt, band=None, amplitude=1.0).samples()
    torch.testing.assert_close(
        swept, Chirp(1, duration=200 * dt, dt=dt, band=(0.0, 0.05 / dt), amplitude=1.0).samples()
    )


def test_it_begins_at_a_share_of_its_strength_that_doubles_every_ten_periods():
    steps = torch.tensor([[0], [10], [20], [30], [40]])
    assert Chirp(1, first=0.1).growth(steps).flatten().tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0])
    assert Chirp(1).growth(steps).flatten().tolist() == [1.0] * 5
    for share in (0.0, -0.1, 1.5, math.nan):
        with pytest.raises(ValueError, match="first"):
            Chirp(1, first=share)


def test_a_sweep_is_its_formula_in_plain_numbers():
    chirp = Chirp(3, duration=8.0, band=(0.2, 1.5), amplitude=1.0)
    for t in (0.0, 1.3, 7.7):
        given = chirp.signal(torch.tensor(t, dtype=torch.float64)).tolist()
        for i, (stop, phase) in enumerate(((1.5, -math.pi / 2), (1.05, 0.0), (1.5, math.pi / 2))):
            turns = 0.2 * t + (stop - 0.2) * t * t / 16
            assert math.isclose(given[i], math.cos(2 * math.pi * turns + phase), abs_tol=1e-12)


def test_a_multisine_is_its_formula_in_plain_numbers():
    """K = 3 harmonics of each of two inputs: 1, 3, 5 and 2, 4, 6 turns in 4 s, divided by the peak."""
    t, signal = np.linspace(0, 4, 20001), Multisine(2, duration=4.0, harmonics=3, amplitude=1.0, seed=3)
    given, phases = signal.signal(torch.from_numpy(t)).numpy(), signal.phases.numpy()
    for column, turns in enumerate(((1, 3, 5), (2, 4, 6))):
        bare = sum(np.cos(2 * np.pi * n * t / 4 + phase) for n, phase in zip(turns, phases[:, column], strict=True))
        np.testing.assert_allclose(given[:, column], bare / np.abs(bare).max(), atol=1e-5)
    assert np.abs(given).max() <= 1 and len(np.unique(phases)) == 6


def test_phases_of_a_multisine_lie_all_around():
    many = Multisine(2, harmonics=2000, seed=0).phases
    assert bool((many >= 0).all()) and float(many.max()) > 6.2 and abs(float(many.mean()) - torch.pi) < 0.1
    assert abs(float(torch.corrcoef(many.mT)[0, 1])) < 0.06


def test_a_signal_is_the_loop_over_its_holds():
    """Input i jumps i / n_u of a hold earlier; every hold takes the next level."""
    held = Aprbs(2, duration=3.0, hold=0.5, amplitude=1.0, seed=4)
    levels = held.levels
    assert levels.shape == (9, 2) and bool((levels.abs() <= 1).all()) and levels.unique().numel() == 18
    for step in range(60):
        t = 0.05 * step
        expected = [levels[int((step + 0.0001) / 10), 0].item(), levels[int((step + 5.0001) / 10), 1].item()]
        assert held.signal(torch.tensor(t, dtype=torch.float64)).tolist() == expected
    after = held.signal(torch.tensor([4.5, 0.0], dtype=torch.float64))
    assert torch.equal(after[0], after[1])  # nine levels of half a second, then again


def test_levels_fill_the_range_evenly():
    uniform = Aprbs(2, duration=1000.0, hold=0.5, seed=0).levels
    assert abs(float(uniform.mean())) < 0.03 and abs(float(uniform.std()) - 3**-0.5) < 0.02
    assert float(uniform.min()) < -0.99 and float(uniform.max()) > 0.99
    assert abs(float(torch.corrcoef(uniform.mT)[0, 1])) < 0.06
