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
    with pytest.raises(ValueError, match="duration"):
        make()


@pytest.mark.parametrize("kind", [*MOVING, PrintedChirp])
def test_the_defaults_are_ten_seconds_of_the_control_period_at_a_third_of_the_range(kind):
    excitation = kind(2)
    assert (excitation.duration, excitation.dt, excitation.n_steps, excitation.seed) == (10.0, 0.05, 200, 0)
    assert excitation.amplitude.tolist() == [0.3, 0.3] and excitation.offset.tolist() == [0.0, 0.0]
    bare = kind(2, amplitude=1.0).samples()
    assert excitation.samples().shape == (200, 2) and excitation.samples().dtype == torch.float64
    torch.testing.assert_close(excitation.samples(), 0.3 * bare)
    half = kind(2, amplitude=(0.2, 0.4), offset=(0.1, -0.3)).samples()
    torch.testing.assert_close(half, bare * torch.tensor([0.2, 0.4]).double() + torch.tensor([0.1, -0.3]).double())


@pytest.mark.parametrize("kind", [*MOVING, PrintedChirp])
def test_times_may_have_any_batch(kind):
    excitation, t = kind(2), torch.linspace(0, 9.9, 12, dtype=torch.float64)
    single = torch.stack([excitation.signal(time) for time in t])
    assert torch.equal(excitation.signal(t.reshape(3, 4)), single.reshape(3, 4, 2))
    assert torch.equal(excitation.signal(t), single)


def test_samples_are_the_signal_at_multiples_of_the_step():
    excitation = Chirp(1, duration=2.0, dt=0.1, amplitude=0.5)
    t = torch.arange(8, dtype=torch.float64) * 0.25
    assert torch.equal(excitation.samples(0.25), excitation.signal(t))
    assert excitation.samples().shape == (20, 1)


def test_an_experiment_has_at_least_one_period_and_periods_are_rounded():
    assert Chirp(1, duration=0.01, dt=0.05).n_steps == 1
    assert Chirp(1, duration=0.29, dt=0.1).n_steps == 3


def test_inputs_are_clipped_at_either_end():
    u = Prbs(1, amplitude=0.8, offset=-0.6, seed=2).samples()
    assert sorted(u.unique().tolist()) == pytest.approx([-1.0, 0.2])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 0.0}, "duration 0.0 s"),
        ({"dt": -0.1}, "dt -0.1 s"),
        ({"offset": (0.0, 1.3)}, "move the offset towards 0"),
        ({"offset": (0.0, -1.3)}, "move the offset towards 0"),
        ({"amplitude": (0.1,) * 3}, "3 values of amplitude"),
        ({"offset": (0.1,) * 3}, "3 values of offset"),
        ({"offset": (math.inf, 0.0)}, "finite numbers"),
    ],
)
def test_each_setting_is_refused_by_its_own_words(settings, message):
    with pytest.raises(ValueError, match=message):
        Chirp(2, **settings)


def test_a_range_may_reach_the_limit_and_must_not_lie_beyond_it():
    assert Chirp(1, amplitude=0.5, offset=1.49).samples().max() == 1.0
    with pytest.raises(ValueError, match="towards"):
        Chirp(1, amplitude=0.5, offset=1.5)
    assert Chirp(1, amplitude=-0.5, offset=1.2).samples().min() < 1.0  # a negative amplitude turns the wave round


@pytest.mark.parametrize("dt", [0.05, 2.0])
def test_times_that_are_not_given_follow_the_control_period(dt):
    assert [kind(1, None, dt).n_steps for kind in (Chirp, Multisine, HeldRandom)] == [200] * 3
    held = HeldRandom(1, None, dt, hold=None).samples()
    assert (held[:10] == held[0]).all() and (held[10:20] == held[10]).all() and held[10] != held[9]
    swept = Chirp(1, None, dt, band=None, amplitude=1.0).samples()
    torch.testing.assert_close(swept, Chirp(1, 200 * dt, dt, band=(0.0, 0.05 / dt), amplitude=1.0).samples())


def test_it_begins_at_a_share_of_its_strength_that_doubles_every_ten_periods():
    steps = torch.tensor([[0], [10], [20], [30], [40]])
    assert Chirp(1, first=0.1).growth(steps).flatten().tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0])
    assert Chirp(1).growth(steps).flatten().tolist() == [1.0] * 5
    for share in (0.0, -0.1, 1.5, math.nan):
        with pytest.raises(ValueError, match="share"):
            Chirp(1, first=share)


def test_a_gain_has_a_row_per_input_and_a_column_per_state():
    signal = Chirp(2, gain=[[1.0, 0.5, 2.0], [0.0, -1.0, 3.0]])
    assert signal.gain.tolist() == [[1.0, 0.5, 2.0], [0.0, -1.0, 3.0]]
    signal.check_gain(["a", "b", "c"])
    with pytest.raises(ValueError, match="columns"):
        signal.check_gain(["a", "b"])
    for gain in ([[1.0, 2.0]], [[1.0, 2.0], [1.0]], [[1.0], [math.inf]], []):
        with pytest.raises(ValueError, match="finite"):
            Chirp(2, gain=gain)
