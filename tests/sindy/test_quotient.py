"""Of the angles that two links have, the one is found that their mass matrix depends on, however they are counted."""

import pytest
import torch

from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.named_libraries import auto_rig, mechanical
from dynasindy.sindy.shape_parameters import of_one_angle, one_quotient
from dynasindy.systems import Signature

GRAVITY, WIDTH = 9.81, 20.0
SIGNATURE = Signature(("a", "b", "v", "w"), ("rad", "rad", "rad/s", "rad/s"), ("one", "two"), (1.0, 1.0, 1.0, 1.0))
ALPHA, BETA, DELTA, FIRST, SECOND = 0.36, 0.09, 0.055, 8.6, 2.1
"""Of M = [alpha + 2 beta cos b, delta + beta cos b; ., delta]: inertias, and of gravity: moments [kg m^2, N m]."""
P = -(BETA**2) / (ALPHA * DELTA - DELTA**2)
"""det M = (alpha delta - delta^2) (1 + p cos^2 b)."""


def arm(x, u, dry=1.0):
    """Solve Lagrange's equations of a planar elbow arm (Spong, 2006, section 7.4) by Cramer's rule; b is relative."""
    a, b, v, w = x.unbind(-1)
    h = BETA * b.sin()
    one = (
        u[:, 0] + h * (2 * v * w + w**2) - FIRST * a.sin() - SECOND * (a + b).sin() - 0.5 * dry * torch.tanh(WIDTH * v)
    )
    two = u[:, 1] - h * v**2 - SECOND * (a + b).sin() - 0.2 * dry * torch.tanh(WIDTH * w)
    m, n = ALPHA + 2 * BETA * b.cos(), DELTA + BETA * b.cos()
    det = m * DELTA - n**2
    return torch.stack([v, w, (DELTA * one - n * two) / det, (m * two - n * one) / det], -1)


def turned(x, u, sign):
    """Return the same arm without friction, its second angle measured against the vertical as `sign` times it."""
    a, c, v, z = x.unbind(-1)
    dx = arm(torch.stack([a, sign * c - a, v, sign * z - v], -1), u, 0.0)
    return torch.stack([v, z, dx[:, 2], sign * (dx[:, 2] + dx[:, 3])], -1)


@pytest.mark.parametrize(
    ("plant", "angle"),
    [
        (arm, ("b",)),
        (lambda x, u: arm(x[:, [1, 0, 3, 2]], u)[:, [1, 0, 3, 2]], ("a",)),
        (lambda x, u: turned(x, u, 1), ("a", "b", "gap")),
        (lambda x, u: turned(x, u, -1), ("a", "b", "sum")),
    ],
    ids=["relative", "swapped", "absolute", "counted the other way"],
)
def test_an_arm_is_held_exactly_by_the_functions_of_the_angle_between_its_links(plant, angle):
    rng = torch.Generator().manual_seed(0)
    x, u = (torch.rand(2000, n, generator=rng, dtype=torch.float64) * 3 - 1.5 for n in (4, 2))
    dx, library = plant(x, u), auto_rig(SIGNATURE)
    numbers = [P if shape.function in QUOTIENTS else WIDTH for shape in library.shapes]
    free = torch.zeros(len(library), 4, dtype=torch.bool)
    free[:, 2:] = True
    kept = one_quotient(library, free, lambda trial: (trial(x, u), dx))
    assert torch.equal(kept, free & of_one_angle(library)[angle].unsqueeze(-1))
    theta = library.with_shapes(numbers)(x, u)
    for name, own in of_one_angle(library).items():
        columns = theta[:, own]
        found = torch.linalg.lstsq(columns, dx[:, 2:], driver="gelsd").solution
        left = float((dx[:, 2:] - columns @ found).norm() / dx[:, 2:].norm())
        assert left < 1e-9 if name == angle else left > 1e-4


def test_functions_of_no_angle_and_gravity_stay_whatever_the_angle():
    library = auto_rig(SIGNATURE)
    groups = of_one_angle(library)
    assert set(groups) == {("a",), ("b",), ("a", "b", "sum"), ("a", "b", "gap")}
    common = torch.stack(list(groups.values())).all(0)
    names = {name for name, both in zip(library.names, common.tolist(), strict=True) if both}
    assert {"1", "a", "one", "two", "one two", "sin(a)", "cos(b)", "sin(a + b)", "cos(a - b)"} <= names
    assert not any("/(" in name for name in names)
    assert all(group.sum() < 0.5 * len(library) for group in groups.values())


def test_of_one_angle_all_stays():
    library = mechanical(Signature(("p", "a", "v", "w"), ("m", "rad", "m/s", "rad/s"), ("u",), (1.0,) * 4))
    free = torch.ones(len(library), 4, dtype=torch.bool)
    assert one_quotient(library, free, lambda trial: pytest.fail("nothing is to be compared")) is free
