"""The policy of a controller as an ONNX graph: observation in, action out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynasindy.control import Controller
from dynasindy.control.files import network
from dynasindy.evaluation.files import whole

OPSET, FORMAT = 17, 8
"""Versions of the operators and of the file, which runtimes since 2022 read."""
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
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "ONNX needs the package onnx, which is not installed; install the extra: pip install -e '.[export]'"
        ) from error
    nodes: list[Any] = []
    weights: list[Any] = []
    value = "observation"
    layers = network(controller).layers()
    for k, layer in enumerate(layers):
        for letter, tensor in (("w", layer.weight), ("b", layer.bias)):
            weights.append(numpy_helper.from_array(tensor.detach().cpu().numpy().astype(np.float32), f"{letter}{k}"))
        nodes.append(helper.make_node("Gemm", [value, f"w{k}", f"b{k}"], [f"sum{k}"], transB=1))
        last = k == len(layers) - 1
        value = "action" if last else f"layer{k}"
        more: dict[str, Any] = {} if last else {"alpha": SLOPE}
        nodes.append(helper.make_node("Tanh" if last else "LeakyRelu", [f"sum{k}"], [value], **more))
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
        for name, width in (("observation", layers[0].weight.shape[1]), ("action", layers[-1].weight.shape[0]))
    ]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=FORMAT)
    helper.set_model_props(model, {name: ", ".join(words) for name, words in columns(controller).items()})
    with whole(path) as temporary:
        temporary.write_bytes(model.SerializeToString())


def columns(controller: Controller) -> dict[str, list[str]]:
    """Return what each column of the observation and of the action is."""
    signature, task = controller.signature, controller.pace.task
    scaled = zip(signature.state_names, signature.x_scale, strict=True)
    observation = [f"{name} / {scale!r}" for name, scale in scaled]
    boxes = dict(zip(controller.outputs, task.boxes().tolist(), strict=True))
    observation += [f"({name} wanted - {name}) / {task.error_scale * box!r}" for name, box in boxes.items()]
    if task.observe_rate:
        observation += [f"rate of {name} wanted / {box!r}" for name, box in boxes.items()]
    return {"observation": observation, "action": list(signature.input_names)}
