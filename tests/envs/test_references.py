import math

import pytest
import torch

from dynasindy.envs import RandomStep, Reference, Step, Tracking, Wave, target, wave
from dynasindy.envs.references import rate, value
from dynasindy.systems import Pendulum


def test_random_steps_fill_their_box():
    params = RandomStep([-0.5, 0.1], [0.5, 0.2]).sample(torch.Size((2000,)), torch.Generator().manual_seed(1))
    targets = value(params, torch.zeros(2000, 1))
    assert targets.min(0).values.tolist() == pytest.approx([-0.5, 0.1], abs=0.01)
    assert targets.max(0).values.tolist() == pytest.approx([0.5, 0.2], abs=0.01)


@pytest.mark.parametrize("square", [0.0, 1.0])
def test_value_and_rate_are_the_formulas_in_plain_numbers(square):
    rng = torch.Generator().manual_seed(2)
    params = torch.rand(4, 3, 5, generator=rng, dtype=torch.float64)
    params[..., 3] *= 6
    params[..., 4] = square
    t = 7 * torch.rand(4, 1, generator=rng, dtype=torch.float64)
    for i in range(4):
        for j in range(3):
            offset, amplitude, frequency, phase, _ = params[i, j].tolist()
            sine = math.sin(2 * math.pi * frequency * t[i].item() + phase)
            slope = amplitude * 2 * math.pi * frequency * math.cos(2 * math.pi * frequency * t[i].item() + phase)
            wave = math.copysign(1.0, sine) if square else sine
            assert value(params, t)[i, j].item() == pytest.approx(offset + amplitude * wave, rel=1e-12)
            assert rate(params, t)[i, j].item() == pytest.approx(0.0 if square else slope, rel=1e-12)


def test_a_square_is_up_from_its_zero_on_and_down_from_its_half_period_on():
    # sin has its zeros there; the wave must not rest at 0.
    params = torch.tensor([[[0.0, 1.0, 0.5, 0.0, 1.0]]], dtype=torch.float64)
    assert [value(params, torch.tensor([[t]]).double()).item() for t in (0.0, 0.5, 1.0, 1.5)] == [1.0, 1.0, -1.0, -1.0]


def test_parameters_are_offset_amplitude_frequency_phase_and_shape():
    size, rng = torch.Size((2, 3)), torch.Generator()
    step = Step([[0.4, 0.25], [-0.1, 0.0], [0.2, 0.3]])
    drawn = step.sample(size, rng)
    assert drawn.shape == (2, 3, 2, 5) and step.n_r == 2 and not drawn[..., 1:].any()
    torch.testing.assert_close(drawn[..., 0].reshape(6, 2), torch.tensor([[0.4, 0.25], [-0.1, 0.0], [0.2, 0.3]] * 2))
    wave = Wave([0.4, 0.3, 0.2], [0.1, 0.2, 0.3], "square", [0.01, 0.02, 0.03])
    rows = [[0.01, 0.4, 0.1, 0, 1], [0.02, 0.3, 0.2, 0, 1], [0.03, 0.2, 0.3, 0, 1]]
    assert wave.n_r == 3 and torch.equal(wave.sample(size, rng), torch.tensor(rows).expand(2, 3, 3, 5))
    assert torch.equal(Wave([0.4], [0.1]).sample(size, rng)[0, 0], torch.tensor([[0, 0.4, 0.1, 0, 0]]))
    box = RandomStep([-0.5, 0.1], [0.5, 0.2])
    assert box.n_r == 2 and not box.sample(size, rng)[..., 1:].any()


def test_random_waves_draw_amplitude_frequency_and_phase_of_every_row_and_output_apart():
    wave = Wave([2.0, 3.0], [4.0, 5.0], offset=[0.5, 0.6], random=True)
    drawn = wave.sample(torch.Size((4000,)), torch.Generator().manual_seed(0))
    assert torch.equal(drawn[..., 0], torch.tensor([0.5, 0.6]).expand(4000, 2)) and not drawn[..., 4].any()
    free = drawn[..., 1:4] / torch.tensor([[2.0, 4.0, 2 * math.pi], [3.0, 5.0, 2 * math.pi]])
    assert (free >= 0).all() and (free <= 1).all()
    shares = free.reshape(4000, 6)
    torch.testing.assert_close(shares.mean(0), torch.full((6,), 0.5), atol=0.02, rtol=0)
    torch.testing.assert_close(shares.std(0), torch.full((6,), 12**-0.5), atol=0.01, rtol=0)
    assert (torch.corrcoef(shares.T) - torch.eye(6)).abs().max() < 0.06


