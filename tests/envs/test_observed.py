"""The state in an observation: entries by name, and angles that go on over whole turns."""

import math

import pytest
import torch

from dynasindy.envs.foreign import _Observed

NAMES = ["s", "w", "c", "unread"]


def shown(*angles):
    return torch.tensor([[math.sin(a), 0.1 * k, math.cos(a), 9.0] for k, a in enumerate(angles)])


def test_states_are_entries_by_name_and_angles_of_sine_and_cosine():
    observed = _Observed(NAMES, ["w", "a"], {"a": ["s", "c"]})
    angles = [0.3, -2.0, 3.0, -3.1]
    torch.testing.assert_close(
        observed.state(shown(*angles)), torch.tensor([[0.1 * k, a] for k, a in enumerate(angles)])
    )
    only = _Observed(NAMES, ["c", "s"])
    torch.testing.assert_close(only.state(shown(2.0)), torch.tensor([[math.cos(2.0), math.sin(2.0)]]))


def test_an_angle_goes_on_over_whole_turns_in_both_directions():
    observed = _Observed(NAMES, ["a", "w"], {"a": ["s", "c"]})
    for way in (1.0, -1.0):
        true = [way * 1.3 * k for k in range(12)]  # more than two turns, in steps of less than half a turn
        x = observed.state(shown(0.0))
        for angle in true[1:]:
            x = observed.state(shown(angle), x)
            assert x[0, 0].item() == pytest.approx(angle, abs=1e-5)


def test_entries_in_their_order_pass_through_and_an_angle_has_no_ends():
    x = shown(0.5, 0.6)
    assert _Observed(NAMES, NAMES).state(x, x) is x
    ends = torch.tensor([[-1.0, -8.0, -1.0, -5.0], [1.0, 7.0, 1.0, 5.0]])
    wanted = torch.tensor([[-8.0, -math.inf, -1.0], [7.0, math.inf, 1.0]])
    assert torch.equal(_Observed(NAMES, ["w", "a", "c"], {"a": ["s", "c"]}).ends(ends), wanted)


@pytest.mark.parametrize(
    ("names", "states", "angles", "words"),
    [
        (["s", "s"], ["s"], {}, "twice"),
        (
            NAMES,
            ["w", "q"],
            {},
            r"plant\.states",
        ),
        (NAMES, ["w"], {"a": ["s", "c"]}, r"\[s, c\]"),
        (NAMES, ["a"], {"a": ["s", "z"]}, r"\[s, z\]"),
        (NAMES, ["a"], {"a": ["s"]}, r"\[s\]"),
        (NAMES, ["w"], {"w": ["s", "c"]}, r"plant\.angles"),
    ],
)
def test_what_is_no_state_is_refused(names, states, angles, words):
    with pytest.raises(ValueError, match=words):
        _Observed(names, states, angles)
