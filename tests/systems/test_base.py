"""Signatures and systems."""

import math

import pytest
import torch
from alternating import Alternating

from dynasindy.rig.simulated import rehearsal
from dynasindy.systems import Altered, BlackBox, Signature, Tras, integrate
from dynasindy.systems.base import sample_states


def test_headings_have_the_units_of_the_states_whatever_these_are_called():
    signature = Signature(("T", "reference_level"), ("K", "m"), ("u",), (1.0, 1.0))
    names = ["time", "reference_T", "reference_level", "predicted_reference_level", "u"]
    assert signature.headings(names) == [
        f"{name} [{unit}]" for name, unit in zip(names, ("s", "K", "m", "m", "-"), strict=True)
    ]


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


SIGNATURE = Signature(("q", "v", "w"), ("m", "m/s", "1"), ("u",), (1.0, 1.0, 1.0))


def test_a_limit_is_meant_for_both_sides_of_zero_and_a_start_for_a_value():
    assert SIGNATURE.state_limits({"q": 2.0, "w": [-1, 3.5]}).tolist() == [
        [-2.0, -math.inf, -1.0],
        [2.0, math.inf, 3.5],
    ]
    assert SIGNATURE.start_ranges({"q": 2.0, "w": [-1, 3.5]}).tolist() == [[2.0, 0.0, -1.0], [2.0, 0.0, 3.5]]
    assert SIGNATURE.state_limits({}).isinf().all()


def test_states_are_drawn_evenly_between_their_ends():
    ends, generator = SIGNATURE.start_ranges({"q": [1.0, 3.0], "v": 0.5}), torch.Generator().manual_seed(0)
    x = sample_states(ends, torch.Size((4000,)), generator)
    assert x.shape == (4000, 3) and x[:, 1].unique().tolist() == [0.5] and not x[:, 2].any()
    assert float(x[:, 0].mean()) == pytest.approx(2.0, abs=0.05)
    assert float(x[:, 0].var()) == pytest.approx(4 / 12, rel=0.05)  # of a uniform distribution, width^2 / 12
    before = generator.get_state()
    assert sample_states(SIGNATURE.start_ranges({"q": 1.0}), torch.Size(), generator).tolist() == [1.0, 0.0, 0.0]
    assert torch.equal(before, generator.get_state())


def test_names_units_and_ends_are_those_that_were_given_in_their_order():
    plant = BlackBox({"h1": "cm", "h2": "cm"}, {"pump": [0, 12], "valve": [-1, 1]})
    signature = plant.signature
    assert signature.state_names == ("h1", "h2") and signature.state_units == ("cm", "cm")
    assert signature.x_scale == (1.0, 1.0)  # as nobody knows how far they go
    assert signature.input_names == ("pump", "valve") and signature.input_units == ()
    assert signature.in_own_units([[0, 0], [1, 1]]).tolist() == [[0, 0], [12, 1]]  # zero is 0 V, as in a log
    assert signature.input_limits == ((0.0, 1.0), (-1.0, 1.0))
    assert BlackBox({"angle": "rad"}, ["motor"]).signature.input_ends == ()


def test_nobody_knows_how_it_moves():
    plant = BlackBox({"angle": "rad"}, ["motor"])
    assert not plant.known
    with pytest.raises(RuntimeError, match="knows"):
        plant(torch.zeros(1), torch.zeros(1))
    with pytest.raises(ValueError, match="udp"), rehearsal(plant, 0.05):
        pass
