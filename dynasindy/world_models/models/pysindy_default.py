"""PySINDy as it comes, as a world model to compare with: quadratic library, finite differences, its STLSQ."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.models.base import WorldModel
from dynasindy.world_models.models.interchange import from_pysindy
from dynasindy.world_models.models.sindy import SindyModel


class PySindyDefault(WorldModel):
    """Fit by PySINDy's defaults; predict by the same sparse field as `SindyModel`.

    Args:
        signature: names, units and ranges of the plant.
    """

    def __init__(self, signature: Signature) -> None:
        super().__init__(signature)
        self.model = SindyModel(signature, "polynomial")

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Compute dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""
        return self.model(x, u)

    def fit(self, transitions: Transitions) -> None:
        """Fit to the segments of transitions, as PySINDy's list of trajectories; short ones are left out."""
        import pysindy

        data = transitions.to(torch.float64)
        labels, counts = data.segment.unique_consecutive(return_counts=True)
        parts = [data.select(data.segment == label) for label, n in zip(labels, counts, strict=True) if n >= 3]
        names = [*self.signature.state_names, *self.signature.input_names]
        theirs = pysindy.SINDy()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            states, inputs = ([getattr(p, key).numpy() for p in parts] for key in ("x", "u"))
            theirs.fit(states, t=data.dt, u=inputs, feature_names=names)
        self.model = from_pysindy(theirs, self.signature)

    def equations(self, digits: int = 4) -> list[str]:
        """Write one equation per state."""
        return self.model.equations(digits)

    def save(self, path: str | Path) -> None:
        """Write the model as the JSON that `SindyModel.load` reads."""
        self.model.save(path)
