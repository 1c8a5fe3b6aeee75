"""The whole step of a controller as an ONNX graph: observer, integral action and policy.

    u, next_state = step(state, measurement, reference, rate)

`state` holds all that a controller remembers; zeros are a controller that has just been reset. Where Python solves for
the gain of all measurements at once, the graph takes them in one after the other, which is the same as they are
independent: ONNX has no operator that solves equations.

| name    | what it is                                                  | numbers         |
| ------- | ----------------------------------------------------------- | --------------- |
| begun   | 1 after the first call                                      | 1               |
| u       | inputs of the call before                                   | n_u             |
| x, p    | the observer's estimate and its covariance                  | n, n n          |
| inputs  | those that it still needs, the last one at the end          | memory n_u      |
| shift   | what counteracts the push                                   | n_x + n_u       |
| sum     | the integral                                                | n_r             |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dynasindy.control import Controller
from dynasindy.export.c_controller import Filter
from dynasindy.export.formats import field_of
from dynasindy.export.onnx_graph import Graph, Value, functions
from dynasindy.export.onnx_policy import add_policy
from dynasindy.planning.integral import IntegralAction
from dynasindy.sensing.observer import FAR, LEAST, NUDGE, UNKNOWN, Observer
from dynasindy.sensing.offset import DAMPING, STEPS

Field = Callable[[Any, Any], Sequence[Any]]


def controller_onnx(controller: Controller, path: Path) -> None:
    """Write a control step as ONNX, in double precision, its policy in single precision as in Python.

    Names of what goes in and comes out, and the period, are told in the file.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`, and the model of its observer a sparse one.
        path: File to write.

    Raises:
        ModuleNotFoundError: onnx is not installed.
        ValueError: The policy or the model is of another kind, or the model has a function without a formula.
    """
    graph, signature = Graph(), controller.signature
    watching = None if controller.observer is None else _Watching.of(graph, controller.observer)
    sizes = {"begun": 1, "u": signature.n_u}
    if watching is not None:
        sizes |= {"x": watching.n, "p": watching.n**2, "inputs": watching.memory * signature.n_u}
        sizes |= {"shift": signature.n_x + signature.n_u}
    sizes |= {"sum": len(controller.outputs)} if controller.integral is not None else {}
    ends = [0, *accumulate(sizes.values())]
    state = graph.given("state", [ends[-1]])
    y, r, rate = (
        graph.given(name, [n])
        for name, n in (
            ("measurement", signature.n_x),
            ("reference", len(controller.outputs)),
            ("rate", len(controller.outputs)),
        )
    )
    kept = {name: state[a:b] for name, (a, b) in zip(sizes, pairwise(ends), strict=True)}
    later = {"begun": graph.constant([1.0])}
    x, du = y, None
    if watching is not None:
        x, du = watching.step(kept, y, controller.setup.task.outputs, later)
    found = _acted(graph, controller, x, r, rate, kept, later)
    if du is not None:
        found = found + du
    if du is not None or controller.setup.task.limited:
        least, most = (np.array(ends) for ends in controller.setup.task.input_limits.tolist())
        found = graph.put("Max", graph.put("Min", found, most), least)
    if watching is not None:
        later["inputs"] = graph.put("Concat", kept["inputs"][signature.n_u : sizes["inputs"]], found, axis=0)
    later["u"] = found
    whole = graph.put("Concat", *(later[name] for name in sizes), axis=0)
    # As in Python: what is no number changes nothing.
    sound = graph.put("IsNaN", (whole * 0.0).total() + (graph.put("Concat", r, rate, axis=0) * 0.0).total())
    if watching is not None:
        endless = graph.put("Cast", graph.put("IsInf", _picked(graph, y, watching.sensed)), to=11).total()
        sound = graph.put("Or", sound, graph.put("Greater", endless, 0.0))
    graph.result(kept["u"].where(sound, found), "u", [signature.n_u])
    graph.result(state.where(sound, whole), "next_state", [ends[-1]])
    told = {"u": signature.input_names, "measurement": signature.state_names, "reference": controller.outputs}
    more = {"period": f"{controller.dt!r} s", "state": f"{ends[-1]} numbers, zeros at the start"}
    if own := signature.own_inputs():
        more["units of u"] = "; ".join(own)
    graph.save(path, "controller", {name: ", ".join(words) for name, words in told.items()} | more)


def _acted(
    graph: Graph,
    controller: Controller,
    x: Value,
    r: Value,
    rate: Value,
    kept: dict[str, Value],
    later: dict[str, Value],
) -> Value:
    """Return the policy's action, `(n_u,)`, and move the integral on."""
    task, n_x = controller.setup.task, controller.signature.n_x
    box = np.array(task.boxes().tolist())
    error = (r - _picked(graph, x, task.outputs)) / box
    parts = [x / np.array(controller.signature.x_scale), error / task.error_scale]
    parts += [rate / box] if task.observe_rate else []
    seen = [graph.put("Cast", part, to=1) for part in parts]
    if controller.integral is not None:
        action = IntegralAction(controller.policy, controller.setup, **controller.integral)
        seen[1] = seen[1] + graph.put("Cast", kept["sum"] / task.error_scale, to=1)
        moving = graph.constant(np.zeros(len(box)))
        if task.rates:
            of_output = dict(zip(task.rated, task.rates, strict=True))
            places = [of_output.get(k, place) for k, place in enumerate(task.outputs)]
            moving = (rate - _picked(graph, x, places)) / (box * action.rate)
            if len(of_output) < task.n_r:  # an output without a rate tells nothing of its motion
                moving = moving * np.array([float(k in of_output) for k in range(task.n_r)])
        inside = graph.put("Cast", graph.put("Less", graph.put("Abs", error), action.band), to=11)
        total = kept["sum"] + inside * error * (action.gain * action.dt) / (moving * moving + 1.0)
        later["sum"] = graph.put("Max", graph.put("Min", total, action.limit), -action.limit)
    observation = graph.put("Concat", *seen, axis=0).reshape(1, n_x + len(box) * (2 if task.observe_rate else 1))
    acted = add_policy(graph, controller, observation)
    return graph.put("Cast", acted, to=11).reshape(controller.signature.n_u)


def _picked(graph: Graph, x: Value, places: Sequence[int]) -> Value:
    return graph.put("Gather", x, graph.places(*places), axis=0)


@dataclass
class _Watching:
    """An observer that writes itself: see `dynasindy.sensing.observer`."""

    graph: Graph
    observer: Observer
    field: Field
    sensed: tuple[int, ...]
    late: int
    part: float

    @classmethod
    def of(cls, graph: Graph, observer: Observer) -> _Watching:
        """Return the observer.

        Raises:
            ValueError: Its model is of another kind, or has a function without a formula.
        """
        found = Filter.of(observer)
        whole, part = observer.late()
        field = field_of(found.model, functions(graph))
        return cls(graph, observer, field, found.sensed, observer.sensors.delay + whole, part)

    @property
    def n(self) -> int:
        """Number of states of the observer."""
        return len(self.observer.scale)

    @property
    def memory(self) -> int:
        """Number of past inputs that it needs."""
        return self.late + 2

    def step(
        self, kept: dict[str, Value], y: Value, outputs: Sequence[int], later: dict[str, Value]
    ) -> tuple[Value, Value | None]:
        """Take in a measurement and return the state that the policy is shown, and what is added to its inputs."""
        n, n_x, n_u = self.n, self.observer.n_x, self.observer.model.signature.n_u
        inputs = kept["inputs"].reshape(self.memory, n_u)
        x, p = self._corrected(*self._advanced(kept["x"], kept["p"].reshape(n, n), inputs), y)
        first, spread = self._begun(y)
        begun = self.graph.put("Greater", kept["begun"], 0.5)
        later["x"], p = x.where(begun, first), p.where(begun, spread)
        later["p"], later["shift"] = p.reshape(n * n), kept["shift"]
        shown = self._ahead(later["x"], inputs)
        if not self.observer.pushed:
            return shown[:n_x], None
        shift = self._counteracting(shown, inputs[self.memory - 1], outputs, kept["shift"])
        later["shift"] = shift
        return shown[:n_x] - shift[:n_x], shift[n_x : n_x + n_u]

    def _begun(self, y: Value) -> tuple[Value, Value]:
        unknown = (UNKNOWN * self.observer.scale).square().numpy()
        seen, padded = self._seen(y)
        seen = self.graph.put("And", seen, self.graph.put("LessOrEqual", padded * padded, FAR**2 * unknown))
        padded = padded.where(seen, 0.0)
        variance = np.where(np.isfinite(self.observer.variance.numpy()), self.observer.variance.numpy(), 0.0)
        first = self.graph.constant(variance).where(seen, unknown)
        rests = [self.observer.model.followers.get(i, i) for i in range(self.n)]
        spread = self.graph.put("Unsqueeze", first, self.graph.places(1)) * np.eye(self.n)
        return _picked(self.graph, padded, rests) if self.observer.model.followers else padded, spread

    def _seen(self, y: Value) -> tuple[Value, Value]:
        """Return which states were measured, `(n,)`, and the measurements, zero where there is none."""
        sensor = np.zeros(self.n)
        sensor[list(self.sensed)] = 1.0
        padded = self.graph.put("Concat", y, self.graph.constant(np.full(self.n - self.observer.n_x, np.nan)), axis=0)
        seen = self.graph.put("And", padded.finite(), self.graph.constant(sensor > 0, np.bool_))
        return seen, padded.where(seen, 0.0)

    def _advanced(self, x: Value, p: Value, inputs: Value) -> tuple[Value, Value]:
        scale, n = self.observer.scale.numpy(), self.n
        steps = NUDGE * scale
        nudges = np.concatenate([np.zeros((1, n)), np.diag(steps), -np.diag(steps)])
        columns = self._period([x[i : i + 1] + nudges[:, i] for i in range(n)], inputs)
        mean = self.graph.put("Concat", *(column[:1] for column in columns), axis=0)
        around = self.graph.stack(columns)  # (n, 2 n + 1)
        across = around.transposed
        slopes = (across[1 : n + 1] - across[n + 1 : 2 * n + 1]).transposed / (2 * steps)
        noise = np.diag(((self.observer.q * self.observer.scale).square() * self.observer.dt).numpy())
        covariance = slopes @ p @ slopes.transposed + noise
        lost = self.graph.put("IsNaN", (mean * 0.0).total() + (covariance * 0.0).total())
        doubted = p + np.diag((UNKNOWN * self.observer.scale).square().numpy())
        return x.where(lost, mean), doubted.where(lost, covariance)

    def _corrected(self, x: Value, p: Value, y: Value) -> tuple[Value, Value]:
        measured, padded = self._seen(y)
        scale, variances = self.observer.scale.numpy(), self.observer.variance.numpy()
        own = ((p * np.eye(self.n)) @ np.ones((self.n, 1))).reshape(self.n) + np.where(variances < np.inf, variances, 0)
        bound = self.graph.put("Max", own, (LEAST * scale) ** 2) * FAR**2
        seen = self.graph.put("And", measured, self.graph.put("LessOrEqual", (padded - x) * (padded - x), bound))
        lost = self.graph.put("And", measured, self.graph.put("Not", seen))
        doubt = self.graph.constant((UNKNOWN * scale) ** 2).where(lost, np.zeros(self.n))
        for i in self.sensed:
            variance, unit = float(self.observer.variance[i]), np.eye(self.n)[i : i + 1]
            gain = (p @ unit.T) / (p[i][i] + variance)  # (n, 1)
            gain = gain.where(seen[i], np.zeros((self.n, 1)))
            x = x + gain.reshape(self.n) * (padded[i] - x[i])
            left = np.eye(self.n) - gain @ unit
            p = left @ p @ left.transposed + gain @ gain.transposed * variance
        return x, p + self.graph.put("Unsqueeze", doubt, self.graph.places(1)) * np.eye(self.n)

    def _ahead(self, x: Value, inputs: Value) -> Value:
        columns, observer = [x[i : i + 1] for i in range(self.n)], self.observer
        if self.part:
            columns = self._flow(columns, inputs[self.memory - self.late - 1], self.part)
        for k in range(self.late, 0, -1):
            columns = self._flow(columns, inputs[self.memory - k], observer.dt)
        moved = self.graph.put("Concat", *columns, axis=0)
        return moved.where(moved.finite(), x)

    def _period(self, columns: list[Value], inputs: Value) -> list[Value]:
        if self.part:
            columns = self._flow(columns, inputs[self.memory - self.late - 2], self.part)
        return self._flow(columns, inputs[self.memory - self.late - 1], self.observer.dt - self.part)

    def _flow(self, x: list[Value], u: Value, seconds: float) -> list[Value]:
        """Move states, one value each, on under held inputs by the steps of the observer."""
        h, count, difference = self.observer.steps(seconds)
        given = [u[i] for i in range(self.observer.model.signature.n_u)]
        for _ in range(count):
            k1 = self._rates(x, given)
            if difference:
                x = self._stopped(_moved(x, h, k1))
                continue
            k2 = self._rates(_moved(x, 0.5 * h, k1), given)
            k3 = self._rates(_moved(x, 0.5 * h, k2), given)
            k4 = self._rates(_moved(x, h, k3), given)
            x = [z + (a + 2.0 * b + 2.0 * c + d) * (h / 6.0) for z, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)]
            x = self._stopped(x)
        return x

    def _rates(self, x: list[Value], u: list[Value]) -> list[Any]:
        dx = [*self.field(x, u), *[x[0] * 0.0] * len(self.observer.pushed)]
        for place, push in zip(self.observer.pushed, x[self.observer.n_x :], strict=True):
            dx[place] = push + dx[place]
        return dx

    def _stopped(self, x: list[Value]) -> list[Value]:
        stops, graph, x = self.observer.stops, self.graph, list(x)
        if stops is None:
            return x
        for position, rate, low, high in zip(stops.positions, stops.rates, stops.low, stops.high, strict=True):
            below = graph.put("LessOrEqual", x[position], low)
            above = graph.put("GreaterOrEqual", x[position], high)
            x[position] = graph.put("Max", graph.put("Min", x[position], high), low)
            down = graph.put("And", below, graph.put("Less", x[rate], 0.0))
            up = graph.put("And", above, graph.put("Greater", x[rate], 0.0))
            x[rate] = graph.constant(0.0).where(graph.put("Or", down, up), x[rate])
        return x

    def _counteracting(self, x: Value, u: Value, outputs: Sequence[int], shift: Value) -> Value:
        """Return what counteracts the push: see `dynasindy.sensing.offset`."""
        graph, n_x, n_u = self.graph, self.observer.n_x, self.observer.model.signature.n_u
        m = n_x + n_u
        scale = np.concatenate([self.observer.scale.numpy()[:n_x], np.ones(n_u)])
        nudges = NUDGE * np.concatenate([np.zeros((1, m)), np.eye(m), -np.eye(m)]) * scale
        held = np.eye(m)[list(outputs)]
        point = graph.put("Concat", x[:n_x], u, axis=0)
        wanted = self._rates([x[i : i + 1] for i in range(self.n)], [u[i] for i in range(n_u)])[:n_x]
        for _ in range(STEPS):
            z = point - shift
            around = [z[i : i + 1] + nudges[:, i] for i in range(m)]
            rates = self.field(around[:n_x], around[n_x:])
            missed = [
                (_spread(graph, rate, 2 * m + 1) - w) / s for rate, w, s in zip(rates, wanted, scale[:n_x], strict=True)
            ]
            table = graph.stack(missed)  # (n_x, 2 m + 1)
            across = table.transposed
            slopes = (across[1 : m + 1] - across[m + 1 : 2 * m + 1]).transposed / (2 * NUDGE)
            slopes = graph.put("Concat", slopes, graph.constant(held), axis=0)
            excess = graph.put("Concat", across[:1], (-_picked(graph, shift / scale, outputs)).reshape(1, -1), axis=1)
            normal = slopes.transposed @ slopes + DAMPING * np.eye(m)
            shift = shift + _solved(graph, normal, slopes.transposed @ excess.transposed, m).reshape(m) * scale
        return graph.constant(np.zeros(m)).where(graph.put("IsNaN", (shift * 0.0).total()), shift)


def _moved(x: list[Value], h: float, k: list[Any]) -> list[Value]:
    return [z + d * h for z, d in zip(x, k, strict=True)]


def _spread(graph: Graph, rate: Any, rows: int) -> Value:
    """Return a rate as one number per row; that of a model may be the same for all."""
    return graph.constant(np.zeros(rows)) + rate


def _solved(graph: Graph, a: Value, b: Value, n: int) -> Value:
    """Return the solution of A z = b of a positive definite A, `(n, 1)`, by Gauss-Jordan elimination."""
    whole, columns = graph.put("Concat", a, b, axis=1), np.eye(n)
    for c in range(n):
        row = whole[c : c + 1] / whole[c][c]
        whole = whole - (whole @ np.eye(n + 1)[:, c : c + 1] - columns[:, c : c + 1]) @ row
    return whole @ np.eye(n + 1)[:, n:]
