"""The library of machines with angles holds the equations of motion of textbooks, and finds them in their data."""

import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import COUPLING, angles_of, auto, mechanical, polynomial
from dynasindy.systems import Signature, rk4
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("p", "theta", "v", "omega"), ("m", "rad", "m/s", "rad/s"), ("force",), (1.0, 0.3, 1.0, 1.0))
CART, POLE, LENGTH, GRAVITY, LARGEST = 1.0, 0.3, 0.6, 9.81, 10.0


def cart_pole(x, u):
    """Solve the two equations of Lagrange for a rod on a cart, upright at 0, by elimination by hand."""
    _, theta, v, omega = x.unbind(-1)
    s, c = theta.sin(), theta.cos()
    # (M + m) v' + m l c omega' = F + m l omega^2 s,   m l c v' + 4/3 m l^2 omega' = m g l s
    a, b, d = CART + POLE, POLE * LENGTH * c, 4 / 3 * POLE * LENGTH**2
    first = LARGEST * u[..., 0] + POLE * LENGTH * omega**2 * s
    second = POLE * GRAVITY * LENGTH * s
    det = a * d - b * b
    return torch.stack((v, omega, (d * first - b * second) / det, (a * second - b * first) / det), -1)


@pytest.fixture(scope="module")
def data():
    generator = torch.Generator().manual_seed(0)
    size = torch.tensor([1.0, 0.5, 1.0, 1.0], dtype=torch.float64)
    x = (torch.rand(20, 4, generator=generator, dtype=torch.float64) - 0.5) * size
    parts, rows = [], torch.arange(20)
    for k in range(40):
        if k % 5 == 0:
            u = torch.rand(20, 1, generator=generator, dtype=torch.float64) - 0.5
        ahead = x
        for _ in range(10):
            ahead = rk4(cart_pole, ahead, u, 0.001)
        parts.append((x, u, ahead))
        x = ahead
    ordered = [torch.stack([part[i] for part in parts], 1).flatten(0, 1) for i in range(3)]
    return Transitions(*ordered, 0.01, rows.repeat_interleave(40))


def test_the_pole_on_a_cart_is_found_with_its_quotient(data):
    model = SindyModel(SIGNATURE, "auto", Regression("bic"), Refinement("auto"), known={"p": "v", "theta": "omega"})
    model.fit(data)
    assert (model.coefficients != 0).sum(0).tolist() == [1, 1, 3, 3]
    (shape,) = model.library.shapes
    assert shape.frequency == pytest.approx(-0.75 * POLE / (CART + POLE), rel=1e-4)
    found = dict(zip(model.library.names, model.coefficients[:, 2].tolist(), strict=True))
    over = f"/(1 + {shape.frequency:g} cos(theta)^2)"
    assert found[f"force {over}"] == pytest.approx(LARGEST / (CART + POLE), rel=1e-4)
    assert found[f"sin(theta) cos(theta) {over}"] == pytest.approx(-0.75 * POLE * GRAVITY / (CART + POLE), rel=1e-4)


def test_a_pendulum_alone_needs_no_quotient():
    pendulum = Signature(("angle", "rate"), ("rad", "rad/s"), ("u",), (1.0, 3.0))
    names = mechanical(pendulum).names
    assert "sin(angle)" in names and not any("/(" in name for name in names)
    assert "u^2" in auto(pendulum).names


def test_what_has_no_angle_gets_polynomials():
    tank = Signature(("level", "rate"), ("m", "m/s"), ("u",), (1.0, 1.0))
    assert auto(tank).names == polynomial(tank).names
    assert angles_of(Signature(("angle",), ("rad",), ("u",), (1.0,))) == ()
    assert angles_of(Signature(("angle", "rate"), ("deg", "deg/s"), ("u",), (1.0, 1.0))) == ()


def test_the_quotient_never_divides_by_zero():
    """The farthest that a fit goes from its first guess is a factor of 30."""
    assert -1 < 30 * COUPLING < 0
