import pytest

from dynasindy.systems import Signature, Tras


def test_states_are_found_by_name():
    assert Tras().signature.state_index("Omega_p") == 3


def test_an_unknown_state_is_answered_with_the_states_that_exist():
    with pytest.raises(ValueError, match=r"'pitch' does not exist; the states are alpha_a, alpha_p"):
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
