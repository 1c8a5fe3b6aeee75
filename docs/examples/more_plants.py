"""Twelve plants on which no setting was tuned, each written once and run with the defaults.

PYTHONPATH=docs/examples python scripts/train.py --config-dir docs/examples/conf system=maglev
"""

import torch
from torch import Tensor

from dynasindy.systems import Signature, System


class Maglev(System):
    """A steel ball below a magnet, at a gap of 10 mm under 1 A; the coil's current follows in 20 ms."""

    def __init__(self) -> None:
        super().__init__(Signature(("d", "v", "i"), ("mm", "mm/s", "A"), ("u",), (5.0, 100.0, 1.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 3)`."""
        d, v, i = x.unbind(-1)
        fall = 9810.0 - 9810.0 * 100.0 * (i / d) ** 2
        return torch.stack((v, fall, 50.0 * (1.0 + u[..., 0] - i)), -1)


class Reactor(System):
    """A stirred tank with an exothermal reaction, cooled by a jacket of 280 to 320 K; time constants of a minute."""

    def __init__(self) -> None:
        super().__init__(Signature(("c", "T"), ("mol/l", "K"), ("cooling",), (0.5, 30.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        c, t = x.unbind(-1)
        rate = 7.2e10 * torch.exp(-8750.0 / t) * c
        jacket = 300.0 + 20.0 * u[..., 0]
        return torch.stack((1.0 - c - rate, 350.0 - t + 209.2 * rate + 2.092 * (jacket - t)), -1) / 60.0


class BallOnBeam(System):
    """A ball that rolls on a beam, which a motor turns."""

    def __init__(self) -> None:
        names, units = ("r", "v", "a", "w"), ("m", "m/s", "rad", "rad/s")
        super().__init__(Signature(names, units, ("u",), (0.3, 0.5, 0.2, 1.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`."""
        r, v, a, w = x.unbind(-1)
        return torch.stack((v, 5 / 7 * (r * w * w - 9.81 * torch.sin(a)), w, 20.0 * u[..., 0] - 2.0 * w), -1)


class Furuta(System):
    """A rotary pendulum, upright at alpha = 0, on an arm that a motor of up to 10 V turns."""

    def __init__(self, ranges: tuple[float, ...] = (1.0, 0.2, 3.0, 3.0)) -> None:
        names, units = ("theta", "alpha", "w", "q"), ("rad", "rad", "rad/s", "rad/s")
        super().__init__(Signature(names, units, ("u",), ranges))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`: M (w', q') = forces, the mass matrix M with the pendulum's angle in it."""
        _, alpha, w, q = x.unbind(-1)
        s, c = torch.sin(alpha), torch.cos(alpha)
        arm, pole, coupling, weight = 8.5e-4, 1.3e-4, 1.3e-4, 0.0152
        torque = 0.005 * (10.0 * u[..., 0] - 0.042 * w) - 2e-4 * w
        first = torque - 2 * pole * s * c * w * q + coupling * s * q * q
        second = pole * s * c * w * w + weight * s - 5e-5 * q
        m11, m12, m22 = arm + pole * s * s, coupling * c, pole
        det = m11 * m22 - m12 * m12
        return torch.stack((w, q, (m22 * first - m12 * second) / det, (m11 * second - m12 * first) / det), -1)


class Arm(System):
    """A motor that lifts an arm, with dry friction."""

    def __init__(self) -> None:
        super().__init__(Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 3.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        q, w = x.unbind(-1)
        return torch.stack((w, 25.0 * u[..., 0] - 10.0 * torch.sin(q) - w - 2.0 * torch.tanh(50.0 * w)), -1)


class FourTanks(System):
    """Johansson's four tanks: two pumps, each of which feeds a lower tank and the upper one across."""

    def __init__(self) -> None:
        super().__init__(Signature(("h1", "h2", "h3", "h4"), ("cm",) * 4, ("p1", "p2"), (5.0,) * 4))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`."""
        out = torch.sqrt(2 * 981.0 * x.clamp_min(0.0)) * torch.tensor([0.071, 0.057, 0.071, 0.057]).to(x)
        q1, q2, q3, q4 = out.unbind(-1)
        p1, p2 = (3.34 * 3.0 * (1 + u)).unbind(-1)
        flows = (q3 - q1 + 0.7 * p1, q4 - q2 + 0.6 * p2, 0.4 * p2 - q3, 0.3 * p1 - q4)
        return torch.stack(flows, -1) / torch.tensor([28.0, 32.0, 28.0, 32.0]).to(x)


class Ship(System):
    """A ship's heading by Norrbin's equation, and its rudder, which follows in 2 s."""

    def __init__(self) -> None:
        super().__init__(Signature(("psi", "r", "delta"), ("rad", "rad/s", "rad"), ("u",), (1.0, 0.02, 0.5)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 3)`."""
        _, r, delta = x.unbind(-1)
        return torch.stack((r, (0.05 * delta - r - 3000.0 * r**3) / 30.0, (0.6 * u[..., 0] - delta) / 2.0), -1)


class Springs(System):
    """Three carts of 1 kg in a row, joined by hardening springs; the first is pushed, the last is to be placed."""

    def __init__(self) -> None:
        names = ("a", "b", "c", "va", "vb", "vc")
        super().__init__(Signature(names, ("m",) * 3 + ("m/s",) * 3, ("u",), (1.0,) * 6))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`."""
        a, b, c, va, vb, vc = x.unbind(-1)
        wall = -5 * a - 0.5 * va
        first = 20 * (b - a) + 10 * (b - a) ** 3 + 0.5 * (vb - va)
        second = 20 * (c - b) + 10 * (c - b) ** 3 + 0.5 * (vc - vb)
        return torch.stack((va, vb, vc, wall + first + 8 * u[..., 0], second - first, -second), -1)


class Room(System):
    """A heated room and its walls, outside which it is 5 degrees."""

    def __init__(self) -> None:
        super().__init__(Signature(("T", "W"), ("degC", "degC"), ("heater",), (10.0, 10.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        t, w = x.unbind(-1)
        return torch.stack(((w - t) / 900 + 0.01 * (1 + u[..., 0]), (t - w) / 5400 + (5.0 - w) / 10800), -1)


class Balancer(System):
    """A robot on two wheels of 0.1 m, to be moved and kept upright."""

    def __init__(self) -> None:
        names, units = ("p", "theta", "v", "omega"), ("m", "rad", "m/s", "rad/s")
        super().__init__(Signature(names, units, ("u",), (1.0, 0.2, 1.0, 1.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`: M (v', omega') = forces, with 4 kg 0.3 m above the axle of 1 kg."""
        _, theta, v, omega = x.unbind(-1)
        s, c = torch.sin(theta), torch.cos(theta)
        torque = 6.0 * u[..., 0] - 0.2 * (v / 0.1 - omega)
        first, second = 1.2 * omega**2 * s + torque / 0.1, 1.2 * 9.81 * s - torque
        m11, m12, m22 = 5.0, 1.2 * c, 0.76
        det = m11 * m22 - m12 * m12
        return torch.stack((v, omega, (m22 * first - m12 * second) / det, (m11 * second - m12 * first) / det), -1)


class Boost(System):
    """A boost converter from 12 V, averaged over its switching; a duty of 0.2 to 0.8."""

    def __init__(self) -> None:
        super().__init__(Signature(("i", "v"), ("A", "V"), ("duty",), (2.0, 10.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`, with 1 mH and 0.1 ohm, 0.5 mF and a load of 20 ohm."""
        i, v = x.unbind(-1)
        off = 0.5 - 0.3 * u[..., 0]
        return torch.stack(((12.0 - off * v - 0.1 * i) / 1e-3, (off * i - v / 20.0) / 5e-4), -1)


class Bioreactor(System):
    """Bacteria b that grow on a substrate s by Monod's law, diluted by 0.03 to 0.27 of the volume an hour."""

    def __init__(self) -> None:
        super().__init__(Signature(("b", "s"), ("g/l", "g/l"), ("feed",), (2.0, 2.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        b, s = x.unbind(-1)
        dilution, growth = 0.15 + 0.12 * u[..., 0], 0.5 * s / (0.8 + s)
        return torch.stack(((growth - dilution) * b, dilution * (8.0 - s) - growth * b / 0.5), -1) / 3600.0
