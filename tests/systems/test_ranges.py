import math

import pytest
import torch

from dynasindy.systems import Signature
from dynasindy.systems.base import sample_states

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
