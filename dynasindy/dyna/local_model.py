"""A linear model of the plant near where its episodes begin, from little data: what catches a plant that falls.

| name     | symbol        | equation                                             |
| -------- | ------------- | ---------------------------------------------------- |
| model    | A, B, c       | dx/dt = A (x - x_0) + B u + c near the start x_0     |

Where all states are seen, it is found by least squares of their rates of change. Behind sensors it is fitted to the
measurements by whole trajectories, as the world model is: rates that an observer without a model makes of angles come
late, by as much as a plant that falls takes to fall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDict
from torch import Tensor

from dynasindy.data.rollout_data import transitions
from dynasindy.dyna.components import PlantComponents
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import polynomial
from dynasindy.systems import Diverged

NEAR = 1.0
"""Ranges around the start within which the linear model is fitted."""
ENOUGH = 2
"""Rows near the start per number of a linear equation; fewer would fit noise."""


@dataclass(frozen=True)
class LocalModel:
    """A linear model.

    Attributes:
        home: x_0, `(n_x,)`.
        a: A, `(n_x, n_x)` [1/s].
        b: B, `(n_x, n_u)` [1/s].
        c: `(n_x,)` [1/s].
        model: The same as a system, on which an observer can rely; None where all states are seen.
    """

    home: Tensor
    a: Tensor
    b: Tensor
    c: Tensor
    model: SindyModel | None = None


def fit_local_model(rows: TensorDict, parts: PlantComponents) -> LocalModel | None:
    """Return a linear model of what was seen near the start; None where that is too little.

    Args:
        rows: Control periods on the plant, `(T,)`.
        parts: The plant, its period, its sensors and the ranges of its states.
    """
    return _of_states(rows, parts) if parts.sensing is None else _of_measurements(rows, parts)


def _of_states(rows: TensorDict, parts: PlantComponents) -> LocalModel | None:
    scale, home = _scale(parts), rows["state"][0].double()
    data = transitions(rows, parts.plant.log_dt)
    middle = (0.5 * (data.x + data.x_next) - home) / scale
    near = (middle.abs() <= NEAR).all(-1)
    n_x, n_u = len(scale), data.u.shape[-1]
    if int(near.sum()) < ENOUGH * (n_x + n_u + 1):
        return None
    columns = torch.cat([middle, data.u, torch.ones_like(middle[:, :1])], -1)[near]
    slopes = ((data.x_next - data.x) / data.dt / scale)[near]
    # The smallest solution where the data leave a choice.
    a, b, c = torch.linalg.lstsq(columns, slopes, driver="gelsd").solution.split([n_x, n_u, 1])
    scale = scale.unsqueeze(-1)
    return LocalModel(home, a.mT * scale / scale.mT, b.mT * scale, c[0] * scale.squeeze(-1))


def _of_measurements(rows: TensorDict, parts: PlantComponents) -> LocalModel | None:
    assert parts.sensing is not None
    signature, sensors = parts.plant.system.signature, parts.sensing.observer.sensors
    scale, home = _scale(parts), rows["state"][0].double()
    n_x, n_u = len(scale), len(signature.input_names)
    # Of the rates, which were not measured, nothing is known yet.
    away = ((rows["measurement"] - home) / scale).abs()
    data = transitions(rows[~(away > NEAR).any(-1)], parts.plant.log_dt)
    if len(data) < ENOUGH * (n_x + n_u + 1):
        return None
    names = signature.state_names
    known = {a: b for a, b in (sensors.rates or {}).items() if a in names and b in names}
    refinement = Refinement(method="trajectory")
    model = SindyModel(signature, partial(polynomial, degree=1), Regression(method="bic"), refinement, known)
    try:
        model.fit(data)
    except Diverged:
        return None
    at = torch.cat([torch.zeros(1, n_x + n_u), torch.eye(n_x + n_u)]).double()
    at[:, :n_x] += home
    c, slopes = model(at[:, :n_x], at[:, n_x:]).split([1, n_x + n_u])
    a, b = (slopes - c).mT.split([n_x, n_u], -1)
    return LocalModel(home, a, b, c[0], model)


def _scale(parts: PlantComponents) -> Tensor:
    return torch.tensor(parts.plant.system.signature.x_scale, dtype=torch.float64)
