"""A controller as ONNX: its control step as one module of torch, which torch's exporter writes, and its policy alone.

The exporter is the one that follows a trace (`dynamo=False`): a step of thousands of operations takes it seconds, and
the newer one minutes, which also needs the package onnxscript.

    u, next_state = step(state, measurement, reference, rate)

`state` holds all that a controller remembers; zeros are a controller that has just been reset.

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

import copy
import io
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from dynasindy.control import Controller
from dynasindy.control.files import network
from dynasindy.control.integral import IntegralAction
from dynasindy.export.formats import field_of
from dynasindy.safe_io import replace_file
from dynasindy.sensing.observer import Belief, Observer
from dynasindy.sindy import SindyModel
from dynasindy.systems import System

OPSET, FORMAT = 17, 8
"""Versions of the operators and of the file, which runtimes since 2022 read."""
CALLS: dict[str, Any] = {
    **{name: getattr(torch, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "sign", "square")},
    "fabs": torch.abs,
    "larger": lambda a, b: torch.maximum(*(torch.as_tensor(value, dtype=torch.float64) for value in (a, b))),
}
"""What formulas call."""


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
    given = [torch.zeros(n, dtype=torch.float64) for n in (step.numbers, signature.n_x, n_r, n_r)]
    told = {"u": signature.input_names, "measurement": signature.state_names, "reference": controller.outputs}
    more = {"period": f"{controller.dt!r} s", "state": f"{step.numbers} numbers, zeros at the start"}
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
    """The policy of a controller: observations `(*batch, n_o)` to actions `(*batch, n_u)`, single precision."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.network = copy.deepcopy(network(controller)).requires_grad_(False).float().cpu()

    def forward(self, observation: Tensor) -> Tensor:
        """Return the actions."""
        action: Tensor = self.network.functional(self.network.layers(), observation)
        return action


