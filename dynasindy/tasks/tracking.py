"""Track references with some states of a system."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dynasindy.systems import Signature
from dynasindy.tasks import references
from dynasindy.tasks.base import Task
from dynasindy.tasks.references import N_PARAMS, Reference
from dynasindy.tasks.reward import TrackingReward


class Tracking(Task):
    """Track a reference per output; the paper's task with outputs azimuth and pitch.

    The observation is the states divided by their ranges, the tracking errors e = r - y (paper, eq. for e)
    divided by `error_scale` and, if asked, the rates of the reference.

    Args:
        signature: Names and ranges of the system's states and inputs.
        reference: Distribution of references.
        outputs: Names of the tracked states.
        rates: Names of their rates, whose changes the reward damps.
        reward: Reward of a control period.
        max_steps: Control periods per episode (paper: 400).
        observe_rate: Append the rates of the reference to the observation, for moving references.
        error_scale: Error that counts as 1 in the observation [rad].

    Raises:
        ValueError: A named state does not exist, the numbers of outputs, rates, references and error weights
            differ, or error_scale or max_steps is not positive.
    """

    # Departure: the paper's S_tt lists the six states alone; without the errors no policy could know where
    # to go, and its text says that errors are observed.

    def __init__(
        self,
        signature: Signature,
        reference: Reference,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        rates: Sequence[str] = ("Omega_a", "Omega_p"),
        reward: TrackingReward | None = None,
        max_steps: int = 400,
        observe_rate: bool = False,
        error_scale: float = 0.5,
    ) -> None:
        super().__init__(signature, max_steps)
        reward = TrackingReward() if reward is None else reward
        counts = {len(outputs), len(rates), reference.n_r, len(reward.error_weights)}
        if len(counts) != 1:
            raise ValueError(
                f"outputs {list(outputs)}, rates {list(rates)}, {reference.n_r} references and "
                f"{len(reward.error_weights)} reward.error_weights must be equally many; complete the task"
            )
        if not error_scale > 0:
            raise ValueError(f"error_scale must be positive, got {error_scale}; give it in the unit of the outputs")
        for key, names in (("outputs", outputs), ("rates", rates)):
            if absent := [name for name in names if name not in signature.state_names]:
                raise ValueError(
                    f"state '{absent[0]}' does not exist; the states are {', '.join(signature.state_names)}: correct "
                    f"task.{key}, or plant.{key} from which it is copied"
                )
        self.output_names = tuple(outputs)
        self.outputs = [signature.state_index(name) for name in outputs]
        self.rates = [signature.state_index(name) for name in rates]
        self.references = reference
        self.reward_function = reward
        self.observe_rate = observe_rate
        self.error_scale = error_scale
        self.n_r = reference.n_r
        self.n_o = signature.n_x + (2 if observe_rate else 1) * self.n_r

    @property
    def params_shape(self) -> torch.Size:
        """Shape of one episode's reference parameters, `(n_r, 5)`."""
        return torch.Size((self.n_r, N_PARAMS))

    @property
    def error_columns(self) -> slice:
        """Columns of the observation that hold the scaled errors."""
        return slice(self.signature.n_x, self.signature.n_x + self.n_r)

    def with_reference(self, reference: Reference) -> Tracking:
        """Return the same task with another distribution of references.

        Raises:
            ValueError: The number of outputs differs.
        """
        names = self.signature.state_names
        return Tracking(
            self.signature,
            reference,
            self.output_names,
            [names[i] for i in self.rates],
            self.reward_function,
            max_steps=self.max_steps,
            observe_rate=self.observe_rate,
            error_scale=self.error_scale,
        )

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw reference parameters of new episodes, `(*batch, n_r, 5)`."""
        return self.references.sample(batch, generator)

    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Return the origin, rotors stopped, `(*batch, n_x)`: the paper starts every episode there."""
        return torch.zeros(*batch, self.signature.n_x)

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return references.value(params, t)

    def error(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return e = desired - actual (paper, eq. for e), `(*batch, n_r)`."""
        return references.value(params, t) - x[..., self.outputs]

    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return scaled states, scaled errors and, if asked, reference rates, `(*batch, n_o)`."""
        scale = torch.tensor(self.signature.x_scale, dtype=x.dtype, device=x.device)
        parts = [x / scale, self.error(x, params, t) / self.error_scale]
        if self.observe_rate:
            parts.append(references.rate(params, t))
        return torch.cat(parts, -1)

    def reward(self, x: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return the reward of a control period, `(*batch,)`, from the states at its ends."""
        change = x_next[..., self.rates] - x[..., self.rates]  # dOmega = Omega_current - Omega_previous
        return self.reward_function(self.error(x_next, params, t_next), change, at_stop)
