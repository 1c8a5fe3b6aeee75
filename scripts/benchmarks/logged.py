"""Twelve plants that are known by a log alone: a motor, an arm, tanks, an oven, a crane, a pole, a drone, a ship.

Each is what stands in a laboratory: sensors have steps and noise, rates have no sensor, bearings rub, motors and walls
have a state that nobody measures. Those that fall or drift are logged while a simple loop of proportions and
differences holds them, as a student writes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from dynasindy.sensing import Channel, Sensors
from dynasindy.systems import Signature, System, integrate

SUBSTEPS = 5
"""Runge-Kutta steps of a plant between two samples of its log."""
SMOOTH = 0.8
"""Part of a difference that the loop keeps of the one before."""
ENCODER = 2 * math.pi / 4096
"""Step of an encoder [rad]."""
Field = Callable[..., tuple[Tensor, ...]]
"""Rates of change, a column each, of states `(*batch, n_x)` and the columns of the inputs."""
Loop = Mapping[str, tuple[float, float]]
"""Measured states, and what an input is changed by per state and per rate of it."""


class Plant(System):
    """A plant out of a function of the columns of states and inputs.

    Args:
        signature: Names, units and ranges.
        field: Returns the rates of change of the states, a column each, under inputs in their own units.
    """

    def __init__(self, signature: Signature, field: Field) -> None:
        super().__init__(signature)
        self.field = field

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, n_x)`."""
        return torch.stack(torch.broadcast_tensors(*self.field(x, *u.unbind(-1))), -1)


@dataclass(frozen=True)
class Input:
    """An input in the unit of its actuator.

    Attributes:
        unit: Its unit.
        low: Lower end of the actuator.
        high: Upper end.
        told: Whether the user of the plant tells the ends.
    """

    unit: str = "-"
    low: float = -1.0
    high: float = 1.0
    told: bool = True


@dataclass(frozen=True)
class Case:
    """A plant, how it is logged, and what is wanted of it.

    Attributes:
        states: Name to unit; all states of the plant, measured or not.
        rates: Rates of change.
        sensors: Measured states.
        targets: Outputs, and the ends of their targets.
        known: States whose rate is another state.
        dt: Sampling time of the log [s].
        seconds: Length of the log [s].
        amplitude: Half range of the levels of each input, around `offset` [half ranges of the actuator].
        holds: Shortest and longest time for which a level is held [s].
        flight: Length of a flight [s].
        offset: Mean of each input, from the middle of its actuator [half ranges of the actuator].
        start: States that are not zero where log and flights begin.
        loop: Of each input, what it is changed by per state and per rate of it [half ranges of the actuator].
        words: Settings besides, which the user of such a plant would give.
        inputs: Inputs by name.
        columns: States that are logged in another unit than their own, which is it, and its size in their own.
    """

    states: Mapping[str, str]
    rates: Field
    sensors: Mapping[str, Channel]
    targets: Mapping[str, tuple[float, float]]
    known: Mapping[str, str]
    dt: float
    seconds: float
    amplitude: float
    holds: tuple[float, float]
    flight: float = 10.0
    offset: float = 0.0
    start: Mapping[str, float] = field(default_factory=dict)
    loop: tuple[Loop, ...] = ()
    words: tuple[str, ...] = ()
    inputs: Mapping[str, Input] = field(default_factory=lambda: {"u": Input()})
    columns: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def plant(self) -> Plant:
        """The plant itself."""
        names, units = tuple(self.states), tuple(self.states.values())
        return Plant(Signature(names, units, tuple(self.inputs), (1.0,) * len(names)), self.rates)

    @property
    def begins(self) -> Tensor:
        """State in which log and flights begin, `(n_x,)`."""
        return torch.tensor([self.start.get(name, 0.0) for name in self.states], dtype=torch.float64)

    @property
    def ends(self) -> tuple[Tensor, Tensor]:
        """Lower and upper ends of the actuators, `(n_u,)` each."""
        pairs = [(given.low, given.high) for given in self.inputs.values()]
        low, high = torch.tensor(pairs, dtype=torch.float64).unbind(-1)
        return low, high

    def record(self, seed: int) -> tuple[Tensor, Tensor]:
        """Return measurements `(T, n_x)`, NaN where there is no sensor, and inputs in their own units `(T, n_u)`.

        Args:
            seed: Seed of the inputs' levels and of the sensors' noise.
        """
        plant, rng, x = self.plant, torch.Generator().manual_seed(seed), self.begins
        sensors, (low, high), n_u = Sensors(self.sensors), self.ends, len(self.inputs)
        fed = [_Fed(loop, list(self.states), self.dt) for loop in (*self.loop, *[{}] * (n_u - len(self.loop)))]
        seen, inputs, until, level = [], [], [0] * n_u, [0.0] * n_u
        for k in range(round(self.seconds / self.dt)):
            y = sensors.read(x, plant.signature, rng)
            for i in range(n_u):
                if k >= until[i]:
                    drawn, share = torch.rand(2, generator=rng).tolist()
                    shortest, longest = self.holds
                    level[i] = 2 * drawn - 1
                    until[i] = k + max(1, round((shortest + share * (longest - shortest)) / self.dt))
            given = [self.offset + self.amplitude * level[i] + fed[i](y) for i in range(n_u)]
            share_of_range = torch.tensor(given, dtype=torch.float64).clamp(-1.0, 1.0)
            u = 0.5 * (low + high) + 0.5 * (high - low) * share_of_range
            seen.append(y)
            inputs.append(u)
            x = integrate(plant, x, u, self.dt, SUBSTEPS)[0][-1]
        return torch.stack(seen), torch.stack(inputs)


