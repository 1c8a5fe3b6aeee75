"""A rate in other units than its angle is told; one in the same units, however noisy, is not."""

import math

import pytest
import torch

from dynasindy.data.rates import mismatched
from dynasindy.data.simulated import disturb, record
from dynasindy.excitation import Chirp, Multisine
from dynasindy.systems import Pendulum, Signature, Tras, Xi
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("angle", "rate"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def swing(angle_unit: float = 1.0, rate_unit: float = 1.0, noise: float = 0.0, n: int = 2000) -> Transitions:
    """A swing of two frequencies [rad], sampled every 0.01 s, its rate by hand, both in other units."""
    t = 0.01 * torch.arange(n + 1, dtype=torch.float64)
    x = torch.stack([torch.sin(2 * t) + 0.3 * torch.sin(7 * t), 2 * torch.cos(2 * t) + 2.1 * torch.cos(7 * t)], -1)
    x = x + noise * x.std(0) * torch.randn(x.shape, generator=torch.Generator().manual_seed(0), dtype=x.dtype)
    return Transitions.from_trajectory(x * torch.tensor([angle_unit, rate_unit]), torch.zeros(n, 1), 0.01)


@pytest.mark.parametrize(
    ("angle", "rate", "factor", "cause"),
    [
        (180 / math.pi, 1.0, 57.3, "degrees beside rad/s"),
        (1.0, 180 / math.pi, 0.01745, "rad beside degrees per second"),
        (1e3, 1.0, 1000.0, "mm beside m/s"),
        (1.0, 1e3, 0.001, "a time in ms"),
        (1.0, 30 / math.pi, 0.1047, "rpm"),
        (-1.0, 1.0, -1.0, "the other way"),
        (17.0, 1.0, 17.0, "in which units"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_factor_and_its_likely_cause_are_told(angle, rate, factor, cause, noise):
    (found,) = mismatched(swing(angle, rate, noise), SIGNATURE)
    assert found.factor == pytest.approx(factor, rel=0.03)
    assert cause in str(found) and "angle" in str(found) and f"{found.factor:.3g} times rate" in str(found)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3, 1.0])
@pytest.mark.parametrize("scale", [1.0, 2.5, 0.4])
def test_a_rate_that_fits_is_not_told_however_noisy(noise, scale):
    assert mismatched(swing(1.0, scale, noise), SIGNATURE) == []


def test_a_rate_of_something_else_is_not_told():
    data = swing()
    other = torch.randn(len(data), 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64).cumsum(0)
    mixed = Transitions.from_trajectory(torch.stack([data.x[:, 0], 9 * other[:, 1]], -1), data.u[1:], 0.01)
    assert mismatched(mixed, SIGNATURE) == []


@pytest.mark.parametrize(
    ("names", "units", "known", "told"),
    [
        (("q", "w"), ("-", "-"), {"q": "w"}, True),
        (("q", "w"), ("-", "-"), {}, False),
        (("q", "q_dot"), ("-", "-"), {}, True),
        (("angle", "rate"), ("-", "-"), {}, True),
        (("q", "w"), ("deg", "rad/s"), {}, True),
        (("q", "w"), ("V", "rad/s"), {}, False),
        (("q", "w"), ("V", "V/s"), None, True),
    ],
)
def test_what_is_known_or_called_so_or_has_the_unit_is_the_rate(names, units, known, told):
    found = mismatched(swing(57.3), Signature(names, units, ("u",), (1.0, 1.0)), known)
    assert bool(found) == told


def test_an_angle_that_is_counted_within_a_turn_is_still_told():
    data = swing()
    turns = data.x[:, :1].sign().diff(dim=0).abs().cumsum(0) % 3 * 2 * math.pi  # jumps of a turn, now and then
    x = torch.cat([(data.x[1:, :1] + turns) * 57.3, data.x[1:, 1:]], -1)
    assert mismatched(Transitions.from_trajectory(x, data.u[2:], 0.01), SIGNATURE)[0].factor == pytest.approx(
        57.3, 0.03
    )


def test_an_axis_that_moves_almost_like_another_one_is_not_taken_for_it():
    """As of a balanced pendulum on an arm: the arm moves against the pendulum's rate, with little apart."""
    data = swing()
    other = -1.3 * data.x[1:, 1:] + 0.8 * (3 * 0.01 * torch.arange(len(data) - 1)).sin().unsqueeze(-1)
    mixed = Transitions.from_trajectory(torch.cat([data.x[1:, :1], other], -1), data.u[2:], 0.01)
    assert mismatched(mixed, SIGNATURE) == []
    assert mismatched(mixed, SIGNATURE, {"angle": "rate"})[0].factor == pytest.approx(-1 / 1.3, rel=0.05)


@pytest.mark.parametrize("plant", [Tras, Xi, Pendulum])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_no_simulated_plant_is_told(plant, noise):
    system = plant()
    for signal in (Chirp(system.signature.n_u, 10.0), Multisine(system.signature.n_u, duration=10.0, dt=0.05, seed=1)):
        data = disturb(record(system, signal.samples(0.01), 0.01, substeps=2), noise, 0)
        assert mismatched(data, system.signature) == []
