"""A controller in one file, of plain numbers and names: nothing in it is run when it is read.

| key         | what it holds                                                                                         |
| ----------- | ----------------------------------------------------------------------------------------------------- |
| `signature` | names, units and ranges of the states, names of the inputs                                            |
| `task`      | control period [s], Runge-Kutta steps in it, mechanical stops, tracked states, how the observation is |
|             | made, limits of the inputs, ends of the targets, null where they are not known; an end of a stop that |
|             | is null is not there                                                                                  |
| `policy`    | weights of each layer, float32 in base 64, `(n_out, n_in)` row by row, and biases                     |
| `integral`  | numbers of the integral action, or null                                                               |
| `observer`  | sensors, process noise, and the model, as in model.json; or null                                      |
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from dynasindy.agents.networks import MLP
from dynasindy.control.controller import Controller, ControlSetup
from dynasindy.control.integral import IntegralAction
from dynasindy.control.observer import Observer
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.safe_io import DamagedFileError, read_json, reading, write_json
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Stops

FORMAT = "dynasindy controller 1"
NAME = "controller.json"
"""Its name in a run folder."""
FINEST = 1000
"""Runge-Kutta steps per control period that are read."""


def save(controller: Controller, path: str | Path) -> None:
    """Write a controller, with all that it is made of.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`, and the model of its observer a sparse one.
        path: File to write.

    Raises:
        ValueError: The policy or the observer's model is of another kind, which no file holds.
    """
    task, integral, observer = controller.setup.task, controller.integral, controller.observer
    moved = observer or controller.setup
    numbers = None if integral is None else IntegralAction(controller.policy, controller.setup, **integral)
    record = {
        "format": FORMAT,
        "signature": asdict(controller.signature),
        "task": {
            "dt": controller.dt,
            "substeps": moved.substeps,
            # JSON has no infinite numbers, and an end that is not there is null.
            "stops": moved.stops
            and {
                key: [end if math.isfinite(end) else None for end in values]
                for key, values in asdict(moved.stops).items()
            },
            "outputs": list(task.output_names),
            "rates": task.rate_names,
            "observe_rate": task.observe_rate,
            "error_scale": task.error_scale,
            "box": task.boxes().tolist(),
            "targets": task.ends,
            "input_limits": task.input_limits.tolist(),
        },
        "policy": [
            {"in": w.shape[1], "out": w.shape[0], "weight": _packed(w), "bias": _packed(b)}
            for w, b in ((layer.weight, layer.bias) for layer in controller.network.layers())
        ],
        "integral": numbers and {name: getattr(numbers, name) for name in ("gain", "band", "limit", "rate")},
        "observer": observer
        and {
            "sensors": asdict(observer.sensors),
            "state": observer.state_dict(),
            "model": observer.sparse_model.record(),
        },
    }
    write_json(Path(path), record)


def load(path: str | Path) -> Controller:
    """Read a controller that `save` wrote, from its file or from the run folder that holds it.

    Args:
        path: File, or folder of a run.

    Returns:
        The controller, as it was saved.

    Raises:
        FileNotFoundError: There is no such file.
        DamagedFileError: The file is damaged, or not of this format.
    """
    file = Path(path) / NAME if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise FileNotFoundError(
            f"{file} does not exist; give a saved controller, or the folder of a run that has ended"
        )
    record = read_json(file)
    if record.get("format") != FORMAT:
        raise DamagedFileError(f"{file} is not of the format {FORMAT!r}; give a {NAME} of a run folder")
    with reading(file):
        signature = Signature(**record["signature"])
        given = record["task"]
        outputs, substeps = list(given["outputs"]), given["substeps"]
        if type(substeps) is not int or not 1 <= substeps <= FINEST:
            raise ValueError(f"substeps is {str(substeps)[:40]!r}; allowed are whole numbers from 1 to {FINEST}")
        # Files that were written before targets were kept, and before inputs had limits, have none.
        low, high = ([_number(value) for value in row] for row in given.get("targets") or ((), ()))
        task = Tracking(
            signature,
            Step([[0.0] * len(outputs)]),
            outputs,
            list(given["rates"]),
            TrackingReward(error_weights=(1.0,)),
            observe_rate=bool(given["observe_rate"]),
            error_scale=_positive(given["error_scale"]),
            low=low or None,
            high=high or None,
        )
        limits = given.get("input_limits", task.input_limits.tolist())
        task = task.with_input_limits([[_number(end) for end in row] for row in limits])
        task = task.with_box([_positive(extent) for extent in given["box"]])
        setup = ControlSetup(task, _positive(given["dt"]), substeps, _stops(given["stops"], signature.n_x))
        policy = TensorDictModule(_network(record["policy"], task), in_keys=["observation"], out_keys=["action"])
        observer, known = None, record["observer"]
        if known is not None:
            model = SindyModel.of_record(known["model"], file)
            # The ranges may differ: of an output that a log shows far beyond its targets, policy and model have each
            # its own.
            if not model.signature.alike(signature):
                raise ValueError("the model of its observer has other states than the controller")
            own = {name: value for name, value in known["sensors"].items() if name != "process_noise"}  # in older files
            observer = Observer(model, Sensors(**own), setup)
            observer.load_state_dict(known["state"])
        integral = record["integral"]
        numbers = None if integral is None else {name: _positive(value) for name, value in integral.items()}
        return Controller(policy, setup, observer, numbers)


def _network(layers: list[dict[str, Any]], task: Tracking) -> MLP:
    widths = [int(layers[0]["in"]), *(int(layer["out"]) for layer in layers)]
    if (widths[0], widths[-1]) != (task.n_o, task.signature.n_u):
        raise ValueError(
            f"its policy has {widths[0]} inputs and {widths[-1]} outputs, its task {task.n_o} and {task.signature.n_u}"
        )
    values = [
        (_unpacked(layer["weight"], n_out, n_in), _unpacked(layer["bias"], n_out))
        for layer, (n_in, n_out) in zip(layers, pairwise(widths), strict=True)
    ]
    found = MLP(widths[0], widths[-1], widths[1:-1], squash=True).requires_grad_(False)
    for own, (weight, bias) in zip(found.layers(), values, strict=True):
        own.weight.copy_(weight)
        own.bias.copy_(bias)
    return found


def _packed(values: Tensor) -> str:
    return base64.b64encode(values.detach().to(torch.float32).cpu().numpy().astype("<f4").tobytes()).decode()


def _unpacked(text: str, *shape: int) -> Tensor:
    wanted = math.prod(shape)
    # Four letters hold three bytes; the length alone tells how many weights there are, before any is decoded.
    count = (len(text) // 4 * 3 - text[-2:].count("=")) // 4
    packed = base64.b64decode(text, validate=True) if count == wanted else b""
    values = np.frombuffer(packed[: len(packed) // 4 * 4], "<f4")
    if values.size != wanted or not np.isfinite(values).all():
        raise ValueError(f"its policy has {count} weights where {wanted} finite ones belong")
    return torch.from_numpy(values.astype(np.float32)).reshape(shape)


def _number(value: object, low: float = -math.inf) -> float:
    """Return a finite number above another one; a file may hold anything."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low < value < math.inf:
        what = "a positive" if low == 0 else "a finite"
        raise ValueError(f"{str(value)[:40]!r} stands where {what} number belongs")
    return float(value)


def _positive(value: object) -> float:
    return _number(value, 0.0)


def _stops(record: Mapping[str, Any] | None, n_x: int) -> Stops | None:
    """Return the stops of a record."""
    if record is None:
        return None
    low, high = (
        tuple(none if end is None else _number(end) for end in record[key])
        for key, none in (("low", -math.inf), ("high", math.inf))
    )
    stops = Stops(tuple(record["positions"]), tuple(record["rates"]), low, high)
    stops.rows(n_x)  # refuses states that do not exist
    return stops
