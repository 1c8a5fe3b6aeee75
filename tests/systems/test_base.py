import pytest
import torch
from alternating import Alternating

from dynasindy.systems import Altered, Signature, Tras, integrate


def test_signatures_are_alike_whatever_their_ranges():
    one = Signature(("x", "v"), ("m", "m/s"), ("u",), (1.0, 2.0))
    assert one.alike(Signature(("x", "v"), ("m", "m/s"), ("u",), (9.0, 0.1)))
    others = [
        (("x", "w"), ("m", "m/s"), ("u",)),
        (("x", "v"), ("m", "mm/s"), ("u",)),
        (("x", "v"), ("m", "m/s"), ("f",)),
    ]
    assert not any(one.alike(Signature(*other, (1.0, 2.0))) for other in others)
    assert not one.alike(Signature(("x",), ("m",), ("u",), (1.0,)))


def test_inputs_are_told_in_the_units_of_their_actuators():
    """0 V to 12 V is 6 V, and 6 V more or less."""
    plant = Signature(("x",), ("m",), ("pump", "u"), (1.0,), input_ends=[[0, 12], [-1, 1]])
    assert plant.input_ends == ((0.0, 12.0), (-1.0, 1.0))
    assert len(plant.own_inputs()) == 1
    assert Signature(("x",), ("m",), ("u",), (1.0,)).own_inputs() == []
    assert plant.in_own_units([[0.5, 0.5]]).tolist() == [[9.0, 0.5]]  # 6 V + 0.5 * 6 V


def test_a_state_more_stands_behind_the_others_and_all_else_stays():
    volts = Signature(("q",), ("rad",), ("u",), (2.0,), ((0, 12),))
    assert volts.with_state("w", "rad/s", 3.0) == Signature(
        ("q", "w"), ("rad", "rad/s"), ("u",), (2.0, 3.0), ((0, 12),)
    )
    with pytest.raises(ValueError, match="differ"):
        volts.with_state("q", "rad")


class Stronger(Altered):
    """One whose input is twice as strong."""

    def forward(self, x, u):
        return self.system(x, 2 * u)


def test_what_is_made_of_a_system_that_moves_in_steps_moves_in_its_steps():
    """Runge-Kutta steps of the same rates would end elsewhere, as no differential equation alternates."""
    x, u = torch.tensor([[1.0]], dtype=torch.float64), torch.tensor([[0.1]], dtype=torch.float64)
    moved = integrate(Stronger(Alternating()), x, u, 1.0, 1)[0]
    assert float(moved[..., -1, :]) == pytest.approx(-0.6 * (-0.6 * 1.0 + 0.2) + 0.2, rel=1e-12)
    assert Altered.step.fget(Stronger(Tras())) is None
