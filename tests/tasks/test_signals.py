"""References that follow from a plant: its target range and the length of its episodes."""

import pytest
import torch

from dynasindy.systems import Pendulum
from dynasindy.tasks import Reference, Tracking, target, wave


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


def test_a_period_that_is_not_known_and_ends_that_do_not_fit_are_told() -> None:
    with pytest.raises(ValueError, match="max_steps"):
        wave("sine", [0.0], [1.0], 400, None)
    with pytest.raises(ValueError, match="amplitud"):
        wave("sine", [0.0], [1.0], 400, 0.1, {"amplitud": [0.3]})
    for make in (lambda: wave("sine", [0.0], [1.0, 2.0], 400, 0.1), lambda: target([0.0], [])):
        with pytest.raises(ValueError, match="differ"):
            make()