class _ControlStep(nn.Module):
    """A call of a controller as a function of tensors, without branches on what they hold.

    Attributes:
        sizes: Numbers of each part of the state, in their order.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.policy, self.task, self.signature = _Policy(controller), controller.setup.task, controller.signature
        n_x, n_u = self.signature.n_x, self.signature.n_u
        self.sizes = {"begun": 1, "u": n_u}
        self.observer: Observer | None = None
        if controller.observer is not None:
            self.observer = copy.deepcopy(controller.observer)
            self.observer.model = _Written(controller.observer.model)
            n, late = len(self.observer.scale), self.observer.sensors.delay + self.observer.late()[0]
            self.sizes |= {"x": n, "p": n * n, "inputs": (late + 2) * n_u, "shift": n_x + n_u}
        self.action: IntegralAction | None = None
        if controller.integral is not None:
            self.action = IntegralAction(controller.policy, controller.setup, **controller.integral)
            self.sizes["sum"] = self.task.n_r

    @property
    def numbers(self) -> int:
        """Numbers of the state."""
        return sum(self.sizes.values())

    def forward(self, state: Tensor, measurement: Tensor, reference: Tensor, rate: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs, `(n_u,)`, and the state after the call; what is no number changes nothing."""
        kept = dict(zip(self.sizes, state.split([*self.sizes.values()]), strict=True))
        later = {"begun": torch.ones_like(kept["begun"])}
        x, push = measurement, None
        with _Plain():
            if self.observer is not None:
                x, push = self._estimated(self.observer, kept, measurement, later)
            u = self._acted(x, reference, rate, kept, later)
        if push is not None:
            u = u + push
        if push is not None or self.task.limited:
            low, high = self.task.input_limits.to(u)
            u = torch.minimum(torch.maximum(u, low), high)
        if self.observer is not None:
            later["inputs"] = torch.cat([kept["inputs"][len(u) :], u])
        later["u"] = u
        whole = torch.cat([later[name] for name in self.sizes])
        # As in Python: infinity is no measurement, while NaN is a lost one.
        sound = torch.cat([whole, reference, rate]).isfinite().all() & ~measurement.isinf().any()
        return torch.where(sound, u, kept["u"]), torch.where(sound, whole, state)

    def _estimated(
        self, observer: Observer, kept: Mapping[str, Tensor], y: Tensor, later: dict[str, Tensor]
    ) -> tuple[Tensor, Tensor | None]:
        """Return the state that the policy is shown, and what is added to its inputs."""
        n, n_x, n_u = len(observer.scale), self.signature.n_x, self.signature.n_u
        inputs = kept["inputs"].reshape(-1, n_u)
        belief = Belief(kept["x"], kept["p"].reshape(n, n))
        first, moved = observer.begin(y), observer.correct(observer.advance(belief, inputs), y)[0]
        begun = kept["begun"] > 0.5
        later["x"] = torch.where(begun, moved.mean, first.mean)
        later["p"] = torch.where(begun, moved.covariance, first.covariance).reshape(-1)
        later["shift"] = kept["shift"]
        shown = observer.ahead(later["x"], inputs)
        if not observer.pushed:
            return shown[:n_x], None
        later["shift"] = shift = observer.correction(shown, inputs, self.task.outputs, kept["shift"])
        return shown[:n_x] - shift[:n_x], shift[n_x : n_x + n_u]

    def _acted(
        self, x: Tensor, r: Tensor, rate: Tensor, kept: Mapping[str, Tensor], later: dict[str, Tensor]
    ) -> Tensor:
        """Return the policy's action, `(n_u,)`, and move the integral on."""
        task, scale = self.task, torch.tensor(self.signature.x_scale, dtype=x.dtype)
        box = torch.tensor(task.boxes().tolist(), dtype=x.dtype)
        error = (r - x[list(task.outputs)]) / box
        shown = [(x / scale).float(), (error / task.error_scale).float()]
        if task.observe_rate:
            shown.append((rate / box).float())
        if self.action is not None:
            shown[1] = shown[1] + (kept["sum"] / task.error_scale).float()
            slowness = rate[list(task.rated)] - x[list(task.rates)] if task.rates else rate[:0]
            later["sum"] = self.action.advanced(kept["sum"], error, slowness)
        action: Tensor = self.policy(torch.cat(shown))
        return action.double()


class _Written(System):
    """The equations of a model as plain operations; its own code keeps tensors, which would be those of a trace.

    Args:
        model: A sparse model.
    """

    def __init__(self, model: System) -> None:
        if not isinstance(model, SindyModel):
            raise ValueError(
                f"the observer works on a {type(model).__name__}, which is not written as ONNX; fit a SindyModel"
            )
        super().__init__(model.signature)
        self.field = field_of(model, CALLS)
        self.found = model.followers, model.step
        self.delay = model.delay

    @property
    def followers(self) -> dict[int, int]:
        """Those of the model."""
        return self.found[0]

    @property
    def step(self) -> float | None:
        """That of the model."""
        return self.found[1]

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Compute rates of change, `(*batch, n_x)`."""
        rates = self.field(x.unbind(-1), u.unbind(-1))
        return torch.stack([rate + torch.zeros_like(x[..., 0]) for rate in rates], -1)


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
        if function is torch.Tensor.__setitem__ and args[1][0] is ...:
            places, values = args[1][1], args[2]
            places, values = ([places], values.unsqueeze(-1)) if isinstance(places, int) else (list(places), values)
            return args[0].index_copy_(-1, torch.tensor(places), values.clone())
        if function is torch.Tensor.movedim:
            value, source, destination = args
            order = list(range(value.dim()))
            order.insert(destination % len(order), order.pop(source))
            return value.permute(order)
        if function is torch.add and kwargs:
            return args[0] + kwargs["alpha"] * args[1]
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
        whole = whole - (whole[:, c : c + 1] - columns[:, c : c + 1]) * row
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
        raise ModuleNotFoundError(
            "ONNX needs the package onnx, which is not installed; install it by pip install 'dynasindy[export]'"
        ) from error
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
