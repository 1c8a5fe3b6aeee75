"""A task without targets: earn what the plant itself pays, as an environment of Gymnasium does.

| name         | symbol          | equation                                                                      |
| ------------ | --------------- | ----------------------------------------------------------------------------- |
| reward       | r_k             | w' Theta(x_k, u_k) or w' Theta(x_k+1, u_k), whichever leaves less over        |
| coefficients | w               | sparse regression on what was paid                                            |
| missed       |                 | root mean square of what is left over, in standard deviations of what was paid |

On the plant the reward is what the plant pays. Imagined periods need it as a function: it is given, or identified like
one more equation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from dynasindy.envs import Task
from dynasindy.sindy.library import Library, format_sum
from dynasindy.sindy.named_libraries import LibraryBuilder, build_library
from dynasindy.sindy.regression import Regression, TriangularFactor
from dynasindy.systems import Diverged, Signature

Reward = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`(x, u, x_next) -> (*batch,)`: states, inputs in [-1, 1], and the states a control period later."""

MISSED = 0.1
"""What an identified reward may leave over, in standard deviations of what was paid."""
REGRESSION = Regression(method="bic", tolerance=1e-3)
"""How it is identified; the tolerance lets functions go that explain less than a thousandth."""


class LearnedReward(Task):
    """Earn as much as possible of what the plant itself pays.

    Episodes begin where the plant begins them, and the observation is the states in their ranges.

    Args:
        signature: Names and ranges of the system's states and inputs.
        reward: The reward as a function of states, inputs and next states; None identifies it.
        library: Candidate functions of states and inputs for an identified one, as for a model.
        max_steps: Control periods per episode.

    Raises:
        ValueError: max_steps is not positive, or a function of the library cannot be read.
    """

    own = True

    def __init__(
        self,
        signature: Signature,
        reward: Reward | None = None,
        library: str | Sequence[str] | Library | LibraryBuilder = "polynomial",
        max_steps: int = 200,
    ) -> None:
        super().__init__(signature, max_steps)
        self.n_o, self.given = signature.n_x, reward
        self.library = build_library(library, signature)
        self.learnt: dict[str, Any] = {"coefficients": torch.zeros(len(self.library)).double(), "later": False}
        self._terms = self.library, self.learnt["coefficients"]

    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Return states in which the plant begins episodes, `(*batch, n_x)`; zeros where it does not say so."""
        if self.starts is None:
            return torch.zeros(*batch, self.signature.n_x)
        return self.starts[torch.randint(len(self.starts), batch, generator=generator)]

    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return the states in their ranges, `(*batch, n_x)`."""
        return x / x.new_tensor(self.signature.x_scale)

    def reward(self, x: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return what a control period without inputs earns, `(*batch,)`."""
        return self.earned(x, x.new_zeros(*x.shape[:-1], self.signature.n_u), x_next, params, t_next, at_stop)

    def earned(self, x: Tensor, u: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return what a control period earns as far as that is known, `(*batch,)`; nothing before it is identified."""
        if self.given is not None:
            return self.given(x, u.to(x), x_next)
        library, coefficients = self._terms
        return library(x_next if self.learnt["later"] else x, u.to(x)) @ coefficients.to(x)

    def learn(self, x: Tensor, u: Tensor, x_next: Tensor, paid: Tensor) -> None:
        """Identify the reward, or compare the given one with what was paid.

        Args:
            x: States, `(N, n_x)`.
            u: Inputs, `(N, n_u)`.
            x_next: States a control period later, `(N, n_x)`.
            paid: What the plant paid, `(N,)`.

        Raises:
            Diverged: The plant pays the same whatever happens, or for inputs alone, or the library cannot express it,
                or a number is not finite, or the given reward returns another shape.
        """
        x, u, x_next, paid = (values.double() for values in (x, u, x_next, paid))
        if not bool(paid.isfinite().all()):
            raise Diverged(
                f"the plant paid what is no finite number in {int((~paid.isfinite()).sum())} periods; mend its reward"
            )
        spread = float(paid.std())
        if not spread > 1e-9 * (1.0 + float(paid.abs().max())):
            raise Diverged(
                f"the plant paid {float(paid.mean()):.4g} in each of {len(paid)} periods, which tells no good state "
                "from a bad one; say what is wanted in plant.outputs, with a task that tracks them"
            )
        if self.given is not None:
            believed = self.given(x, u, x_next)
            if believed.shape != paid.shape or not bool(believed.isfinite().all()):
                raise Diverged(
                    f"task.reward returned numbers of shape {tuple(believed.shape)}, or some that are not finite; it "
                    f"has to return one finite number per period, {tuple(paid.shape)}: mend the function"
                )
            missed = float((believed - paid).square().mean().sqrt()) / spread
            self.learnt |= {"missed": missed, "spread": spread, "periods": len(paid)}
            return
        missed, later, coefficients = min(
            (self._fitted(states, u, paid, spread, later) for later, states in ((False, x), (True, x_next))),
            key=lambda found: found[0],
        )
        if not missed <= MISSED:
            raise Diverged(
                f"the functions of task.library leave {100 * missed:.3g} % over of what the plant pays, more than "
                f"{100 * MISSED:g} %, so no plan is made; add functions to plant.reward, or give task.reward a function"
            )
        read = {name for i in coefficients.nonzero().flatten().tolist() for name in self.library.features[i].variables}
        if not read & set(self.signature.state_names):
            raise Diverged(
                "what the plant paid depends on inputs alone, so that the best is to rest; excite until it pays for a "
                "state, or say what is wanted in plant.outputs, with a task that tracks them"
            )
        self.load_state_dict(
            {"coefficients": coefficients, "later": later, "missed": missed, "spread": spread, "periods": len(paid)}
        )

    @property
    def unit(self) -> float:
        """Reward that counts as one where models are judged: a standard deviation of what was paid."""
        return float(self.learnt.get("spread", 1.0))

    def summary(self) -> str:
        """Return the reward, and how much of what was paid it leaves over, in one line."""
        if "missed" not in self.learnt:
            return ""
        left = f"leaves {100 * self.learnt['missed']:.2g} % over of what {self.learnt['periods']} periods paid"
        if self.given is not None:
            return f"the function that was given, {left}"
        terms = zip(self.library.names, self.learnt["coefficients"].tolist(), strict=True)
        when = "at the end of a period" if self.learnt["later"] else "at its start"
        return f"{format_sum([term for term in terms if term[1]], 4)}, of the state {when}, {left}"

    def state_dict(self) -> dict[str, Any]:
        """Return what was learnt."""
        return dict(self.learnt)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.learnt = dict(state)
        used = self.learnt["coefficients"].nonzero().flatten().tolist() or [0]
        features = Library(self.signature, [self.library.features[i] for i in used])
        self._terms = features, self.learnt["coefficients"][used]

    def _fitted(self, x: Tensor, u: Tensor, paid: Tensor, spread: float, later: bool) -> tuple[float, bool, Tensor]:
        """Return what a sparse fit to states and inputs leaves over, and its coefficients."""
        theta = self.library(x, u)
        factor = TriangularFactor((theta, paid.unsqueeze(-1)))
        everywhere = torch.ones(len(self.library), 1, dtype=torch.bool)
        w = REGRESSION.solve(factor, everywhere, torch.zeros(len(self.library), 1).double()).squeeze(-1)
        return float((theta @ w - paid).square().mean().sqrt()) / spread, later, w
