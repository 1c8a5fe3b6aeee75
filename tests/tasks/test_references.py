import math

import pytest
import torch

from dynasindy.tasks import Mixture, RandomStep, Step, Wave
from dynasindy.tasks.references import rate, value


def at(reference, seconds, rows=1):
    params = reference.sample(torch.Size((rows,)), torch.Generator().manual_seed(0))
    return value(params, torch.full((rows, 1), float(seconds)))


def test_steps_are_constant_and_taken_in_turn():
    steps = Step([[0.4, 0.25], [-0.1, 0.0]])
    assert torch.allclose(at(steps, 7.0, 3), torch.tensor([[0.4, 0.25], [-0.1, 0.0], [0.4, 0.25]]))


def test_random_steps_fill_their_box():
    params = RandomStep([-0.5, 0.1], [0.5, 0.2]).sample(torch.Size((2000,)), torch.Generator().manual_seed(1))
    targets = value(params, torch.zeros(2000, 1))
    assert targets.min(0).values.tolist() == pytest.approx([-0.5, 0.1], abs=0.01)
    assert targets.max(0).values.tolist() == pytest.approx([0.5, 0.2], abs=0.01)


def test_the_papers_sine():
    sine = Wave([0.35, 0.25], [0.015, 0.015])
    quarter = 1 / 0.015 / 4
    assert at(sine, quarter)[0].tolist() == pytest.approx([0.35, 0.25], abs=1e-6)
    assert at(sine, 10.0)[0, 0].item() == pytest.approx(0.35 * math.sin(2 * math.pi * 0.015 * 10), abs=1e-6)


def test_the_papers_square_jumps_after_fifty_seconds():
    square = Wave([0.4, -0.5], [0.01, 0.01], "square")
    assert at(square, 0.0)[0].tolist() == pytest.approx([0.4, -0.5])
    assert at(square, 49.9)[0].tolist() == pytest.approx([0.4, -0.5])
    assert at(square, 50.1)[0].tolist() == pytest.approx([-0.4, 0.5])


def test_rate_is_the_derivative():
    params = Wave([0.35, 0.25], [0.1, 0.2]).sample(torch.Size((1,)), torch.Generator()).double()
    t = torch.tensor([[3.7]], dtype=torch.float64, requires_grad=True)
    for axis in range(2):
        (slope,) = torch.autograd.grad(value(params, t)[0, axis], t)
        assert rate(params, t)[0, axis].item() == pytest.approx(slope.item())


def test_a_mixture_holds_its_weights():
    mixture = Mixture([Step([[1.0]]), Step([[2.0]])], [0.25, 0.75])
    drawn = at(mixture, 0.0, 4000)
    assert (drawn == 2.0).float().mean().item() == pytest.approx(0.75, abs=0.03)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Step([]),
        lambda: Step([[0.1], [0.1, 0.2]]),
        lambda: RandomStep([0.5], [-0.5]),
        lambda: RandomStep([math.nan], [1.0]),
        lambda: Wave([0.1], [-1.0]),
        lambda: Wave([0.1], [1.0], "triangle"),
        lambda: Mixture([]),
        lambda: Mixture([Step([[1.0]])], [-1.0]),
    ],
)
def test_impossible_references_are_refused(make):
    with pytest.raises(ValueError, match=r"need|must|unknown"):
        make()
