"""A controller as ONNX: its control step as one module of torch, which torch's exporter writes, and its policy alone.

The exporter is the one that follows a trace (`dynamo=False`): a step of thousands of operations takes it seconds, and
the newer one minutes, which also needs the package onnxscript.

    u, next_state = step(state, measurement, reference, rate)

`state` holds all that a controller remembers; zeros are a controller that has just been reset.

| name    | what it is                                                  | numbers         |
| ------- | ----------------------------------------------------------- | --------------- |
| u       | inputs of the call before                                   | n_u             |
| memory  | `dynasindy.control.controller.Memory`, part by part         | of its shapes   |
"""

from __future__ import annotations

import copy
import io
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from dynasindy.control import Controller
from dynasindy.control.controller import ControlLaw, Memory
from dynasindy.safe_io import replace_file
from dynasindy.sindy import SindyModel
from dynasindy.systems import Altered

OPSET, FORMAT = 17, 8
"""Versions of the operators and of the file, which runtimes since 2022 read."""


def controller_onnx(controller: Controller, path: Path) -> None:
    """Write a control step as ONNX, in double precision, its policy in single precision as in Python.

    Names of what goes in and comes out, and the period, are told in the file.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`.
        path: File to write.

    Raises:
        ModuleNotFoundError: onnx is not installed.
        ValueError: The policy is of another kind.
    """
    step, signature = _ControlStep(controller), controller.signature
    n_r = len(controller.outputs)
    given = [torch.zeros(n, dtype=torch.float64) for n in (sum(step.sizes), signature.n_x, n_r, n_r)]
    told = {"u": signature.input_names, "measurement": signature.state_names, "reference": controller.outputs}
    more = {"period": f"{controller.dt!r} s", "state": f"{sum(step.sizes)} numbers, zeros at the start"}
    if own := signature.own_inputs():
        more["units of u"] = "; ".join(own)
    words = {name: ", ".join(names) for name, names in told.items()} | more
    _save(step, given, ("state", "measurement", "reference", "rate"), ("u", "next_state"), words, path)


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
    signature, task = controller.signature, controller.setup.task
    told = [f"{name} / {scale!r}" for name, scale in zip(signature.state_names, signature.x_scale, strict=True)]
    boxes = dict(zip(controller.outputs, task.boxes().tolist(), strict=True))
    told += [f"({name} wanted - {name}) / {task.error_scale * box!r}" for name, box in boxes.items()]
    if task.observe_rate:
        told += [f"rate of {name} wanted / {box!r}" for name, box in boxes.items()]
    words = {"observation": ", ".join(told), "action": ", ".join(signature.input_names)}
    _save(_Policy(controller), [torch.zeros(2, len(told))], ("observation",), ("action",), words, path, rows=True)


class _Policy(nn.Module):
    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.network = copy.deepcopy(controller.network).requires_grad_(False).float().cpu()

    def forward(self, observation: Tensor) -> Tensor:
        """Return the actions."""
        action: Tensor = self.network.functional(self.network.layers(), observation)
        return action


class _ControlStep(nn.Module):
    """A call of a controller as a function of tensors, without branches on what they hold."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        policy = TensorDictModule(_Policy(controller), in_keys=["observation"], out_keys=["action"])
        observer = copy.deepcopy(controller.observer)
        if observer is not None:
            observer.model = _Written(observer.sparse_model)
        self.law = ControlLaw(policy, controller.setup, observer, controller.integral)
        self.shapes: tuple[tuple[int, ...], ...] = ((controller.signature.n_u,), *self.law.shapes)
        self.sizes = [math.prod(shape) for shape in self.shapes]

    def forward(self, state: Tensor, measurement: Tensor, reference: Tensor, rate: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs, `(n_u,)`, and the state after the call; what is no number changes nothing."""
        held = iter(state.split([size for size in self.sizes if size]))
        before, *kept = (
            next(held).reshape(shape) if size else torch.zeros(shape, dtype=state.dtype)
            for size, shape in zip(self.sizes, self.shapes, strict=True)
        )
        with _Plain():
            u, memory = self.law.step(Memory(*kept), measurement, reference, rate)
        u = u.double()
        whole = torch.cat([u, *(part.flatten() for part in memory if part.numel())])
        # As in Python: infinity is no measurement, while NaN is a lost one.
        sound = torch.cat([whole, reference, rate]).isfinite().all() & ~measurement.isinf().any()
        return torch.where(sound, u, before), torch.where(sound, whole, state)


