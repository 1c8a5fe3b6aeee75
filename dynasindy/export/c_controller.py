"""A controller as C99: observer, integral action, observation and policy, without Python and without a library.

The text is put together from `dynasindy/export/c`, with the numbers of the controller as constants and with what it
does not have left out. It allocates nothing and keeps everything that changes in a struct of the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynasindy.agents.networks import MLP
from dynasindy.control import Controller
from dynasindy.control.files import network
from dynasindy.export.c_model import Sources, block, field, places, signature_words
from dynasindy.export.cost import Cost, Sizes, cost
from dynasindy.export.expressions import formulas
from dynasindy.export.filter import Filter
from dynasindy.export.names import identifiers, module_name, number, rows, single
from dynasindy.export.templates import fill
from dynasindy.planning.integral import IntegralAction

_HEAD = """/* Written from a controller, not by hand. In each period, in this order:
 *
 *   advance, correct   the observer predicts to the time of the measurement, and takes it in
 *   ahead              it predicts to the time at which the next input arrives at the plant
 *   counteract         what the estimated push would do is taken out of the state, and added to the input
 *   policy             u = tanh(W LeakyReLU(...) + b) of the scaled state and error, shifted by the integral
 *   integrate          the integral takes in the error
 *
 * as far as the controller has them. */
