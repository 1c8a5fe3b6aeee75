"""Dead zones and saturations are read off equations, and seen in what equations without them leave over."""

import math

import numpy as np
import pytest
import torch

from dynasindy.sindy import Regression, SindyModel
from dynasindy.sindy.input_nonlinearity import InputNonlinearity, find_missing_nonlinearity, read_nonlinearity
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("v",), ("m/s",), ("u",), (1.0,))


@pytest.mark.parametrize(
    ("edges", "slopes", "expected"),
    [
        ([-0.25, 0.3], [20.0, 0.1, 20.0], InputNonlinearity("u", "dead zone", -0.25, 0.3)),
        ([-0.5, 0.5], [0.0, 20.0, 0.0], InputNonlinearity("u", "saturation", -0.5, 0.5)),
        ([0.5], [20.0, 1.0], InputNonlinearity("u", "saturation", -math.inf, 0.5)),
        ([-0.5, 0.5], [20.0, 10.0, 20.0], None),  # softer, but moving
        ([], [20.0], None),
        ([0.1, 0.2], [0.0, 0.0, 0.0], None),
    ],
)
def test_what_is_flat_between_its_edges_is_a_dead_zone_and_what_is_flat_outside_a_saturation(edges, slopes, expected):
    model = SindyModel(SIGNATURE, ["u", *(f"max(0, u - {edge})" for edge in edges)])
    model.set_coefficients(torch.tensor(np.diff(slopes, prepend=0.0)).unsqueeze(-1))
    assert read_nonlinearity(model, 0, "u") == expected


def in_what_is_left_over(acts, noise=0.0):
    """Return the bend that a straight fit lacks of v' = 3 f(u) - 2 v under held inputs, v measured with such noise."""
    u = np.random.default_rng(0).uniform(-1, 1, 300).repeat(5)
    v, left = [0.0], np.exp(-2 * 0.02)
    for held in acts(u):
        v.append(left * v[-1] + (1 - left) * 1.5 * held)
    seen = np.array(v) + noise * np.random.default_rng(1).normal(size=len(v))
    data = Transitions.from_trajectory(torch.from_numpy(seen)[:, None], torch.from_numpy(u)[:, None], 0.02)
    model = SindyModel(SIGNATURE, ["1", "v", "u"], Regression("bic"))
    model.fit(data)
    return find_missing_nonlinearity(model, data)


@pytest.mark.parametrize(
    ("acts", "kind", "ends"),
    [
        (lambda u: np.sign(u) * np.maximum(0, np.abs(u) - 0.3), "dead zone", (-0.3, 0.3)),
        (lambda u: np.clip(u, -0.4, 0.5), "saturation", (-0.4, 0.5)),
        (lambda u: u, None, None),
        (lambda u: u + 0.5 * u**3, None, None),
    ],
)
def test_a_bend_that_the_library_lacks_is_found_in_what_is_left_over(acts, kind, ends):
    found = in_what_is_left_over(acts)
    assert (found is None) == (kind is None)
    if found is not None:
        assert found.kind == kind and (found.low, found.high) == pytest.approx(ends, abs=0.06)


@pytest.mark.parametrize(("noise", "kind"), [(1e-4, "saturation"), (0.02, None)])
def test_a_bend_has_to_halve_what_is_left_over(noise, kind):
    """A saturation is clear behind a little noise; behind a lot of it it is the least of what is left over."""
    found = in_what_is_left_over(lambda u: np.clip(u, -0.4, 0.5), noise)
    assert (found and found.kind) == kind
