import pytest
import torch
from alternating import Alternating

from dynasindy.systems import Altered, Signature, Tras, integrate


def test_states_are_found_by_name():
    assert Tras().signature.state_index("Omega_p") == 3


def test_an_unknown_state_is_answered_with_the_states_that_exist():
    with pytest.raises(ValueError, match="alpha_a"):
        Tras().signature.state_index("pitch")


@pytest.mark.parametrize(
    ("names", "units", "inputs", "scale", "message"),
    [
        (("a", "b"), ("rad",), ("u",), (1.0, 1.0), "one unit and one range"),
        (("a", "a"), ("rad", "rad"), ("u",), (1.0, 1.0), "must differ"),
        (("a",), ("rad",), ("u",), (0.0,), "positive"),
    ],
)
def test_inconsistent_signatures_are_refused(names, units, inputs, scale, message):
    with pytest.raises(ValueError, match=message):
        Signature(names, units, inputs, scale)


def test_lists_become_tuples_so_that_signatures_compare():
    given = Signature(["a", "b"], ["rad", "rpm"], ["u"], [1.0, 2.0])
    assert given == Signature(("a", "b"), ("rad", "rpm"), ("u",), (1.0, 2.0))
    assert (given.n_x, given.n_u) == (2, 1)


@pytest.mark.parametrize(
    ("names", "inputs", "scale"), [(("a", "b"), ("a",), (1.0, 1.0)), (("a", "b"), ("u",), (1.0, -1.0))]
)
def test_an_input_named_like_a_state_and_a_single_bad_range_are_refused(names, inputs, scale):
    with pytest.raises(ValueError, match="repeated"):
        Signature(names, ("rad", "rad"), inputs, scale)


def test_a_range_is_asked_for_each_state():
    with pytest.raises(ValueError, match="ranges"):
        Signature(("a", "b"), ("rad", "rad"), ("u",), (1.0,))


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
    (told,) = plant.own_inputs()
    assert "pump is 6 + 6 times" in told
    assert Signature(("x",), ("m",), ("u",), (1.0,)).own_inputs() == []
    heater = Signature(("x",), ("m",), ("u",), (1.0,), [[-80, 80]], [[0, 1]], ["%"])
    assert heater.own_inputs() == ["the plant's u is 80 % times the controller's, which is in [0, 1]"]
    assert plant.in_own_units([[0.5, 0.5]]).tolist() == [[9.0, 0.5]]  # 6 V + 0.5 * 6 V


@pytest.mark.parametrize("limits", [((0, 1),), ((0, 1), (1, 1)), ((0, 1), (-1, 2))])
def test_limits_of_inputs_that_are_none_are_refused(limits):
    with pytest.raises(ValueError, match="limits"):
        Signature(("x",), ("m",), ("u", "v"), (1.0,), input_limits=limits)


@pytest.mark.parametrize("units", [("V",), ("V", "<b>")])
def test_units_of_inputs_that_are_none_are_refused(units):
    with pytest.raises(ValueError, match="units"):
        Signature(("x",), ("m",), ("u", "v"), (1.0,), input_units=units)


@pytest.mark.parametrize("ends", [((0, 1),), ((0, 1), (1, 1)), ((0, 1), (0, float("inf")))])
def test_ends_of_inputs_that_are_none_are_refused(ends):
    with pytest.raises(ValueError, match="ends"):
        Signature(("x",), ("m",), ("u", "v"), (1.0,), input_ends=ends)


def test_a_state_more_stands_behind_the_others_and_all_else_stays():
    volts = Signature(("q",), ("rad",), ("u",), (2.0,), ((0, 12),))
    assert volts.with_state("w", "rad/s", 3.0) == Signature(
        ("q", "w"), ("rad", "rad/s"), ("u",), (2.0, 3.0), ((0, 12),)
    )
    with pytest.raises(ValueError, match="names must differ"):
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