def test_a_constant_is_worth_its_offset_in_every_use():
    params = torch.tensor([[0.5, 0.0, 0.1, 0.3, 0.0], [0.2, 0.0, 0.0, 0.0, 1.0]])
    t = torch.tensor([[1.0], [2.0], [3.0]], dtype=torch.float64)
    found = value(params.expand(3, 2, 5), t)
    assert found.dtype == torch.float64 and found.shape == (3, 2)
    assert torch.equal(found.float(), params[:, 0].expand(3, 2))
    found += 1  # which is nobody else's memory
    assert params[:, 0].tolist() == pytest.approx([0.5, 0.2])
    mapped = torch.func.vmap(value, (None, 0))(params, t)
    assert torch.equal(mapped.float(), params[:, 0].expand(3, 2))
    # The slope by an amplitude of zero is the wave itself: sin(2 pi 0.1 + 0.3).
    slope = torch.autograd.grad(value(params.requires_grad_(), torch.ones(1)).sum(), params)[0]
    assert slope[0, 1].item() == pytest.approx(math.sin(0.2 * math.pi + 0.3), rel=1e-6)
    still = torch.tensor([[0.5, math.nan, 0.1, 0.3, 0.0]])
    assert value(still, torch.ones(1)).isnan().all()


def rows(reference: Reference) -> torch.Tensor:
    return reference.sample(torch.Size(()), torch.Generator())


def test_a_wave_is_about_the_middle_over_half_of_the_range_with_an_episode_as_period() -> None:
    sine = rows(wave("sine", [0.2, 10.0], [0.8, 30.0], 400, 2.0))  # an episode of 800 s
    torch.testing.assert_close(sine, torch.tensor([[0.5, 0.15, 1 / 800, 0, 0], [20.0, 5.0, 1 / 800, 0, 0]]))
    assert rows(wave("square", [0.2], [0.8], 400, 2.0))[0, 4] == 1


@pytest.mark.parametrize("shape", ["sine", "square"])
def test_an_output_with_one_target_stays_there_while_the_other_goes_within_its_range(shape: str) -> None:
    task = Tracking(Pendulum().signature, wave(shape, [-1.0, 0.3], [3.0, 0.3], 50, 0.1), ("theta", "Omega"), ())
    time = torch.linspace(0, 10, 101).unsqueeze(-1)
    params = task.sample(torch.Size((101,)), torch.Generator())
    moving, still = task.reference(params, time).unbind(-1)
    torch.testing.assert_close(still, torch.full((101,), 0.3))
    assert (moving.min().item(), moving.max().item()) == pytest.approx((0.0, 2.0), abs=0.01)


def test_what_the_plant_says_of_a_wave_counts_and_the_rest_follows() -> None:
    own = rows(wave("square", [-0.5], [0.4], 400, 0.05, {"amplitude": [-0.5], "frequency": [0.01], "offset": [0.0]}))
    torch.testing.assert_close(own, torch.tensor([[0.0, -0.5, 0.01, 0, 1]]))
    part = rows(wave("sine", [-0.5], [0.4], 400, None, {"frequency": [0.01]}))
    torch.testing.assert_close(part, torch.tensor([[-0.05, 0.225, 0.01, 0, 0]]))


def test_a_step_goes_to_the_upper_half_of_the_range_or_to_what_the_plant_says() -> None:
    torch.testing.assert_close(target([0.2, 0.0], [0.8, 0.0]).targets, torch.tensor([[0.65, 0.0]]))
    torch.testing.assert_close(target([0.2], [0.8], [[0.4], [0.5]]).targets, torch.tensor([[0.4], [0.5]]))
