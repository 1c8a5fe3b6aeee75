"""State observer: an extended Kalman filter on the identified model, batched, at the control rate.

| name         | symbol                         | shape                |
| ------------ | ------------------------------ | -------------------- |
| `mean`       | x                              | `(*batch, n)`        |
| `covariance` | P                              | `(*batch, n, n)`     |
| `transition` | F = dx_k+1/dx_k                | `(*batch, n, n)`     |
| `variance`   | R, diagonal                    | `(n,)`               |
| `noise`      | Q = diag((q x_scale)^2) dt     | `(n,)`               |
| `nis`        | v' S^-1 v, v = y - x           | `(*batch,)`          |

The n states are those of the plant and, if they are to be estimated, constant pushes on some of their rates.

Source: the usual equations, e.g. Simon, Optimal State Estimation (2006), sections 5.1 and 13.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from dynasindy.envs.sensors import LONGEST, Sensors
from dynasindy.findings import FindingError
from dynasindy.sindy import SindyModel
from dynasindy.systems import Altered, Diverged, Signature, System, integrate
from dynasindy.systems.equilibria import central_differences
from dynasindy.systems.kalman import kalman_update
from dynasindy.systems.machine import Machine
from dynasindy.systems.steps import split_delay, steps_of

if TYPE_CHECKING:
    from dynasindy.control.controller import ControlSetup
    from dynasindy.envs import ControlEnv

DRIFTING = 0.01
"""Process noise of a push [its ranges, in the time in which its state may cross its own: a second for a rate]."""
UNKNOWN = 0.1
"""Standard deviation of a state that is not measured when an episode begins, at rest [ranges of the state]."""
FOLLOWING = 1e-3
"""Process noise of states that follow their rates: before there is a model, and where all that it misses is a push."""
CANDIDATES = torch.logspace(-3, -1, 9, dtype=torch.float64)
"""Process noise to choose from. Innovations on the data of its fit flatter a model: all are doubted a little."""
NUDGE = 1e-4
"""Step of the central differences [ranges of the states and of the inputs]: right to eight digits in float64."""
STEPS, MOST_STEPS, DAMPING = 2, 10, 1e-4
"""Gauss-Newton steps per control period by which a push is counteracted, how many there are where they lead beyond the
largest shift, and how much they are damped."""
LARGEST_SHIFT = 1.2
"""Most of a state or input that counteracts a push [ranges]: beyond it lies another branch of the model, as that of a
pendulum which has turned over, and nothing is counteracted."""
FAR = 1e3
"""Innovations that no plant has, and that count as lost samples [standard deviations]; so with estimates [ranges]."""
LEAST = 0.003
"""Least standard deviation that this bound counts in [ranges of the state], so it is three ranges or more. A plant that
is kicked, or a sensor that begins anew, stays within two, however small the noise; of normal innovations the largest of
a thousand millions is six standard deviations. What is believed costs more than what is lost: one sample, as the state
is doubted then, and the next one is believed up to a hundred ranges."""


@dataclass(frozen=True)
class Belief:
    """What an observer holds of the plant.

    Attributes:
        mean: Estimated states, `(*batch, n)` float64.
        covariance: Covariance of their errors, `(*batch, n, n)`.
    """

    mean: Tensor
    covariance: Tensor


class Observer:
    """Estimate the states of a plant from what is measured of it.

    Until `learn` was called it knows of the plant which state is the rate of which, and nothing else, or a rough model
    that it was given to `lean` on. From then on it relies on the model, its input delay included: a model with an
    attribute `delay` [s] gets its inputs so much later.

    Args:
        model: World model of the plant; the observer reads it as it is at any time.
        sensors: What is measured.
        env: Control period, sub-steps and stops.
    """

    def __init__(self, model: System, sensors: Sensors, env: ControlEnv | ControlSetup) -> None:
        self.model, self.sensors = model, sensors
        self.dt, self.substeps, self.stops = env.dt, env.substeps, env.stops
        self.n_x = model.signature.n_x
        rates = sensors.rate_indices(model.signature)
        measured = sensors.variance(model.signature)
        self.pushed = list(rates.values()) or measured.isfinite().nonzero().flatten().tolist()
        if not sensors.disturbance:
            self.pushed = []
        scale = torch.tensor(model.signature.x_scale, dtype=torch.float64)
        self.scale = torch.cat([scale, scale[self.pushed]])
        self.first: System = _Kinematic(model.signature, rates)
        variance = torch.cat([measured, torch.full((len(self.pushed),), torch.inf)])
        # A perfect measurement would leave a singular matrix.
        self.variance = variance.clamp_min((1e-9 * self.scale).square())
        self.q = torch.ones_like(self.scale)  # nothing is known of states without a rate
        self.q[list(rates)], self.q[self.n_x :] = FOLLOWING, DRIFTING
        self.nis: float | None = None
        self._augmentation: _Augmented | None = None

    @property
    def memory(self) -> int:
        """How many past inputs an observer may need."""
        return self.sensors.delay + LONGEST + 2

    @property
    def learnt(self) -> bool:
        """Whether it relies on the model."""
        return self.nis is not None

    @property
    def system(self) -> System:
        """What the observer believes of the plant."""
        return self.model if self.learnt else self.first

    def begin(self, y: Tensor) -> Belief:
        """Return the belief at rest from the first measurement, `(*batch, n_x)`.

        What is not measured, or cannot be, is taken as 0, or as the state that it follows.
        """
        y = self._padded(y)
        y = y.masked_fill(y.double().square() > FAR**2 * (UNKNOWN * self.scale).square(), torch.nan)
        mean = y.double().nan_to_num(nan=0.0)
        for follower, state in self.model.followers.items():
            mean[..., follower] = mean[..., state]
        first = torch.where(y.isnan(), (UNKNOWN * self.scale).square(), self.variance)
        return Belief(mean, torch.diag_embed(first))

    def advance(self, belief: Belief, inputs: Tensor) -> Belief:
        """Predict the belief one control period ahead.

        Args:
            belief: At the time of the last measurement that has arrived.
            inputs: Commands so far, `(*batch, memory, n_u)`, the last one that of the period that has just ended.
        """
        return self.carried(belief, *self.transition(belief.mean, inputs))

    def transition(self, mean: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean one control period ahead, `(*batch, n)`, and the slope of that by the mean, `(*batch, n, n)`.

        Args:
            mean: At the time of the last measurement that has arrived, `(*batch, n)`.
            inputs: As those of `advance`.
        """
        return central_differences(lambda off: self._period(mean.unsqueeze(-2) + off, inputs), NUDGE * self.scale)

    def carried(self, belief: Belief, mean: Tensor, transition: Tensor) -> Belief:
        """Return the belief one control period later, of what `transition` returned for its mean."""
        noise = torch.diag_embed((self.q * self.scale).square() * self.dt)
        covariance = transition @ belief.covariance @ transition.mT + noise
        # A model that explodes is no ground to lose an estimate; it is doubted instead.
        sound = mean.isfinite().all(-1, keepdim=True) & covariance.isfinite().all((-2, -1)).unsqueeze(-1)
        doubted = belief.covariance + torch.diag_embed((UNKNOWN * self.scale).square())
        kept = torch.where(sound, mean, belief.mean)
        return Belief(kept, torch.where(sound.unsqueeze(-1), covariance, doubted))

    def correct(self, belief: Belief, y: Tensor) -> tuple[Belief, Tensor, Tensor]:
        """Return the belief after a measurement `(*batch, n_x)`, NaN where there is none, its NIS and log-likelihood.

        The normalised innovation squared is divided by the number of measured states, so that it is 1 on average where
        the noise levels are right; it is NaN where nothing was measured. Both are `(*batch,)`. An innovation that no
        plant has, see `FAR`, counts as a lost sample, and its state is doubted: one that truly is there is believed
        soon. An estimate that no plant has is lost, and begins anew from the measurement.

        Raises:
            Diverged: The covariance is singular, as where the model's slopes explode.
        """
        begun, y = self.begin(y), self._padded(y)
        measured, off = ~y.isnan(), y.double() - belief.mean
        own = belief.covariance.diagonal(dim1=-2, dim2=-1) + self.variance
        seen = measured & (off.square() <= FAR**2 * own.clamp_min((LEAST * self.scale).square()))
        try:
            believed = y.double().masked_fill(~seen, torch.nan)
            found = kalman_update(belief.mean, belief.covariance, believed, self.variance)
        except torch.linalg.LinAlgError as error:  # type: ignore[attr-defined]
            raise Diverged(
                f"observer: the covariance of {', '.join(self.model.signature.state_names)} has grown beyond what can "
                f"be solved within a control period of {self.dt:g} s; fit the model to more data, or shorten env.dt"
            ) from error
        mean, covariance, squared, likelihood = found
        if not torch.equal(seen, measured):
            doubt = torch.where(measured & ~seen, (UNKNOWN * self.scale).square(), 0.0)
            covariance = covariance + torch.diag_embed(doubt)
        # What a measurement confirms may be far away, as a wheel that was turned long.
        near = mean.isfinite() & (seen | (mean.abs() <= FAR * self.scale))
        sound = (near.all(-1) & covariance.isfinite().all((-2, -1))).unsqueeze(-1)
        mean = torch.where(sound, mean, begun.mean)
        covariance = torch.where(sound.unsqueeze(-1), covariance, begun.covariance)
        return Belief(mean, covariance), squared / seen.sum(-1), likelihood

    def ahead(self, mean: Tensor, inputs: Tensor) -> Tensor:
        """Predict the state at the time at which the next command arrives at the plant.

        Args:
            mean: Estimate at the time of the last measurement that has arrived, `(*batch, n)`.
            inputs: Commands so far, `(*batch, memory, n_u)`.
        """
        x = mean
        for age, seconds, steps in self.passages()[1]:
            x = self._flow(x, inputs[..., -age, :], seconds, steps)
        return torch.where(x.isfinite(), x, mean)

    def correction(self, mean: Tensor, inputs: Tensor, outputs: Sequence[int], guess: Tensor) -> Tensor:
        """Return what of state and input counteracts the estimated push; zero before there is a model.

        With it the plant is controlled free of offset: a constant push leaves no steady error. Without it, the plant
        without the push would move as the plant with the push does: f(x - dx, u - du) = f(x, u) + push, C dx = 0.
        Linearised this is 0 = A dx + B du + push. It is solved by damped Gauss-Newton steps from the solution of the
        control period before, as thrusts that go with the square of a speed have no slope at rest.

        Args:
            mean: Estimate, `(*batch, n)`.
            inputs: Commands so far, `(*batch, memory, n_u)`.
            outputs: Indices of the tracked states, which are to stay.
            guess: What was returned a control period ago, `(*batch, n_x + n_u)`.
        """
        if not self.learnt:
            return torch.zeros_like(guess)
        x, u, push = mean[..., : self.n_x], inputs[..., -1, :].double(), torch.zeros_like(mean[..., : self.n_x])
        push[..., self.pushed] = mean[..., self.n_x :]
        n_x, n_u, system = self.n_x, u.shape[-1], self.system
        scale = torch.tensor([*system.signature.x_scale, *[1.0] * n_u], dtype=x.dtype)
        eye = torch.eye(n_x + n_u, dtype=x.dtype)
        nudges, held = NUDGE * torch.cat([torch.zeros_like(eye[:1]), eye, -eye]), eye[list(outputs)]
        held = held.expand(*x.shape[:-1], *held.shape)
        wanted, point, shift = system(x, u) + push, torch.cat([x, u], -1), guess
        most = LARGEST_SHIFT * scale
        outside = torch.ones_like(shift[..., :1], dtype=torch.bool)
        for turn in range(MOST_STEPS):
            around = (point - shift).unsqueeze(-2) + nudges * scale
            rates = (system(around[..., :n_x], around[..., n_x:]) - wanted.unsqueeze(-2)) / scale[:n_x]
            excess, forth, back = rates.split([1, n_x + n_u, n_x + n_u], -2)
            slopes = torch.cat([(forth - back).mT / (2 * NUDGE), held], -2)
            missing = torch.cat([excess.squeeze(-2), -(shift / scale)[..., list(outputs)]], -1).unsqueeze(-1)
            normal = slopes.mT @ slopes + DAMPING * eye
            # Far off, where a model explodes, the matrix may be singular in spite of the damping: no number, no shift.
            step, failed = torch.linalg.solve_ex(normal, slopes.mT @ missing)
            found = shift + step.squeeze(-1).masked_fill(failed.bool().unsqueeze(-1), torch.nan) * scale
            shift = torch.where(outside, found.clamp(-most, most), shift)
            if turn + 1 >= STEPS:
                outside = outside & ~(found.abs() < most).all(-1, keepdim=True)
                if not bool(outside.any()):
                    break
        return torch.where(outside, torch.zeros_like(shift), shift)

    def follow(self, y: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Filter a log.

        Args:
            y: Measurements, `(T + 1, n_x)`.
            u: Commands in between, `(T, n_u)`.

        Returns:
            Estimates as `ahead` gives them, `(*rows, T + 1, n_x)`, and NIS and log-likelihood of each but the first,
            `(*rows, T)`; rows are those of `q`, if it has any.
        """
        rows, late = self.q.shape[:-1], self.sensors.delay
        past = torch.cat([torch.zeros(self.memory, u.shape[-1], dtype=torch.float64), u.double()])
        y = torch.cat([y[:1].expand(late, -1), y])
        belief = self.begin(y[0].expand(*rows, -1))
        means, nis, likelihoods = [self.ahead(belief.mean, past[: self.memory])], [], []
        for k in range(len(u)):
            inputs = past[k + 1 : k + 1 + self.memory]
            belief, surprise, likelihood = self.correct(self.advance(belief, inputs), y[k + 1].expand(*rows, -1))
            means.append(self.ahead(belief.mean, inputs))
            nis.append(surprise)
            likelihoods.append(likelihood)
        return torch.stack(means, -2), torch.stack(nis, -1), torch.stack(likelihoods, -1)

    @torch.no_grad()
    def smooth(self, y: Tensor, u: Tensor) -> Tensor:
        """Return the states of a log by all of its measurements, before and after, `(T + 1, n_x)`.

        Source: Rauch, Tung and Striebel (1965).

        Args:
            y: Measurements, `(T + 1, n_x)`.
            u: Commands in between, `(T, n_u)`.
        """
        past = torch.cat([torch.zeros(self.memory, u.shape[-1], dtype=torch.float64), u.double()])
        beliefs, ahead, slopes = [self.begin(y[0])], list[Belief](), list[Tensor]()
        for k, measured in enumerate(y[1:], 1):
            mean, slope = self.transition(beliefs[-1].mean, past[k : k + self.memory])
            ahead.append(self.carried(beliefs[-1], mean, slope))
            beliefs.append(self.correct(ahead[-1], measured)[0])
            slopes.append(slope)
        x = [beliefs[-1].mean]
        for belief, after, slope in zip(beliefs[-2::-1], ahead[::-1], slopes[::-1], strict=True):
            back = torch.linalg.solve_ex(after.covariance, slope @ belief.covariance)[0].mT
            x.append(belief.mean + back @ (x[-1] - after.mean))
        return torch.stack(x[::-1])[:, : self.n_x]

    @torch.no_grad()
    def lean(self, model: System, logs: Sequence[tuple[Tensor, Tensor]]) -> None:
        """Rely on a rough model until `learn` is called, as far as its innovations allow.

        Args:
            model: The model.
            logs: Measurements `(T + 1, n_x)` and the commands in between, `(T, n_u)`, of some episodes.
        """
        self.first, self.q = model, self._candidates()
        likelihoods = torch.stack([self.follow(y, u)[2].sum(-1) for y, u in logs]).sum(0)
        self.q = self.q[int(likelihoods.argmax())].clone()

    @property
    def sparse_model(self) -> SindyModel:
        """Its model, for files that hold sparse ones alone.

        Raises:
            ValueError: It is of another kind.
        """
        if not isinstance(self.model, SindyModel):
            raise ValueError(f"no file holds an observer on a {type(self.model).__name__}; fit a SindyModel")
        return self.model

    @torch.no_grad()
    def learn(self, y: Tensor, u: Tensor) -> Tensor:
        """Rely on the model from now on, as far as its innovations on a log allow.

        The process noise is the one at which they are most likely: the same for all states, or none to speak of for
        those whose rate is a state, which no push moves at once. `nis` then tells whether they are as large as the
        filter expects.

        Args:
            y: Measurements, `(T + 1, n_x)`.
            u: Commands in between, `(T, n_u)`.

        Returns:
            The estimates on the log, `(T + 1, n_x)`.

        Raises:
            FindingError: Numbers of the model grow beyond what can be solved.
        """
        self.nis = math.nan
        self.q = self._candidates()
        if self.pushed and not self.sensors.rate_indices(self.model.signature):
            # A push on a state that is no rate has as its range what usually moves that [its unit per second]: a rate's
            # range in a second is right for machines, not for what takes minutes, as a tank does.
            means = self.follow(y, u)[0]
            moves = self.model(means[len(means) // 2, :-1, : self.n_x], u.double())[:, self.pushed]
            usual = moves.where(moves.isfinite(), 0.0).square().mean(0).sqrt()
            self.scale[self.n_x :] = torch.where(usual > 0, usual, self.scale[: self.n_x][self.pushed])
            self.q = self._candidates()
        try:
            means, nis, likelihoods = self.follow(y, u)
        except Diverged as error:
            raise FindingError("observer.lost", states=self.model.signature.state_names, seconds=self.dt) from error
        chosen = int(likelihoods.sum(-1).argmax())
        self.q, self.nis = self.q[chosen].clone(), nis[chosen].nanmean().nan_to_num(nan=0.0).item()
        return means[chosen, :, : self.n_x]

    def state_dict(self) -> dict[str, Any]:
        """Return what was learnt, the model apart."""
        return {"process_noise": self.q.tolist(), "nis": self.nis, "push_ranges": self.scale[self.n_x :].tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned.

        Raises:
            ValueError: It is not of such an observer.
        """

        def _positive(values: list[float], count: int, what: str, whose: str) -> Tensor:
            found = torch.tensor(values, dtype=torch.float64)
            if found.shape != (count,) or not bool((found > 0).all() and found.isfinite().all()):
                raise ValueError(f"an observer has a {what} > 0 for each of {count} {whose}, got {values}")
            return found

        self.q = _positive(state["process_noise"], len(self.scale), "process noise", "states")
        self.nis = None if state["nis"] is None else float(state["nis"])
        if "push_ranges" in state:
            self.scale[self.n_x :] = _positive(state["push_ranges"], len(self.pushed), "range", "pushes")

    def _candidates(self) -> Tensor:
        """Return the process noises to choose from, `(rows, n)`."""
        q = CANDIDATES.unsqueeze(-1).repeat(1, len(self.scale))
        if followed := list(self.sensors.rate_indices(self.model.signature)):
            # States whose rate is a state follow it, the others stray, where all that a model misses is a push.
            pushed = torch.logspace(-3, 0, 13, dtype=torch.float64).unsqueeze(-1).repeat(1, q.shape[-1])
            pushed[:, followed] = FOLLOWING
            q = torch.cat([q, pushed])
        # A push drifts by so much of its range in the time in which its state may cross its own.
        seconds = self.scale[: self.n_x][self.pushed] / self.scale[self.n_x :]
        q[:, self.n_x :] = DRIFTING / seconds.sqrt()
        return q

    def late(self) -> tuple[int, float]:
        """Return the model's input delay, in whole control periods and the rest [s].

        Raises:
            ValueError: It is longer than an observer remembers.
        """
        delay = float(getattr(self.system, "delay", 0.0))
        whole, rest = split_delay(delay, self.dt)
        if whole > LONGEST:
            raise ValueError(f"the model's delay is {delay} s, the observer allows {LONGEST * self.dt:g} s; shorten it")
        return whole, rest

    def passages(self) -> tuple[list[tuple[int, float, int]], ...]:
        """Return which commands act, 1 the newest, how long [s] and in how many steps.

        The first list is of the control period whose measurement has just arrived, the second of the time from there
        until the next command arrives at the plant.
        """
        whole, part = self.late()
        first = self.sensors.delay + whole + 1
        until = (first + 1, part), (first, self.dt - part)
        after = (first, part), *((age, self.dt) for age in range(first - 1, 0, -1))

        def stepped(age: int, seconds: float) -> tuple[int, float, int]:
            substeps = max(1, round(self.substeps * seconds / self.dt))
            return age, seconds, steps_of(self.system.step, seconds, substeps).number

        return tuple([stepped(*each) for each in some if each[1]] for some in (until, after))

    def _period(self, x: Tensor, inputs: Tensor) -> Tensor:
        """Move states `(*batch, n, n_x)` on by the control period whose measurement has just arrived."""
        for age, seconds, steps in self.passages()[0]:
            x = self._flow(x, inputs[..., -age, :].unsqueeze(-2), seconds, steps)
        return x

    def _flow(self, x: Tensor, u: Tensor, seconds: float, steps: int) -> Tensor:
        u = u.double().expand(*x.shape[:-1], u.shape[-1])
        believed: System = self.system
        if self.pushed:  # the pushes behind the states
            if self._augmentation is None or self._augmentation.system is not believed:
                self._augmentation = _Augmented(believed, self.pushed if self.learnt else (), len(self.pushed))
            believed = self._augmentation
        return integrate(believed, x, u, seconds, steps, self.stops)[0][..., -1, :]

    def _padded(self, y: Tensor) -> Tensor:
        """Return measurements with a NaN for each push, and for each state that has no sensor, whatever was given."""
        padded = torch.nn.functional.pad(y, (0, len(self.pushed)), value=torch.nan)
        return padded.masked_fill(self.variance.isinf() | padded.isinf(), torch.nan)


class _Augmented(Altered):
    """A system with `count` constants behind its states, each of which adds to the rate of a `pushed` one, if any."""

    def __init__(self, system: System, pushed: Sequence[int], count: int) -> None:
        super().__init__(system)
        self.pushed, self.count = list(pushed), count

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        n_x = self.signature.n_x
        rates = list(self.system(x[..., :n_x], u).unbind(-1))
        for k, state in enumerate(self.pushed):
            rates[state] = rates[state] + x[..., n_x + k]
        return torch.stack([*rates, *[torch.zeros_like(rates[0])] * self.count], -1)

    def compiled(self, x: Tensor, u: Tensor) -> Machine | None:
        own = self.system.compiled(x[..., : self.signature.n_x], u)
        if own is None:
            return None
        if own not in self._machines:
            self._machines = {own: Machine(own.program.with_constants(self.pushed, self.count), own.dtype)}
        return self._machines[own]


class _Kinematic(System):
    """A system whose states move at the rates that are states, or stay: a line through the latest, which forgets."""

    machine_code = True

    def __init__(self, signature: Signature, rates: Mapping[int, int]) -> None:
        super().__init__(signature)
        self.rates = dict(rates)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        columns = x.unbind(-1)
        still = torch.zeros_like(columns[0])
        return torch.stack([columns[self.rates[i]] if i in self.rates else still for i in range(len(columns))], -1)
