"""A stand-in of a rig that identification knows nothing of: `tras` with a cable, dry friction and stronger motors."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from benchmarks.common import detuned
from dynasindy.systems import System, Tras, integrate
from dynasindy.systems.tras import TrasConstants

DT, DELAY, HELD = 0.01, 1, 4.0
"""Time between two samples [s], samples until a command acts, and time for which a reference is held [s]."""
BIAS, PROPORTIONAL, INTEGRAL, DERIVATIVE = (-0.1, 0.25), (0.6, 0.3), (0.1, 0.25), (0.6, 0.15)
"""Of the PID controller under which the log is made."""
RANGE = (0.5, 0.3)
"""Largest reference of azimuth and pitch [rad]."""
STEP, NOISE = 0.0015, (20.0, 10.0)
"""Step of the encoders [rad]; standard deviation of the speeds of tail and main rotor [rpm]."""
LASTING = 0.5
"""Time in which a gust dies down [s]."""
OLD = 8
"""Samples over which the controller differences the angles."""


STIFFNESS, REST = 0.006, 0.15
"""Torque of a cable that no manual mentions [N m/rad], and the azimuth at which it pulls nowhere [rad]."""
DRY, WIDTH = 0.0012, 0.03
"""Dry friction of both bearings [N m], and the rate at which it is at 76 % of its full size [rad/s]."""


class Rig(Tras):
    """`tras` with a cable, dry friction and stronger motors."""

    def __init__(self) -> None:
        manual = detuned(TrasConstants(), 0.1, seed=3)
        # 9660 rpm/s is what a real rig's main rotor had; drag grows with it, so that its speeds stay.
        super().__init__(constants=replace(manual, motor_a=1.3 * manual.motor_a, motor_p=9660.0))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        dx, k = super().forward(x, u), self.constants
        azimuth, pitch, rate_a, rate_p, *_ = x.unbind(-1)
        inertia_a = k.inertia_a[0] * pitch.cos().square() + k.inertia_a[1]
        push_a = -STIFFNESS * (azimuth - REST) - DRY * torch.tanh(rate_a / WIDTH)
        push_p = -DRY * torch.tanh(rate_p / WIDTH)
        zero = torch.zeros_like(azimuth)
        return dx + torch.stack((zero, zero, push_a / inertia_a, push_p / k.inertia_p, zero, zero), -1)


def record_closed_loop(
    seconds: float,
    logs: int,
    gust: float = 0.0,
    plant: System | None = None,
    noise: tuple[float, float] = NOISE,
    drift: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Fly along random references and return what was logged, several logs side by side.

    Args:
        seconds: Length of each flight [s].
        logs: Flights, which differ in references and noise.
        gust: Standard deviation of accelerations that nothing explains, on both axes [rad/s^2].
        plant: What is flown; `Rig` if omitted.
        noise: Standard deviation of the speeds of tail and main rotor [rpm].
        drift: Share by which what the inputs do grows until the end.

    Returns:
        Measured states `(T, logs, 6)`, their rates NaN, and commands `(T, logs, 2)`.
    """
    plant, generator = plant or Rig(), torch.Generator().manual_seed(0)
    gains = [torch.tensor(gain, dtype=torch.float64) for gain in (BIAS, PROPORTIONAL, INTEGRAL, DERIVATIVE)]

    def _normal(*scale: float) -> Tensor:
        return torch.tensor(scale) * torch.randn(logs, 2, generator=generator, dtype=torch.float64)

    x, push = torch.zeros(logs, 6, dtype=torch.float64), _normal(gust)
    reference = integral = torch.zeros(logs, 2, dtype=torch.float64)
    past = [reference] * DELAY
    seen: list[Tensor] = []
    for k in range(round(seconds / DT)):
        if k % round(HELD / DT) == 0:
            drawn = torch.rand(logs, 2, generator=generator, dtype=torch.float64)
            reference = (2 * drawn - 1) * torch.tensor(RANGE)
        y = x.clone()
        y[:, :2] = STEP * torch.round(x[:, :2] / STEP)
        y[:, 4:] += _normal(*noise)
        y[:, 2:4] = (y[:, :2] - (seen[max(0, k - OLD)] if seen else y)[:, :2]) / (OLD * DT)
        error = reference - y[:, :2]
        u = gains[0] + gains[1] * error + gains[2] * integral - gains[3] * y[:, 2:4]
        integral = integral + DT * error.masked_fill(u.abs() > 1.0, 0.0)  # no winding up at a limit
        u = u.clamp(-1.0, 1.0)
        seen.append(y)
        past.append(u)
        with torch.no_grad():
            x = integrate(plant, x, (1 + drift * k * DT / seconds) * past[k], DT, 2, plant.stops)[0][:, -1]
        push = push * (1 - DT / LASTING) + (2 * DT / LASTING) ** 0.5 * _normal(gust)
        x[:, 2:4] += DT * push
    measured = torch.stack(seen)
    measured[..., 2:4] = torch.nan
    return measured, torch.stack(past[DELAY:])