class _Fed:
    """What a simple loop of proportions and smoothed differences adds to an input.

    Args:
        loop: Its gains.
        names: Names of the states.
        dt: Sampling time [s].
    """

    def __init__(self, loop: Loop, names: list[str], dt: float) -> None:
        self.gains = torch.tensor(list(loop.values()), dtype=torch.float64).reshape(-1, 2)
        self.places, self.dt = [names.index(name) for name in loop], dt
        self.speeds = torch.zeros(len(loop), dtype=torch.float64)
        self.last: Tensor | None = None

    def __call__(self, y: Tensor) -> float:
        now = y[self.places]
        slopes = 0.0 if self.last is None else (now - self.last) / self.dt
        self.speeds, self.last = SMOOTH * self.speeds + (1 - SMOOTH) * slopes, now
        return float((self.gains * torch.stack([now, self.speeds], -1)).sum())


def _servo(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, w = x.unbind(-1)
    return w, 60 * u - 8 * w - 4 * torch.tanh(50 * w)


def _arm(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    q, w = x.unbind(-1)
    return w, 25 * u - 19.6 * torch.sin(q) - 0.6 * w - 0.3 * torch.tanh(20 * w)


def _propeller(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    a, w, speed = x.unbind(-1)
    return w, 8 * speed * speed.abs() - 9 * torch.sin(a) - 0.5 * w, (u - speed) / 0.15


def _tanks(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    one, two = (0.16 * x.clamp_min(0).sqrt()).unbind(-1)
    return 0.55 * (1 + u) - one, one - two


def _oven(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    air, wall = x.unbind(-1)
    return (wall - air) / 200 + 0.12 * (1 + u), (air - wall) / 600 + (20 - wall) / 900


def _crane(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, sway, v, w = x.unbind(-1)
    a = 6 * u - 4 * v - 0.3 * torch.tanh(50 * v)
    return v, w, a, -(9.81 * torch.sin(sway) + a * torch.cos(sway)) / 0.5 - 0.05 * w


def _pole(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, lean, v, w = x.unbind(-1)
    s, c = torch.sin(lean), torch.cos(lean)
    a = (10 * u - v + 0.1 * w * w * s - 0.2 * 9.81 * s * c) / (1 + 0.2 * s * s)
    return v, w, a, (9.81 * s - a * c) / 0.5


def _drone(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, v, thrust = x.unbind(-1)
    return v, 9.81 * thrust - 0.25 * v, (u - thrust) / 0.08


def _fan(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    (w,) = x.unbind(-1)
    return (250 * (1 + u) - 2 * w - 0.008 * w * w.abs() - 10 * torch.tanh(w),)


def _ship(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, r, rudder = x.unbind(-1)
    return r, (0.05 * rudder - r - 3000 * r**3) / 30, (0.6 * u - rudder) / 2


def _beam(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    _, v, tilt = x.unbind(-1)
    return v, -7 * torch.sin(tilt) - 0.1 * v, (0.35 * u - tilt) / 0.06


def _shaft(x: Tensor, u: Tensor) -> tuple[Tensor, ...]:
    a, b, va, vb = x.unbind(-1)
    twist = 60 * (a - b) + 20 * (a - b) ** 3 + 0.5 * (va - vb)
    return va, vb, 30 * u - 3 * va - twist, 1.5 * twist - 0.8 * vb


ANGLE = {"q": "rad", "w": "rad/s"}
STEPS = Channel(resolution=ENCODER)
CASES = {
    "servo": Case(
        states=ANGLE,
        rates=_servo,
        sensors={"q": Channel(resolution=math.pi / 1000)},
        targets={"q": (-2, 2)},
        known={"q": "w"},
        dt=0.005,
        seconds=30,
        amplitude=0.6,
        holds=(0.1, 0.6),
    ),
    "arm": Case(
        states=ANGLE,
        rates=_arm,
        sensors={"q": STEPS},
        targets={"q": (-1.2, 1.2)},
        known={"q": "w"},
        dt=0.01,
        seconds=40,
        amplitude=0.7,
        holds=(0.2, 1.5),
    ),
    "propeller": Case(
        states={**ANGLE, "speed": "-"},
        rates=_propeller,
        sensors={"q": STEPS},
        targets={"q": (0.1, 0.9)},
        known={"q": "w"},
        dt=0.02,
        seconds=60,
        amplitude=0.45,
        holds=(0.3, 2),
        offset=0.5,
    ),
    "tanks": Case(
        states={"h1": "cm", "h2": "cm"},
        rates=_tanks,
        sensors={"h1": Channel(noise=0.05), "h2": Channel(noise=0.05)},
        targets={"h2": (8, 14)},
        known={},
        dt=1.0,
        seconds=1500,
        amplitude=0.5,
        holds=(15, 80),
        flight=400,
        offset=0.1,
        start={"h1": 10.0, "h2": 10.0},
        words=('plant.library=["1",u,"sqrt(h1)","sqrt(h2)"]',),
    ),
    "oven": Case(
        states={"T": "degC", "W": "degC"},
        rates=_oven,
        sensors={"T": Channel(resolution=0.1, noise=0.05)},
        targets={"T": (50, 90)},
        known={},
        dt=5.0,
        seconds=9000,
        amplitude=0.7,
        holds=(100, 600),
        flight=3000,
        start={"T": 60.0, "W": 50.0},
    ),
    "crane": Case(
        states={"p": "m", "sway": "rad", "v": "m/s", "w": "rad/s"},
        rates=_crane,
        sensors={"p": Channel(resolution=5e-5), "sway": STEPS},
        targets={"p": (-0.4, 0.4), "sway": (0, 0)},
        known={"p": "v", "sway": "w"},
        dt=0.01,
        seconds=60,
        amplitude=0.5,
        holds=(0.2, 1),
        loop=({"p": (-0.8, 0.0)},),
    ),
    "pole": Case(
        states={"p": "m", "lean": "rad", "v": "m/s", "w": "rad/s"},
        rates=_pole,
        sensors={"p": Channel(resolution=1e-4), "lean": STEPS},
        targets={"p": (-0.4, 0.4), "lean": (0, 0)},
        known={"p": "v", "lean": "w"},
        dt=0.01,
        seconds=40,
        amplitude=0.25,
        holds=(0.1, 0.5),
        start={"lean": 0.02},
        loop=({"p": (0.5, 0.8), "lean": (5.0, 1.2)},),
    ),
    "drone": Case(
        states={"z": "m", "v": "m/s", "thrust": "-"},
        rates=_drone,
        sensors={"z": Channel(noise=0.004)},
        targets={"z": (-0.4, 0.4)},
        known={"z": "v"},
        dt=0.02,
        seconds=40,
        amplitude=0.25,
        holds=(0.2, 0.8),
        loop=({"z": (-0.35, -0.25)},),
    ),
    "fan": Case(
        states={"w": "rad/s"},
        rates=_fan,
        sensors={"w": Channel(noise=0.8)},
        targets={"w": (40, 140)},
        known={},
        dt=0.01,
        seconds=20,
        amplitude=0.6,
        holds=(0.2, 1),
        offset=0.3,
        start={"w": 60.0},
    ),
    "ship": Case(
        states={"psi": "rad", "r": "rad/s", "rudder": "rad"},
        rates=_ship,
        sensors={"psi": Channel(resolution=math.radians(0.1)), "rudder": Channel(noise=0.002)},
        targets={"psi": (-0.6, 0.6)},
        known={"psi": "r"},
        dt=1.0,
        seconds=3000,
        amplitude=0.6,
        holds=(20, 120),
        flight=400,
    ),
    "beam": Case(
        states={"r": "m", "v": "m/s", "a": "rad"},
        rates=_beam,
        sensors={"r": Channel(noise=0.001), "a": STEPS},
        targets={"r": (-0.2, 0.2)},
        known={"r": "v"},
        dt=0.02,
        seconds=60,
        amplitude=0.2,
        holds=(0.2, 1),
        start={"r": 0.05},
        loop=({"r": (1.5, 1.5)},),
    ),
    "shaft": Case(
        states={"a": "rad", "b": "rad", "va": "rad/s", "vb": "rad/s"},
        rates=_shaft,
        sensors={"a": STEPS, "b": STEPS},
        targets={"b": (-1, 1)},
        known={"a": "va", "b": "vb"},
        dt=0.01,
        seconds=40,
        amplitude=0.6,
        holds=(0.1, 0.6),
        loop=({"a": (-0.15, 0.0)},),
    ),
}
"""The plants, each with its sensors, its log and its task."""
