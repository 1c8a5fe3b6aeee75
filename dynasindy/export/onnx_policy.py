"""The policy of a controller as an ONNX graph: observation in, action out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynasindy.control import Controller
from dynasindy.control.files import network
from dynasindy.export.onnx_graph import Graph, Value

SLOPE = 0.01
"""Slope of LeakyReLU where it is negative."""


def policy_onnx(controller: Controller, path: Path) -> None:
    """Write the policy as ONNX: `observation` `(batch, n_o)` to `action` `(batch, n_u)`, single precision.

    What the columns of the observation are is told in the file, under `observation`.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`.
        path: File to write.

    Raises:
        ModuleNotFoundError: onnx is not installed.
        ValueError: The policy is of another kind.
    """
    graph, told = Graph(), columns(controller)
    n_o, n_u = len(told["observation"]), len(told["action"])
    observation = graph.given("observation", ["batch", n_o], np.float32)
    graph.result(add_policy(graph, controller, observation), "action", ["batch", n_u], np.float32)
    graph.save(path, "policy", {name: ", ".join(words) for name, words in told.items()})


def add_policy(graph: Graph, controller: Controller, observation: Value) -> Value:
    """Return the actions of observations `(batch, n_o)`, in single precision.

    Raises:
        ValueError: The policy is of another kind.
    """
    value, layers = observation, network(controller).layers()
    for k, layer in enumerate(layers):
        weight, bias = (graph.constant(part.detach().cpu().numpy(), np.float32) for part in (layer.weight, layer.bias))
        value = graph.put("Gemm", value, weight, bias, transB=1)
        last = k == len(layers) - 1
        value = graph.put("Tanh", value) if last else graph.put("LeakyRelu", value, alpha=SLOPE)
    return value


def columns(controller: Controller) -> dict[str, list[str]]:
    """Return what each column of the observation and of the action is."""
    signature, task = controller.signature, controller.setup.task
    scaled = zip(signature.state_names, signature.x_scale, strict=True)
    observation = [f"{name} / {scale!r}" for name, scale in scaled]
    boxes = dict(zip(controller.outputs, task.boxes().tolist(), strict=True))
    observation += [f"({name} wanted - {name}) / {task.error_scale * box!r}" for name, box in boxes.items()]
    if task.observe_rate:
        observation += [f"rate of {name} wanted / {box!r}" for name, box in boxes.items()]
    return {"observation": observation, "action": list(signature.input_names)}