"""


@dataclass(frozen=True)
class ControllerSources(Sources):
    """A controller in C.

    Attributes:
        cost: What a call takes.
        measured: Names of the states that are read in `y`.
        shape: Numbers of states, of inputs and of tracked states.
    """

    cost: Cost
    measured: tuple[str, ...]
    shape: tuple[int, int, int]


def controller_sources(controller: Controller, name: str = "controller") -> ControllerSources:
    """Write a controller as C functions `NAME_reset` and `NAME_act`.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`, and the model of its observer a sparse one.
        name: What the names in C, and those of the files, begin with.

    Raises:
        ValueError: The name is none, the policy or the model is of another kind, or the model has a function without a
            formula.
    """
    name, mlp = module_name(name), network(controller)
    task, signature = controller.setup.task, controller.signature
    watching = None if controller.observer is None else Filter.of(controller.observer)
    found = None if watching is None else formulas(watching.model)
    sizes = Sizes(
        signature.n_x, signature.n_u, task.n_r,
        *((0, 0, 0, 0, 0) if watching is None else watching.sizes),
        tuple((w.shape[1], w.shape[0]) for w, _ in _weights(mlp)),
        controller.integral is not None,
        *((0, 0) if found is None else (found.flops, len(found.lines))),
        0 if watching is None else watching.n_stops,
        task.observe_rate,
        watching is not None and watching.model.step is not None,
    )  # fmt: skip
    flags, words = _flags(controller), _words(controller, name)
    text = f'{_HEAD}#include "{name}.h"\n\n#include <math.h>\n\n{_sizes(sizes, name)}\n{_tables(controller)}'
    if watching is not None and found is not None:
        flags |= watching.flags
        words |= watching.words
        text += "\n/* ---- The model ---- */\n\n" + field(watching.model, found) + fill("solve.c", {})
        text += fill("flow.c", words, flags) + fill("observer.c", words, flags)
        text += fill("push.c", words, flags) if "pushed" in flags else ""
    words |= _policy(mlp, flags) | {"widest": sizes.widest}
    text += fill("policy.c", words, flags) + fill("controller.c", words, flags)
    whole, shape = cost(sizes), (signature.n_x, signature.n_u, task.n_r)
    words |= {"words": block(_told(controller, whole)), **watching_words(controller)}
    return ControllerSources(name, fill("controller.h", words, flags), text, whole, measured(controller), shape)


def measured(controller: Controller) -> tuple[str, ...]:
    """Return the names of the states that a controller has to be given."""
    if controller.observer is None:
        return controller.signature.state_names
    return tuple(controller.signature.state_names[i] for i in Filter.of(controller.observer).sensed)


def watching_words(controller: Controller) -> dict[str, str]:
    """Return what the header says of measurements."""
    if controller.observer is None:
        return {"measured": "all states"}
    seen = ", ".join(measured(controller))
    return {"measured": block([f"NaN where nothing was; the sensors are those of {seen}"])[3:].replace("\n", "\n ")}


def _flags(controller: Controller) -> set[str]:
    task = controller.setup.task
    return {
        *(["integral"] if controller.integral is not None else []),
        *(["observe_rate"] if task.observe_rate else []),
        *(["rates"] if task.rates else []),
        *(["all_rates" if len(task.rates) == task.n_r else "some_rates"] if task.rates else []),
    }


def _words(controller: Controller, name: str) -> dict[str, object]:
    """Return what stands in the gaps of the templates, the observer apart."""
    task, signature = controller.setup.task, controller.signature
    words: dict[str, object] = {
        "name": name,
        "title": "A controller: measurements and references in, inputs of the plant out.",
        "guard": f"{name.upper()}_H",
        "dt": number(controller.dt),
        "n_x": signature.n_x,
        "n_u": signature.n_u,
        "n_r": task.n_r,
        "error_scale": number(task.error_scale),
        "rates_word": ", rates of the reference" if task.observe_rate else "",
        "places": places(signature, name)
        + "".join(f",\n    {name}_r_{word} = {i}" for i, word in enumerate(identifiers(controller.outputs))),
        "of_rate": "const double rate[NR], " if task.observe_rate else "",
        "give_rate": "slope, " if task.observe_rate else "",
        "of_state": f"const {name}_state *s, " if controller.integral is not None else "",
        "give_state": "s, " if controller.integral is not None else "",
    }
    if controller.integral is not None:
        action = IntegralAction(controller.policy, controller.setup, **controller.integral)
        words |= {f"integral_{key}": number(getattr(action, key)) for key in ("gain", "band", "limit", "rate")}
    return words


def _sizes(s: Sizes, name: str) -> str:
    """Return the enumerators of sizes."""
    sizes = {"NX": f"{name}_NX", "NU": f"{name}_NU", "NR": f"{name}_NR"}
    if s.n:
        sizes |= {"N": f"{name}_N", "M": str(s.m), "MEMORY": f"{name}_MEMORY", "LATE": str(s.memory - 2)}
    return enumerators(sizes)


def enumerators(sizes: Mapping[str, object]) -> str:
    """Return numbers that are known when C is compiled."""
    lines = rows([f"{key} = {value}" for key, value in sizes.items()])
    return f"enum {{\n{lines}\n}};\n"


def _tables(controller: Controller) -> str:
    task = controller.setup.task
    tables = [
        f"/* Ranges of the states. */\nstatic const double scale[NX] = {{{joined(controller.signature.x_scale)}}};",
        f"/* Places of the tracked states. */\nstatic const int output[NR] = {{{', '.join(map(str, task.outputs))}}};",
        f"/* Extents of their targets. */\nstatic const double box[NR] = {{{joined(task.boxes().tolist())}}};",
    ]
    names = zip(("least", "most"), task.input_limits.tolist(), strict=True)
    tables += [f"/* Of the inputs. */\nstatic const double {name}[NU] = {{{joined(v)}}};" for name, v in names]
    if controller.integral is not None and task.rates:
        of_output = dict(zip(task.rated, task.rates, strict=True))
        places = ", ".join(str(of_output.get(k, -1)) for k in range(task.n_r))
        told = "and their rates" if len(of_output) == task.n_r else "and their rates, -1 where there is none"
        tables.append(f"static const int output_rate[NR] = {{{places}}}; /* {told} */")
    return "\n".join(tables) + "\n"


def joined(values: Sequence[float]) -> str:
    """Return numbers as the elements of an array."""
    return ", ".join(number(value) for value in values)


def _weights(mlp: MLP) -> list[tuple]:
    return [(layer.weight.detach().float().cpu(), layer.bias.detach().float().cpu()) for layer in mlp.layers()]


def _policy(mlp: MLP, flags: set[str]) -> dict[str, object]:
    """Return the arrays of weights, and the calls that go through the layers."""
    arrays, calls, here, there = [], [], "a", "b"
    weights = _weights(mlp)
    for k, (w, b) in enumerate(weights):
        n_out, n_in = w.shape
        for letter, values in (("w", w), ("b", b)):
            numbers = rows(single(value) for value in values.flatten().tolist())
            arrays.append(f"static const float {letter}{k}[{values.numel()}] = {{\n{numbers}\n}};")
        calls.append(f"    layer(w{k}, b{k}, {here}, {there}, {n_in}, {n_out}, {int(k == len(weights) - 1)});")
        here, there = there, here
    return {"weights": "\n".join(arrays), "layers": "\n".join(calls), "last": here}


def _told(controller: Controller, whole: Cost) -> list[str]:
    """Return what the header tells a reader."""
    signature, seconds = controller.signature, number(controller.dt)
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    targets = controller.targets_in_words()
    return [
        *signature_words(signature, controller.setup.task.input_limits.mT.tolist()),
        "r: references" + (f", planned for {', '.join(targets)}" if targets else ""),
        *(f"    {i}  {n} [{units[n]}]" for i, n in enumerate(controller.outputs)),
        "",
        f"Period: {seconds} s. {whole.flops} floating-point operations per call, one of <math.h> counted as one.",
        f"Bytes: {whole.state} of state, {whole.constants} of constants, about {whole.stack} of stack.",
    ]