class _Written(Altered):
    """The equations of a sparse model as plain operations: its own code keeps tensors, which a trace would hold."""

    def __init__(self, model: SindyModel) -> None:
        super().__init__(model)
        self.model, self.delay = model, model.delay

    @property
    def followers(self) -> dict[int, int]:
        """Those of the model."""
        return self.system.followers

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Compute rates of change, `(*batch, n_x)`."""
        return self.model.library(x, u) @ self.model.coefficients


class _Plain(TorchFunctionMode):
    """Do in plain operations what ONNX has no operator for: small positive definite systems and diagonal matrices."""

    def __torch_function__(
        self, function: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        if function is torch.linalg.solve:
            return _solved(*args)
        if function is torch.linalg.solve_ex:
            found = _solved(*args)
            return found, torch.zeros((), dtype=torch.int32)
        if function == torch.Tensor.mT.__get__:  # type: ignore[attr-defined]
            return args[0].transpose(-2, -1)
        if function is torch.Tensor.repeat_interleave:  # of one sample
            return args[0].expand(*args[0].shape[:-2], args[1], args[0].shape[-1])
        if function is torch.diag_embed:
            return torch.where(torch.eye(args[0].shape[-1]) > 0, args[0].unsqueeze(-1), 0.0)
        if function is torch.Tensor.diagonal:
            return torch.where(torch.eye(args[0].shape[-1]) > 0, args[0], 0.0).sum(-1)
        if function is torch.equal:  # of a branch that changes nothing where they are
            return False
        if function is torch.linalg.slogdet:  # of a likelihood, which a controller does not need
            return torch.linalg.slogdet(torch.eye(1, dtype=args[0].dtype))
        return function(*args, **(kwargs or {}))


def _solved(a: Tensor, b: Tensor) -> Tensor:
    """Return the solution of A z = b of a positive definite A, by Gauss-Jordan elimination."""
    n = a.shape[-1]
    whole, columns = torch.cat([a, b], -1), torch.eye(n, dtype=a.dtype)
    for c in range(n):
        row = whole[c : c + 1] / whole[c : c + 1, c : c + 1]
        whole = torch.where(columns[:, c : c + 1] > 0, row, whole - whole[:, c : c + 1] * row)
    return whole[:, n:]


@torch.no_grad()
def _save(
    module: nn.Module,
    given: Sequence[Tensor],
    names: Sequence[str],
    results: Sequence[str],
    words: Mapping[str, str],
    path: Path,
    rows: bool = False,
) -> None:
    """Write a module with what is told of it; of one input whose rows are a batch, any number of them is taken."""
    try:
        import onnx
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("ONNX needs the package onnx: pip install 'dynasindy[export]'") from error
    module.eval()
    written: Any = io.BytesIO()
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)  # of plain numbers in the trace
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the newer exporter, and of each constant in the trace
        try:
            torch.onnx.export(
                module,
                tuple(given),
                written,
                input_names=list(names),
                output_names=list(results),
                opset_version=OPSET,
                dynamic_axes={name: {0: "batch"} for name in (*names, *results)} if rows else None,
                dynamo=False,
            )
        finally:
            torch.set_default_dtype(before)
    model = onnx.load_from_string(written.getvalue())
    model.ir_version = FORMAT
    for node in model.graph.node:
        node.ClearField("doc_string")  # where in our code it is from, on this computer
    onnx.helper.set_model_props(model, dict(words))
    with replace_file(path) as file:
        file.write(model.SerializeToString())
