"""Linear-quadratic tracking with integral action (LQI), from the linearisation of any system.

| Name               | Symbol | Unit                    | Equation                                        |
| ------------------ | ------ | ----------------------- | ----------------------------------------------- |
| state, input       | x, u   | the system's            | x[k+1] = Ad x[k] + Bd u[k] about the equilibrium |
| integral           | z      | unit of the output, s   | z[k+1] = z[k] + dt (r[k] - y[k])                |
| equilibrium        | x_e, u_e | the system's          | f(x_e, u_e) = dr/dt at the outputs, 0 elsewhere |
| gain               | K      | -                       | u = u_e - K [x - x_e; z]                        |
| weights            | Q, R   | -                       | sum of x' Q x + u' R u, least (discrete Riccati) |

Source: Astrom, Wittenmark, Computer-Controlled Systems, chapter 11 (LQ) and section 9.3 (integral action).
"""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor

from dynasindy.agents.classical.base import TrackingController
from dynasindy.agents.classical.linearise import Equilibria, jacobians, zero_order_hold
from dynasindy.systems import System


class LQI(TrackingController):
    """Full-state feedback with exact feed-forward and integral action.

    The gain is that of the linearisation with all outputs at zero; the state and the input that are aimed at
    are the exact equilibrium of each reference, moving with it at its rate.

    Args:
        system: the plant, or a model of it.
        outputs: names of the tracked states, one per input.
        dt: control period [s].
        state_weights: weight per state, of the squared deviation over the state's range.
        integral_weights: weight per output, of the squared integral [1/(unit s)^2].
        input_weights: weight per input, of the squared deviation.

    Raises:
        ValueError: a number of weights does not fit, a weight is negative or an input's is zero, there is no
            equilibrium, or the linearised system cannot be stabilised.
    """

    def __init__(
        self,
        system: System,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        dt: float = 0.05,
        state_weights: Sequence[float] = (30.0, 30.0, 1.0, 1.0, 0.0, 0.0),
        integral_weights: Sequence[float] = (50.0, 50.0),
        input_weights: Sequence[float] = (1.0, 1.0),
    ) -> None:
        signature = system.signature
        super().__init__(signature, outputs, dt)
        _check("state_weights", state_weights, signature.n_x)
        _check("integral_weights", integral_weights, len(outputs))
        _check("input_weights", input_weights, signature.n_u)
        if min(input_weights) <= 0:
            raise ValueError(f"input_weights are {list(input_weights)}; give positive numbers")
        self.equilibria = Equilibria(system, outputs)
        home = torch.zeros(len(self.outputs), dtype=torch.float64)
        self.model = zero_order_hold(
            *jacobians(system, *self.equilibria.state_and_input(home, self.equilibria.home)), self.dt, system.step
        )
        self.gain = self.riccati(
            [*(w / s**2 for w, s in zip(state_weights, signature.x_scale)), *integral_weights], input_weights
        )
        self.reference = self.rate = torch.zeros(0)
        self.unknowns = self.equilibria.home

    def unlimited(self, x: Tensor, reference: Tensor, rate: Tensor, integral: Tensor) -> Tensor:
        """Return u = u_e - K [x - x_e; z]."""
        x_e, u_e = self._equilibrium(reference, rate)
        return u_e - (self.gain @ torch.cat((x - x_e, integral), -1).unsqueeze(-1)).squeeze(-1)

    def held(self, saturated: Tensor) -> Tensor:
        """Hold all integrals of a row while any of its inputs is at a limit, as each input uses all of them."""
        return saturated.any(-1, keepdim=True)

    def riccati(self, weights: Sequence[float], input_weights: Sequence[float]) -> Tensor:
        """Return the gain `(n_u, n_x + n_r)`.

        Args:
            weights: weight of the square of each state, then of each integral [1 per square of its unit].
            input_weights: weight of the square of each input.

        Raises:
            ValueError: there is no stabilising gain.
        """
        a, b = self.model
        n_x, n_r = len(a), len(self.outputs)
        output = torch.eye(n_x, dtype=torch.float64)[self.outputs]
        upper = torch.cat((a, torch.zeros(n_x, n_r, dtype=torch.float64)), -1)
        lower = torch.cat((-self.dt * output, torch.eye(n_r, dtype=torch.float64)), -1)
        f = torch.cat((upper, lower)).numpy()
        g = torch.cat((b, torch.zeros(n_r, b.shape[1], dtype=torch.float64))).numpy()
        q, r = np.diag(np.asarray(weights, dtype=float)), np.diag(np.asarray(input_weights, dtype=float))
        try:
            p = solve_discrete_are(f, g, q, r)
        except np.linalg.LinAlgError:
            p = np.zeros_like(q)
        gain = np.linalg.solve(r + g.T @ p @ g, g.T @ p @ f)
        radius = np.abs(np.linalg.eigvals(f - g @ gain)).max()
        if not radius < 1 - 1e-9:
            raise ValueError(
                f"these weights and outputs give no stabilising LQI gain (largest eigenvalue {radius:.6f}); "
                "give every output an integral weight > 0"
            )
        return torch.as_tensor(gain)

    def _equilibrium(self, reference: Tensor, rate: Tensor) -> tuple[Tensor, Tensor]:
        """Return x_e, u_e; solved anew when the reference moves, from where it was."""
        if not (torch.equal(reference, self.reference) and torch.equal(rate, self.rate)):
            guess = self.unknowns if self.reference.shape == reference.shape else None
            self.unknowns = self.equilibria(reference, guess, self.equilibria.moving(rate))
            self.reference, self.rate = reference.clone(), rate.clone()
        return self.equilibria.state_and_input(reference, self.unknowns)


def _check(name: str, weights: Sequence[float], number: int) -> None:
    if len(weights) != number or not min(weights) >= 0:
        raise ValueError(f"{name} are {list(weights)}; give {number} numbers >= 0")
