"""A vector field written in torch, as CasADi expressions: traced once, operation by operation.

One rule serves the plants and every identified model alike, so that a controller's model is the very function that
the plant or the model computes: there is no second copy of any equation to keep in step with the first.
"""

from __future__ import annotations

import copy
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch.fx.experimental.proxy_tensor import make_fx

from dynasindy.systems import System

# A tensor of the trace is an array whose elements are CasADi scalars: numpy then indexes, stacks and broadcasts.
Values = np.ndarray


def casadi() -> Any:
    """Import CasADi.

    Raises:
        ModuleNotFoundError: It is not installed.
    """
    try:
        import casadi as module
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "MPC needs CasADi, which is not installed; install it by pip install 'dynasindy[mpc]'"
        ) from error
    return module


def vector_field(system: System) -> Any:
    """Return dx/dt of a system as a `casadi.Function` of `x` `(n_x,)` and `u` `(n_u,)`.

    Args:
        system: A plant or a model in elementwise torch operations, without branches on values.

    Raises:
        ModuleNotFoundError: CasADi is not installed.
        NotImplementedError: The system uses an operation that has no CasADi counterpart here.
    """
    ca = casadi()
    n_x, n_u = system.signature.n_x, system.signature.n_u
    x, u = ca.SX.sym("x", n_x), ca.SX.sym("u", n_u)
    # A batch of one: numpy turns arrays without dimensions into bare numbers.
    example = torch.full((1, n_x), 0.1, dtype=torch.float64), torch.full((1, n_u), 0.1, dtype=torch.float64)
    traced = copy.deepcopy(system)
    with torch.no_grad():
        traced(*example)  # what a model prepares at its first call is no part of the vector field
        trace = make_fx(traced)(*example)
    rates = _run(trace, [_row(ca.vertsplit(x)), _row(ca.vertsplit(u))], ca)
    return ca.Function("field", [x, u], [ca.vertcat(*rates[0])], ["x", "u"], ["dx"])


def _row(scalars: Sequence[Any]) -> Values:
    row = np.empty((1, len(scalars)), dtype=object)
    for i, scalar in enumerate(scalars):
        row[0, i] = scalar
    return row


def _run(trace: torch.fx.GraphModule, inputs: list[Values], ca: Any) -> Values:
    """Run a traced function on arrays of CasADi scalars."""
    rules, waiting = _rules(ca), iter(inputs)
    done: dict[torch.fx.Node, Any] = {}
    for node in trace.graph.nodes:
        if node.op == "placeholder":
            done[node] = next(waiting)
        elif node.op == "get_attr":
            done[node] = getattr(trace, str(node.target)).numpy().astype(object)
        else:
            args, kwargs = torch.fx.map_arg((node.args, node.kwargs), done.__getitem__)
            if node.op == "output":
                return args[0]
            done[node] = _rule(node.target, rules)(*args, **kwargs)
    raise AssertionError("a traced function ends with its output")


def _rule(target: Any, rules: dict[str, Callable[..., Any]]) -> Callable[..., Any]:
    if target is operator.getitem:
        return operator.getitem
    name = target.overloadpacket.__name__
    if name not in rules:
        raise NotImplementedError(
            f"the system uses torch's '{name}', which is not turned into CasADi; write it with elementwise operations "
            f"such as {', '.join(sorted(rules)[:5])}, or add a rule to dynasindy.agents.classical.symbolic"
        )
    return rules[name]


def _rules(ca: Any) -> dict[str, Callable[..., Any]]:
    """Return what each of torch's operations is on arrays of CasADi scalars."""
    rules: dict[str, Callable[..., Any]] = {
        "add": lambda a, b, alpha=1: a + alpha * b,
        "sub": lambda a, b, alpha=1: a - alpha * b,
        "rsub": lambda a, b, alpha=1: b - alpha * a,
        "mul": operator.mul,
        "div": operator.truediv,
        "neg": operator.neg,
        "reciprocal": lambda a: 1 / a,
        "square": lambda a: a * a,
        "pow": operator.pow,
        "addcmul": lambda a, b, c, value=1: a + value * b * c,
        "unbind": lambda a, dim=0: list(np.moveaxis(a, dim, 0)),
        "select": lambda a, dim, index: np.take(a, index, dim),
        "slice": lambda a, dim=0, start=None, end=None, step=1: a[(slice(None),) * dim + (slice(start, end, step),)],
        "stack": lambda parts, dim=0: np.stack(parts, dim),
        "cat": lambda parts, dim=0: np.concatenate(parts, dim),
        "unsqueeze": np.expand_dims,
        "squeeze": np.squeeze,
        "permute": np.transpose,
        "zeros_like": lambda a, **_: 0 * a,
        "ones_like": lambda a, **_: 0 * a + 1,
    }
    same = ("_to_copy", "lift_fresh_copy", "lift_fresh", "clone", "detach", "alias")
    rules |= dict.fromkeys(same, lambda a, **_: a)
    one = ("sin", "cos", "tan", "tanh", "exp", "log", "sqrt", "sign")
    rules |= {name: np.frompyfunc(getattr(ca, name), 1, 1) for name in one} | {"abs": np.frompyfunc(ca.fabs, 1, 1)}
    rules |= {name: np.frompyfunc(ca.logic_not, 1, 1) for name in ("bitwise_not", "logical_not")}
    rules |= {"bitwise_and": np.frompyfunc(ca.logic_and, 2, 1), "bitwise_or": np.frompyfunc(ca.logic_or, 2, 1)}
    two = ("ge", "gt", "le", "lt", "eq", "ne", "atan2")
    rules |= {name: np.frompyfunc(getattr(ca, name), 2, 1) for name in two}
    choice = {"where": np.frompyfunc(ca.if_else, 3, 1), "minimum": np.frompyfunc(ca.fmin, 2, 1)}
    return rules | choice | {"maximum": np.frompyfunc(ca.fmax, 2, 1)}
