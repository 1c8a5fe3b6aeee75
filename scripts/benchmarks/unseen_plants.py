"""Ten more plants that are known by a log alone, written from textbooks: nothing was tuned on them before a first run.

They differ in kind from the twelve of `logged`: two links that move each other, unstable ones in closed loop, a long
delay, several inputs, a valve's square root, a titration curve, inputs in the units of their actuators.

| plant       | source                                                                                              |
| ----------- | --------------------------------------------------------------------------------------------------- |
| manipulator | Spong, Hutchinson, Vidyasagar: Robot Modeling and Control, 2006, section 7.4, planar elbow          |
| turbine     | Heier: Grid Integration of Wind Energy, 1998, power coefficient; NREL 5 MW, TP-500-38060, rotor     |
| drivetrain  | Franklin, Powell, Emami-Naeini: Feedback Control of Dynamic Systems, flexible shaft (section 2.1)   |
| exchanger   | Seborg, Edgar, Mellichamp: Process Dynamics and Control, tube in cells, pipe to the sensor          |
| bearing     | Schweitzer, Maslen: Magnetic Bearings, 2009, section 2.1, force of two magnets                      |
| cylinder    | Merritt: Hydraulic Control Systems, 1967, chapters 3 and 6, valve and piston                        |
| neutral     | Henson, Seborg: Adaptive nonlinear control of a pH neutralization process, 1994                     |
| balanced    | Åström, Murray: Feedback Systems, 2008, example 2.10, pole on a cart, with a motor in volts         |
| suspension  | Alleyne, Hedrick: Nonlinear adaptive control of active suspensions, 1995; Fialho, Balas: its damper |
| column      | Wood, Berry: Terminal composition control of a binary distillation column, 1973                     |
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from benchmarks.logged import Case, Input
from dynasindy.sensing import Channel

DEGREE = math.pi / 180
GRAVITY = 9.81
"""Acceleration of free fall [m/s^2]."""
RADIUS, SWEPT, INERTIA, TORQUE, WIND = 63.0, math.pi * 63.0**2, 4.4e7, 4.1e6, 18.0
"""Rotor of the turbine: radius [m], area [m^2], inertia [kg m^2], torque of the generator [N m], wind [m/s]."""
K1, K2 = 10**-6.35, 10**-10.25
"""Dissociation constants of carbonic acid [mol/l]."""


def _manipulator(x: Tensor, one: Tensor, two: Tensor) -> tuple[Tensor, ...]:
    _, elbow, w1, w2 = x.unbind(-1)
    m1, m2, l1, c1, c2, i1, i2 = 2.0, 1.2, 0.4, 0.2, 0.18, 0.03, 0.016
    shoulder = x[..., 0]
    d11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * elbow.cos()) + i1 + i2 + 0.05
    d12, d22 = m2 * (c2**2 + l1 * c2 * elbow.cos()) + i2, m2 * c2**2 + i2 + 0.02
    h = -m2 * l1 * c2 * elbow.sin()
    hanging = m2 * c2 * GRAVITY * torch.sin(shoulder + elbow)
    weight = (m1 * c1 + m2 * l1) * GRAVITY * shoulder.sin() + hanging
    t1 = one - h * (2 * w1 * w2 + w2**2) - weight - 0.8 * w1 - 0.3 * torch.tanh(40 * w1)
    t2 = two + h * w1**2 - hanging - 0.3 * w2 - 0.1 * torch.tanh(40 * w2)
    d = d11 * d22 - d12**2
    return w1, w2, (d22 * t1 - d12 * t2) / d, (d11 * t2 - d12 * t1) / d


def _turbine(x: Tensor, command: Tensor) -> tuple[Tensor, ...]:
    speed, pitch = x.unbind(-1)
    w = speed.clamp_min(1.0) * 2 * math.pi / 60
    fast = w * RADIUS / WIND
    slip = 1 / (1 / (fast + 0.08 * pitch) - 0.035 / (pitch**3 + 1))
    power = 0.5176 * (116 / slip - 0.4 * pitch - 5) * torch.exp(-21 / slip) + 0.0068 * fast
    turned = 0.5 * 1.225 * SWEPT * WIND**3 * power / w
    return (turned - TORQUE) / INERTIA * 60 / (2 * math.pi), (command - pitch) / 0.4


def _drivetrain(x: Tensor, volts: Tensor) -> tuple[Tensor, ...]:
    motor, load, w, v = x.unbind(-1)
    twist = 80 * (motor - load) + 0.6 * (w - v)
    return w, v, 3 * volts - 4 * w - 0.5 * torch.tanh(30 * w) - twist, 1.25 * twist - 0.3 * v


def _exchanger(x: Tensor, valve: Tensor) -> tuple[Tensor, ...]:
    shell, water = x[..., 1], [torch.full_like(x[..., 0], 15.0), *x[..., 2:].unbind(-1)]
    tube = [(a - b) / 2.5 + 0.06 * (shell - b) for a, b in zip(water[:4], water[1:5], strict=True)]
    pipe = [(a - b) / 3.0 for a, b in zip(water[4:], [*water[5:], x[..., 0]], strict=True)]
    return pipe[-1], (20 + 1.1 * valve - shell) / 12, *tube, *pipe[:-1]


def _bearing(x: Tensor, current: Tensor) -> tuple[Tensor, ...]:
    place, speed = x.unbind(-1)
    pull, back = ((2 + i) / (2 * (1 - z).clamp_min(0.1)) for i, z in ((current, place), (-current, -place)))
    return speed, 900 * (pull.square() - back.square()) - 2 * speed


def _cylinder(x: Tensor, volts: Tensor) -> tuple[Tensor, ...]:
    _, speed, pressure = x.unbind(-1)
    spool = volts / 10
    flow = 500 * spool * ((100 - spool.sign() * pressure) / 100).clamp_min(0).sqrt()
    return speed, 250 * pressure - 5 * speed - 500 * torch.tanh(speed / 5), 16 * (flow - speed) - 2 * pressure


def _neutral(x: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    ph, charge, carbon = x.unbind(-1)
    hydrogen = 10**-ph
    acid, buffer, volume = 16.6, 0.55, 2900.0
    full = acid + buffer + base
    to_charge = (acid * 3e-3 - buffer * 0.03 - base * 3.05e-3 - full * charge) / volume
    to_carbon = (buffer * 0.03 + base * 5e-5 - full * carbon) / volume
    # The balance of charges, charge + K_w / h - h + carbon share(h) = 0, holds at all times: its slope by pH is known.
    above, below = 1 + 2 * K2 / hydrogen, 1 + hydrogen / K1 + K2 / hydrogen
    slopes = 2 * K2 / hydrogen, K2 / hydrogen - hydrogen / K1
    by_ph = math.log(10) * (1e-14 / hydrogen + hydrogen + carbon * (slopes[0] * below - above * slopes[1]) / below**2)
    return -(to_charge + above / below * to_carbon) / by_ph, to_charge, to_carbon


def _balanced(x: Tensor, volts: Tensor) -> tuple[Tensor, ...]:
    _, lean, v, w = x.unbind(-1)
    cart, pole, middle, inertia = 0.6, 0.2, 0.3, 0.006
    s, c = lean.sin(), lean.cos()
    force = 1.2 * volts - 6 * v - 0.6 * torch.tanh(30 * v)
    total, turned = cart + pole, inertia + pole * middle**2
    bent, torque = force + pole * middle * w**2 * s, pole * middle * GRAVITY * s - 0.002 * w
    d = total * turned - (pole * middle * c) ** 2
    return v, w, (turned * bent - pole * middle * c * torque) / d, (total * torque - pole * middle * c * bent) / d


def _suspension(x: Tensor, force: Tensor) -> tuple[Tensor, ...]:
    body, wheel, v, w = x.unbind(-1)
    closing = w - v
    strut = 16.2 * (wheel - body) + 0.98 * closing - 0.4 * closing.abs() + force
    return v, w, 1000 / 290 * strut, 1000 / 59 * (-190 * wheel - strut)


def _column(x: Tensor, reflux: Tensor, steam: Tensor) -> tuple[Tensor, ...]:
    minute = 60.0
    _, _, d1, d2, b1, b2, r1, r2, r3, r4, s1, s2, s3 = x.unbind(-1)
    slow_d1, slow_d2 = (12.8 * r1 - d1) / (16.7 * minute), (-18.9 * s3 - d2) / (21.0 * minute)
    slow_b1, slow_b2 = (6.6 * r4 - b1) / (10.9 * minute), (-19.4 * s3 - b2) / (14.4 * minute)
    pipes = [(a - b) / (t * minute) for a, b, t in ((reflux - 2.45, r1, 1), (r1, r2, 2), (r2, r3, 2), (r3, r4, 2))]
    pipes += [(a - b) / minute for a, b in ((steam - 1.71, s1), (s1, s2), (s2, s3))]
    return slow_d1 + slow_d2, slow_b1 + slow_b2, slow_d1, slow_d2, slow_b1, slow_b2, *pipes


_TUBE = tuple(f"c{k}" for k in range(1, 5))
_PIPE = tuple(f"p{k}" for k in range(1, 4))
CASES = {
    "manipulator": Case(
        states={"shoulder": "rad", "elbow": "rad", "w1": "rad/s", "w2": "rad/s"},
        rates=_manipulator,
        sensors={"shoulder": Channel(resolution=2 * math.pi / 8192), "elbow": Channel(resolution=2 * math.pi / 8192)},
        targets={"shoulder": (-0.8, 0.8), "elbow": (-0.8, 0.8)},
        known={"shoulder": "w1", "elbow": "w2"},
        dt=0.01,
        seconds=60,
        amplitude=0.5,
        holds=(0.2, 1.2),
        loop=({"shoulder": (-0.2, 0.0)}, {"elbow": (-0.4, 0.0)}),
        inputs={"torque1": Input("N*m", -12, 12), "torque2": Input("N*m", -4, 4)},
    ),
    "turbine": Case(
        states={"speed": "rpm", "pitch": "deg"},
        rates=_turbine,
        sensors={"speed": Channel(noise=0.03), "pitch": Channel(resolution=0.05)},
        targets={"speed": (11, 13)},
        known={},
        dt=0.1,
        seconds=600,
        amplitude=0.12,
        holds=(2, 12),
        flight=120,
        offset=-0.1,
        start={"speed": 12.0, "pitch": 22.5},
        loop=({"speed": (0.05, 0.0)},),
        inputs={"command": Input("deg", 0, 30)},
    ),
    "drivetrain": Case(
        states={"motor": "rad", "load": "rad", "w": "rad/s", "v": "rad/s"},
        rates=_drivetrain,
        sensors={"motor": Channel(resolution=2 * math.pi / 4000)},
        targets={"motor": (-1, 1)},
        known={"motor": "w"},
        dt=0.01,
        seconds=60,
        amplitude=0.5,
        holds=(0.1, 0.8),
        loop=({"motor": (-0.1, 0.0)},),
        inputs={"voltage": Input("V", -24, 24)},
    ),
    "exchanger": Case(
        states={"T": "degC", "shell": "degC", **dict.fromkeys((*_TUBE, *_PIPE), "degC")},
        rates=_exchanger,
        sensors={"T": Channel(resolution=0.1, noise=0.05)},
        targets={"T": (30, 45)},
        known={},
        dt=1.0,
        seconds=4000,
        amplitude=0.5,
        holds=(15, 120),
        flight=600,
        offset=0.1,
        start={"T": 35.0, "shell": 70.0, **dict(zip(_TUBE, (20, 25, 30, 35))), **dict.fromkeys(_PIPE, 35.0)},
        inputs={"valve": Input("%", 0, 100)},
    ),
    "bearing": Case(
        states={"gap": "mm", "v": "mm/s"},
        rates=_bearing,
        sensors={"gap": Channel(noise=0.001)},
        targets={"gap": (-0.2, 0.2)},
        known={"gap": "v"},
        dt=0.001,
        seconds=8,
        amplitude=0.3,
        holds=(0.01, 0.1),
        flight=2,
        start={"gap": 0.02},
        loop=({"gap": (-2.5, -0.03)},),
        inputs={"current": Input("A", -2, 2)},
    ),
    "cylinder": Case(
        states={"place": "mm", "v": "mm/s", "pressure": "bar"},
        rates=_cylinder,
        sensors={"place": Channel(resolution=0.01), "pressure": Channel(noise=0.2)},
        targets={"place": (-100, 100)},
        known={"place": "v"},
        dt=0.005,
        seconds=40,
        amplitude=0.5,
        holds=(0.1, 0.6),
        loop=({"place": (-0.006, 0.0)},),
        inputs={"valve": Input("V", -10, 10)},
    ),
    "neutral": Case(
        states={"ph": "-", "charge": "mol/l", "carbon": "mol/l"},
        rates=_neutral,
        sensors={"ph": Channel(noise=0.02)},
        targets={"ph": (6, 8)},
        known={},
        dt=5.0,
        seconds=18000,
        amplitude=0.12,
        holds=(60, 400),
        flight=2400,
        offset=0.04,
        start={"ph": 7.0255, "charge": -4.32e-4, "carbon": 5.28e-4},
        inputs={"base": Input("ml/s", 0, 30)},
    ),
    "balanced": Case(
        states={"cart": "m", "lean": "rad", "v": "m/s", "w": "rad/s"},
        rates=_balanced,
        sensors={"cart": Channel(resolution=1e-4), "lean": Channel(resolution=360 / 4096 * DEGREE)},
        targets={"cart": (-0.3, 0.3), "lean": (0, 0)},
        known={"cart": "v", "lean": "w"},
        dt=0.01,
        seconds=40,
        amplitude=0.2,
        holds=(0.1, 0.6),
        start={"lean": 0.02},
        loop=({"cart": (0.5, 0.6), "lean": (3.2, 0.6)},),
        inputs={"voltage": Input("V", -12, 12, told=False)},
        columns={"lean": ("deg", DEGREE)},
        words=(f"data.states={{cart:cart,lean:{{name:lean,unit:rad,scale:{DEGREE:.8f}}}}}",),
    ),
    "suspension": Case(
        states={"body": "mm", "wheel": "mm", "v": "mm/s", "w": "mm/s"},
        rates=_suspension,
        sensors={"body": Channel(noise=0.1), "wheel": Channel(noise=0.1)},
        targets={"body": (-30, 30)},
        known={"body": "v", "wheel": "w"},
        dt=0.005,
        seconds=40,
        amplitude=0.6,
        holds=(0.05, 0.5),
        inputs={"force": Input("N", -1500, 1500)},
    ),
    "column": Case(
        states=dict.fromkeys(("top", "bottom", "d1", "d2", "b1", "b2", *(f"r{k}" for k in range(1, 5)), *"ijk"), "%"),
        rates=_column,
        sensors={"top": Channel(noise=0.02), "bottom": Channel(noise=0.02)},
        targets={"top": (-0.5, 0.5), "bottom": (-0.5, 0.5)},
        known={},
        dt=60.0,
        seconds=300000,
        amplitude=0.3,
        holds=(300, 3600),
        flight=14400,
        inputs={"reflux": Input("lb/min", 2.05, 2.85, told=False), "steam": Input("lb/min", 1.41, 2.01, told=False)},
    ),
}
"""The plants, each with its sensors, its log and its task."""
