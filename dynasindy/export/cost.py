"""What a call of the exported controller costs, counted along the C text: operations, bytes of memory."""

from __future__ import annotations

from dataclasses import dataclass

DOUBLE, FLOAT, INTEGER, FRAME = 8, 4, 4, 96
"""Bytes of a double, a float, an int, and of what a call of a function leaves on the stack besides its variables."""


@dataclass(frozen=True)
class Sizes:
    """Sizes that the cost depends on.

    Attributes:
        n_x: States of the plant.
        n_u: Its inputs.
        n_r: Tracked states.
        n: States of the observer, 0 without one.
        m: Measured states.
        memory: Past inputs that are kept.
        steps: Runge-Kutta steps of a prediction by one period.
        ahead: Runge-Kutta steps from the last measurement to the time at which an input arrives.
        layers: Inputs and outputs of each layer of the policy.
        integral: Whether there is integral action.
        flops: Operations of one evaluation of the model.
        values: Variables in one evaluation of the model.
        n_stops: Stopped positions.
        observe_rate: Whether the policy is shown how fast the reference moves.
    """

    n_x: int
    n_u: int
    n_r: int
    n: int
    m: int
    memory: int
    steps: int
    ahead: int
    layers: tuple[tuple[int, int], ...]
    integral: bool
    flops: int
    values: int
    n_stops: int
    observe_rate: bool
    difference: bool = False

    @property
    def n_p(self) -> int:
        """Number of pushes that are estimated."""
        return max(0, self.n - self.n_x)

    @property
    def widest(self) -> int:
        """Largest number of values between two layers, observation and action included."""
        return max(max(layer) for layer in self.layers)


@dataclass(frozen=True)
class Cost:
    """What a controller takes.

    Attributes:
        flops: Operations on floating-point numbers in a call, a function of <math.h> counted as one.
        state: Size of its state [bytes].
        constants: Size of its constants [bytes].
        stack: Estimate of the stack that a call takes [bytes].
    """

    flops: int
    state: int
    constants: int
    stack: int


def cost(sizes: Sizes) -> Cost:
    """Return what a controller of these sizes takes."""
    return Cost(_flops(sizes), _state(sizes), _constants(sizes), _stack(sizes))


def _flops(s: Sizes) -> int:
    policy = s.n_x + (3 + 2 * s.integral + s.observe_rate) * s.n_r + s.n_u
    policy += sum((2 * n_in + 3) * n_out for n_in, n_out in s.layers) + sum(n_out for _, n_out in s.layers[:-1])
    if s.integral:
        policy += 10 * s.n_r
    if not s.n:
        return policy
    whole = policy + _advance(s) + _correct(s) + s.ahead * _step(s)
    return whole + _counteract(s) + s.n_x + s.n_u if s.n_p else whole


def _step(s: Sizes) -> int:
    if s.difference:
        return s.flops + s.n_p + 2 * s.n
    return 4 * (s.flops + s.n_p) + 16 * s.n


def _advance(s: Sizes) -> int:
    return (2 * s.n + 1) * s.steps * _step(s) + 2 * s.n + 3 * s.n**2 + 4 * s.n**3


def _correct(s: Sizes) -> int:
    return 2 * s.m + _solve(s.m, s.n) + 6 * s.m * s.n**2 + 2 * s.n * s.m


def _counteract(s: Sizes) -> int:
    n_z = s.n_x + s.n_u
    column = 2 * s.flops + 3 + 3 * s.n_x
    normal = n_z * s.n_x * 2 * (1 + n_z) + 3 * s.n_r
    turn = n_z * (1 + column) + s.flops + 2 * s.n_x + normal + _solve(n_z, 1) + 2 * n_z
    return s.flops + s.n_p + 2 * turn


def _solve(n: int, m: int) -> int:
    forward = sum((n - c - 1) * (1 + 2 * (n - c - 1) + 2 * m) for c in range(n))
    return forward + sum(m * (2 * (n - 1 - i) + 1) for i in range(n))


def _state(s: Sizes) -> int:
    held = (s.n_x + s.n_u if s.n_p else 0) + (s.n_r if s.integral else 0) + s.n_u
    return DOUBLE * (held + (1 + s.n + s.n**2 + s.memory * s.n_u if s.n else 0))


def _constants(s: Sizes) -> int:
    weights = FLOAT * sum((n_in + 1) * n_out for n_in, n_out in s.layers)
    tables = DOUBLE * (s.n_x + s.n_r + 2 * s.n_u) + INTEGER * s.n_r * (2 if s.integral else 1)
    if s.n:
        tables += (3 * s.n + s.m) * DOUBLE + INTEGER * (s.m + s.n_p) + s.n_stops * 2 * (DOUBLE + INTEGER)
        tables += DOUBLE * (s.n_x + s.n_u) if s.n_p else 0
    return weights + tables


def _stack(s: Sizes) -> int:
    """Return the largest sum of the variables of functions that call each other."""
    n_z, field = s.n_x + s.n_u, DOUBLE * s.values + FRAME
    act = DOUBLE * (max(s.n, s.n_x) + s.n_r + s.n_u) + FRAME
    flow = DOUBLE * (1 if s.difference else 3) * s.n + 2 * FRAME + field
    paths = [2 * FLOAT * s.widest + 2 * FRAME]
    if s.n:
        paths.append(DOUBLE * (2 * s.n**2 + 3 * s.n) + 2 * FRAME + flow)
        paths.append(DOUBLE * (s.m**2 + s.m * s.n + s.n**2 + 2 * s.m) + 2 * FRAME)
    if s.n_p:
        paths.append(DOUBLE * (s.n_x * n_z + n_z**2 + 2 * n_z + 3 * s.n_x) + FRAME + max(field, FRAME))
    return act + max(paths)
