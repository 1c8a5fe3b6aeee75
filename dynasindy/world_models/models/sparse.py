"""A vector field that is a sparse sum of candidate functions, as code that moves states, whatever its coefficients are.

dx/dt = Xi' Theta(x, u), or x[k+1] = x[k] + h Xi' Theta(x[k], u[k]); see `dynasindy.world_models.models.sindy`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import PRECISIONS, Signature
from dynasindy.systems.integrators import moved
from dynasindy.systems.machine import Machine
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.models.base import WorldModel
from dynasindy.world_models.writers.fast_field import Field, generate, refuse_not_finite
from dynasindy.world_models.writers.machine import machine


class SparseModel(WorldModel):
    """Coefficients of candidate functions, and the code that they come to.

    Args:
        signature: names, units and ranges of the plant.
        library: candidate functions.
        machine_code: whether states are moved by machine code, where a C compiler is found.
    """

    coefficients: Tensor

    def __init__(self, signature: Signature, library: Library, machine_code: bool = True) -> None:
        super().__init__(signature)
        self.machine_code, self.library = machine_code, library
        self.register_buffer("coefficients", torch.zeros(len(library), signature.n_x, dtype=torch.float64))
        self._field: Field | None = None
        self._field_of: tuple[Tensor, int, Library] | None = None

    @property
    def step(self) -> float | None:
        """Step of its difference equation [s], `UNTOLD` before a fit; None of a differential equation."""
        return self.library.step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Compute dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)` under inputs `(*batch, n_u)`."""
        return self._written()(x, u)

    def compiled(self, x: Tensor, u: Tensor) -> Machine | None:
        """Return the model as machine code for such states and inputs, in the memory of the CPU."""
        if not self.machine_code or x.dtype not in PRECISIONS or type(self).forward is not SparseModel.forward:
            return None
        self._forget()
        return self._machine(x, u, lambda dtype: machine(self.library, self.coefficients, dtype))

    def _written(self) -> Field:
        """Return the equations as torch code, written anew where they have changed."""
        self._forget()
        if self._field is None:
            self._field = generate(self.library, self.coefficients.cpu())
        return self._field

    def _forget(self) -> None:
        """Forget what was written of equations that have changed."""
        made_of, version, library = self._field_of or (None, 0, None)
        # The tensor itself is compared and so kept alive: its id may be that of a later one once it is gone.
        if made_of is self.coefficients and version == self.coefficients._version and library is self.library:
            return
        self._field = None
        self._machines.clear()
        refuse_not_finite(self.library, self.coefficients)
        self._field_of = self.coefficients, self.coefficients._version, self.library

    def __getstate__(self) -> dict[str, object]:
        """Leave generated code out of copies and pickles; it is written again when needed."""
        return {**super().__getstate__(), "_field": None, "_field_of": None}

    def predict(self, x: Tensor, u: Tensor, dt: float, substeps: int = 1) -> Tensor:
        """Predict states one sampling time ahead, `(*batch, n_x)`, by `substeps` Runge-Kutta steps."""
        # State-major memory: every row of an elementwise operation is contiguous.
        x, u = (t.movedim(-1, 0).contiguous().movedim(0, -1) for t in (x, u))
        return moved(self, x, u, dt, substeps)

    def simulate(self, x0: Tensor, u: Tensor, dt: float, substeps: int = 1) -> Tensor:
        """Predict trajectories open loop.

        Args:
            x0: start states, `(*batch, n_x)`.
            u: inputs held in each interval, `(*batch, T, n_u)`.
            dt: sampling time [s].
            substeps: Runge-Kutta steps per interval.

        Returns:
            States, `(*batch, T + 1, n_x)`, the start first.
        """
        states = [x0]
        for held in u.unbind(-2):
            states.append(self.predict(states[-1], held, dt, substeps))
        return torch.stack(states, -2)
