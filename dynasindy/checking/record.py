"""A check as plain numbers, as its file holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from dynasindy.checking.check import Check
from dynasindy.checking.findings import Finding


def record(found: Check, findings: Sequence[Finding] = ()) -> dict[str, Any]:
    """Return all figures as plain numbers, findings first; null stands for what is infinite or does not exist."""
    words = [{"finding": each.name, "good": each.good, "words": each.words} for each in findings]
    signature, outputs = found.loop.signature, found.loop.task.output_names
    names, eigenvalues = signature.input_names, found.rest.linear.eigenvalues
    targets = []
    for k, target in enumerate(found.targets.tolist()):
        gain = found.noise[k]
        targets.append(
            {
                "target": dict(zip(outputs, target, strict=True)),
                "rests": bool(found.rest.still[k]),
                "stable": bool(found.stable[k]),
                "spectral_radius": number(found.rest.linear.radius[k]),
                "eigenvalues": [[number(v.real), number(v.imag)] for v in eigenvalues[k] if abs(v) > 1e-6],
                "steady_error": _at(found, outputs, found.steps.steady_error, k),
                "swing": None
                if bool(found.stable[k])
                else _named((*outputs, *names), torch.cat([found.swings.outputs[k], found.swings.inputs[k]])),
                "margins": {
                    name: {key: number(value) for key, value in vars(margin).items()}
                    for name, margin in zip(names, found.margins[k], strict=False)
                },
                "noise_to_input": {
                    name: _named(signature.state_names, row) for name, row in zip(names, gain, strict=True)
                }
                if gain is not None
                else None,
                "slew": _at(found, names, found.steps.slew, k),
                "saturated": _at(found, names, found.steps.saturated, k),
            }
        )
    others = found.spread
    changes = [
        {
            "change": label,
            "spectral_radius": number(float(others.worst[k])),
            "steady_error": _named(outputs, others.farthest[k]),
            "settling": None
            if others.settling is None or others.worst[k] >= 1
            else number(float(others.settling[:, k].amax())),
        }
        for k, label in enumerate(others.labels)
    ]
    planes = [
        {"states": plane.names, "share": plane.share, "steady_error": _named(outputs, plane.steady_error)}
        for plane in found.planes
    ]
    settings = {name: list(v) if isinstance(v, tuple) else v for name, v in vars(found.settings).items()}
    flights = None if found.flown is None else vars(found.flown)
    parts = {
        "verdict": words,
        "settings": settings,
        "targets": targets,
        "flown": flights,
        "changes": changes,
        "recovery": planes,
    }
    return {**parts, "left": list(found.left)}


def number(value: float) -> float | None:
    """Return a number as JSON can hold it: None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def _named(names: Any, values: Any) -> dict[str, float | None]:
    return {name: number(float(value)) for name, value in zip(names, values, strict=True)}


def _at(found: Check, names: Any, values: Tensor, target: int) -> dict[str, float | None] | None:
    """Return figures of the step to a target; None where it was not flown yet."""
    return _named(names, values[target]) if len(found.steps.x) else None
