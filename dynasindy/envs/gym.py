"""The control environment as a plain Gymnasium environment, and a Gymnasium environment as the plant.

`import dynasindy` registers `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` with `gymnasium.make`. Where an
environment is the plant its own simulator moves, and the task is ours: its observation is the state, under names that
the user gives, its action is the input, scaled to [-1, 1], and what it pays goes under `own_reward`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Unbounded

from dynasindy.envs import RandomStep, Task, Tracking, TrackingReward
from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.drawing import Frame, draw
from dynasindy.envs.task import TrackingMachine
from dynasindy.systems import Pendulum, Signature, System, Tras, Trms33, Xi
from dynasindy.systems.base import WHOLE
from dynasindy.systems.steps import steps_of
from dynasindy.text import duration_unit

PLANTS: dict[str, Callable[[], System]] = {"tras": Tras, "xi": Xi, "trms33": Trms33}
Array = NDArray[np.float32]
Step = Callable[[Array], tuple[Array, float, dict[str, Any]]]
"""From an action to observation, reward and info."""


class _GymControl(gymnasium.Env[Array, Array]):
    """A `ControlEnv` with one row behind Gymnasium's interface, truncated, never terminated; actions are clipped."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, env: ControlEnv, render_mode: str | None = None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode '{render_mode}' is unknown; use None or 'rgb_array'")
        assert isinstance(env.task, Tracking) and not env.batch_size
        self.env, self._task = env, env.task
        self.render_mode = render_mode
        n_o, n_u = env.task.n_o, env.system.signature.n_u
        # No state has an end of its own; a space without ends, which Gymnasium warns of, would say no more.
        most = np.finfo(np.float32).max
        self.observation_space = spaces.Box(-most, most, (n_o,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n_u,), np.float32)
        self._steps: int | None = None
        self._compiled: Step | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode with a fresh reference; the same seed begins the same sequence of episodes."""
        super().reset(seed=seed)
        # EnvBase.set_seed would also seed torch's global generator, which is not ours to touch.
        self.env.rng.manual_seed(int(self.np_random.integers(2**31)))
        self._now, self._steps = self.env.reset(), 0
        self._compiled = _compiled_step(self.env, self._now)
        return self._observed(self._now)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        if self._steps is None:
            raise RuntimeError("step was called before reset; call reset first")
        u = np.minimum(np.maximum(np.asarray(action, dtype=np.float32), -1.0), 1.0)
        if u.shape != self.action_space.shape:
            raise ValueError(f"an action has shape {self.action_space.shape}, given {u.shape}")
        self._steps += 1
        over = self._steps >= self._task.max_steps
        if self._compiled is not None:
            observation, reward, self._info = self._compiled(u)
            return observation, reward, False, over, self._info
        with torch.no_grad():
            stepped = self.env.step(self._now.set("action", torch.from_numpy(u)))
        self._now, after = self.env.step_mdp(stepped), stepped["next"]
        observation, info = self._observed(after)
        return observation, float(after["reward"]), False, over or bool(after["truncated"]), info

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy goes on from; until its next episode without the compiled step, which reads from here."""
        return {**vars(self), "_compiled": None}

    def render(self) -> Frame | None:
        """Return a picture of the state, uint8 `(height, width, 3)`, or None without a render mode."""
        if self.render_mode is None or self._steps is None:
            return None
        unit = duration_unit(self._task.max_steps * self.env.dt)
        words = f"t = {self._steps * self.env.dt / unit.seconds:.2f} {unit.name}"
        state, reference = (self._info[key].tolist() for key in ("state", "reference"))
        return draw(self.env.system.signature, state, reference, self._task.outputs, words)

    def _observed(self, shown: TensorDictBase) -> tuple[Array, dict[str, Any]]:
        self._info = {key: shown[key].numpy().copy() for key in ("state", "reference")}
        return shown["observation"].numpy(), self._info


def _compiled_step(env: ControlEnv, begun: TensorDictBase) -> Step | None:
    """Return what advances one row, its state and count in `begun`, by two calls of machine code, if there is any."""
    x, params, steps = begun["state"], begun["task_params"].contiguous(), begun["step_count"]
    u = x.new_zeros(1, env.system.signature.n_u)
    judge, code = TrackingMachine.of(env.task, env.dt, x.dtype), env.system.compiled(x, u[0])
    beaten = env.delay or math.isfinite(env.left_beyond)
    if type(env) is not ControlEnv or beaten or judge is None or code is None:
        return None
    count = steps_of(code.step, env.dt, env.substeps).number
    samples, touched = x.new_empty(1, count, len(x)), torch.zeros(1, dtype=torch.bool)
    results = torch.empty(judge.n_o, dtype=torch.float32), x.new_empty(judge.n_r), torch.empty(1, dtype=torch.float32)
    advance = code.bind(x, u, samples, touched, env.dt, env.substeps, env.stops)
    judged = judge.bind(x, samples[0, -1], params, steps, touched, results)
    before, after, acting, clock = x.numpy(), samples[0, -1].numpy(), u[0].numpy(), steps.numpy()
    observation, reference, reward = (result.numpy() for result in results)

    def _step(action: Array) -> tuple[Array, float, dict[str, Any]]:
        acting[:] = action
        clock[0] += 1
        advance()
        judged()
        before[:] = after
        return observation.copy(), float(reward[0]), {"state": after.copy(), "reference": reference.copy()}

    return _step


def twin_rotor(
    plant: str = "tras",
    low: tuple[float, float] = (-0.4, -0.25),
    high: tuple[float, float] = (0.4, 0.25),
    render_mode: str | None = None,
) -> _GymControl:
    """Return the twin rotor under random step references, the paper's training task.

    Args:
        plant: "tras", "xi" or "trms33".
        low: Lower ends of the azimuth and pitch references [rad].
        high: Upper ends [rad].
        render_mode: None or "rgb_array".

    Raises:
        ValueError: The plant is unknown.
    """
    if plant not in PLANTS:
        raise ValueError(f"plant '{plant}' is unknown; use one of {', '.join(PLANTS)}")
    system = PLANTS[plant]()
    return _GymControl(ControlEnv(system, Tracking(system.signature, RandomStep(low, high))), render_mode)


def pendulum(low: float = -1.0, high: float = 1.0, render_mode: str | None = None) -> _GymControl:
    """Return the pendulum under random step references between `low` and `high` [rad]."""
    system = Pendulum()
    task = Tracking(system.signature, RandomStep([low], [high]), ["theta"], ["Omega"], TrackingReward((4.0,)))
    return _GymControl(ControlEnv(system, task), render_mode)


STARTS = 256
"""Resets that show where episodes begin; no step is taken."""


class Foreign(System):
    """What is known of a Gymnasium environment before it moves: names and ranges, no equations.

    Args:
        id: Name under which Gymnasium has the environment.
        states: Names of the states, or name to range; names alone take their ranges from the observation space, or 1
            where that has no ends. They are the observation's entries, in their order, unless `observed` says
            otherwise. None names them x1, x2, ...
        inputs: Names of the action's entries; None names them u1, u2, ...
        units: Units of the states; None for rad of `angles`, rad/s of their `rates`, "-" of any other.
        options: Arguments of `gymnasium.make`.
        stops: Names of the states that the environment clips at the ends of its observation space; None for all. A
            cosine, whose ends are reached in free motion, is none.
        observed: Names of the observation's entries, where the state is not all of them in their order.
        angles: States that are the angle of two entries: name to those of its sine and its cosine.
        rates: Which state is the rate of which, as `{"theta": "omega"}`.
        repeat: Steps of the environment in a control period, in which the action is held.

    Raises:
        ValueError: Gymnasium has no such environment, a space is no box of one dimension, an action has no ends, the
            numbers of names differ from the spaces, a stop is no state, or a state is neither observed nor an angle.
    """

    known = False

    def __init__(
        self,
        id: str,  # noqa: A002 (Gymnasium's name)
        states: Sequence[str] | Mapping[str, float] | None = None,
        inputs: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        options: Mapping[str, Any] | None = None,
        stops: Sequence[str] | None = None,
        observed: Sequence[str] | None = None,
        angles: Mapping[str, Sequence[str]] | None = None,
        rates: Mapping[str, str] | None = None,
        repeat: int = 1,
    ) -> None:
        if not 1 <= repeat <= 1000:  # the limit is arbitrary, but more would hardly end
            raise ValueError(f"system.repeat is {repeat}; give the steps of a control period, 1 to 1000")
        self.id, self.options, self.repeat = id, dict(options or {}), repeat
        copy = self.make(1)
        seen, acted = copy.observation_space, copy.action_space
        for space, what in ((seen, "observation"), (acted, "action")):
            if not isinstance(space, spaces.Box) or len(space.shape) != 1:
                raise ValueError(f"{id} has the {what} space {space}; a plant needs a Box of one dimension")
        assert isinstance(seen, spaces.Box) and isinstance(acted, spaces.Box)
        if not (np.isfinite(acted.low).all() and np.isfinite(acted.high).all() and (acted.low < acted.high).all()):
            raise ValueError(
                f"env.id={id} has actions from {acted.low.tolist()} to {acted.high.tolist()}; give your environment's "
                "action_space finite ends, low below high"
            )
        n_seen, n_u = seen.shape[0], acted.shape[0]
        states = [f"x{i + 1}" for i in range(n_seen)] if states is None else states
        ranges = dict(states) if isinstance(states, Mapping) else dict.fromkeys(states)
        entries, named = (list(ranges), "states") if observed is None else (list(observed), "observed")
        names = [f"u{i + 1}" for i in range(n_u)] if inputs is None else list(inputs)
        if len(entries) != n_seen or len(names) != n_u:
            raise ValueError(
                f"{id} has {n_seen} states and {n_u} inputs, plant.{named} names {len(entries)} ({', '.join(entries)}) "
                f"and plant.inputs {len(names)} ({', '.join(names)}); name each of them"
            )
        self.observed = _Observed(entries, list(ranges), angles)
        both = self.observed.ends(torch.as_tensor(np.stack([seen.low, seen.high])).double())
        ends = both.abs().amax(0).tolist()
        scale = [r or (end if end < 1e6 else 1.0) for r, end in zip(ranges.values(), ends, strict=True)]
        said = dict.fromkeys(angles or (), "rad")
        said |= {rate: "rad/s" for angle, rate in (rates or {}).items() if angle in said}
        units = [said.get(name, "-") for name in ranges] if units is None else units
        reach = tuple(zip(acted.low.tolist(), acted.high.tolist(), strict=True))
        reach = reach if {*reach} != {WHOLE} else ()
        super().__init__(Signature(tuple(ranges), tuple(units), tuple(names), tuple(scale), reach))
        self.low, self.high = acted.low, acted.high
        if strange := [name for name in stops or () if name not in ranges]:
            raise ValueError(
                f"plant.stops names {strange[0]}, {id} has the states {', '.join(ranges)}; name some of these"
            )
        clips = torch.tensor([stops is None or name in stops for name in ranges])
        self.ends = torch.where(clips, both, both.new_tensor([[-math.inf], [math.inf]]))
        # How long a step is [s]: `dt`, as MuJoCo's and the pendulum have it, or `tau`, as the cart-pole.
        steps = (getattr(copy.unwrapped, name, None) for name in ("dt", "tau"))
        self.period = next((repeat * float(s) for s in steps if isinstance(s, int | float) and 0 < s < math.inf), None)
        assert copy.spec is not None
        # What it was made with says how long episodes are here, not as which they are registered.
        registered = gymnasium.registry[copy.spec.id].max_episode_steps
        self.registered_steps = None if registered is None else registered // repeat

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Refuse: the equations of a Gymnasium environment are not known.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"the equations of {self.id} are not known; give what needs them a model of it")

    def make(self, max_steps: int) -> gymnasium.Env[Any, Any]:
        """Return a copy of the environment whose episodes end after `max_steps` control periods.

        Raises:
            ValueError: Gymnasium has no such environment, or lacks a package for it.
        """
        try:
            copy = gymnasium.make(self.id, max_episode_steps=max_steps * self.repeat, **self.options)
        except (gymnasium.error.Error, ModuleNotFoundError, TypeError) as error:
            reason = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
            # Gymnasium's own words install a MuJoCo that TorchRL cannot be imported with.
            reason = reason.replace('"gymnasium[mujoco]"', "'dynasindy[mujoco]'")
            raise ValueError(
                f"env.id={self.id}: {reason}; give an environment that gymnasium.make can build"
            ) from error
        grouped = isinstance(copy.observation_space, spaces.Dict | spaces.Tuple)
        copy = gymnasium.wrappers.FlattenObservation(copy) if grouped else copy
        return copy if self.repeat == 1 else _Repeated(copy, self.repeat)


class _Repeated(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment that makes several steps with an action, and pays what they earn together.

    Attributes:
        steps: How many were made with the last action; fewer than wanted where the episode ended.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], repeat: int) -> None:
        super().__init__(env)
        self.repeat, self.steps = repeat, repeat

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return the observation after the steps, or after the one that ends the episode."""
        paid = 0.0
        for step in range(self.repeat):
            seen, reward, terminated, truncated, info = self.env.step(action)
            paid, self.steps = paid + float(reward), step + 1
            if terminated or truncated:
                break
        return seen, paid, terminated, truncated, info


class GymnasiumEnv(ControlEnv):
    """A Gymnasium environment under a task of ours, batched: one copy of it per row.

    A copy can be begun anew and stepped, and cannot be put into a state. So `start_from` begins where the environment
    itself begins, and a step must go on from the step before. An environment made by `with_task`, in which policies are
    evaluated, shares the copies, so that an episode of either ends where the other begins one. It holds a terminated
    row where it ended instead of ending the episode: the environment itself pays nothing from there on.

    Keys beside those of `ControlEnv`: `own_reward`, what the environment itself pays, and `moved`, whether the row made
    a step of it. `at_stop` tells that a state lies at one of its ends.

    Args:
        system: The environment's names and ranges.
        task: What is wanted; it is told where the copies begin episodes, for imagined ones to begin there.
        id: Name of the environment, which `system` has too.
        dt: Control period [s]; None for that of the environment.
        substeps: 1, as a copy shows its state once per period.
        dtype: Floating type of states.
        seed: Seed of the resets.

    Raises:
        TypeError: The system is no Gymnasium environment.
        ValueError: The period is not known and not given, or `substeps` is not 1.
    """

    def __init__(
        self,
        system: System,
        task: Task,
        id: str = "",  # noqa: A002 (Gymnasium's name)
        dt: float | None = None,
        substeps: int = 1,
        *,
        dtype: torch.dtype | Literal["float32", "float64"] = torch.float64,
        seed: int = 0,
    ) -> None:
        if not isinstance(system, Foreign):
            raise TypeError(f"{type(system).__name__} is no Gymnasium environment; use dynasindy.envs.ControlEnv")
        if substeps != 1:
            raise ValueError(f"env.substeps={substeps}: a Gymnasium environment shows its state once a period; give 1")
        period = system.period if dt is None else dt
        if period is None:
            raise ValueError(f"{system.id} does not say how long a step is; give env.dt in seconds")
        self.ends, self.copies = True, SimpleNamespace(pool=[], user=None)  # of the environment, and who moves them
        super().__init__(system, task, period, 1, dtype=dtype, seed=seed)
        self.foreign = system
        if task.starts is None:
            copy, rng = system.make(1), np.random.default_rng(seed)
            begun = np.stack([copy.reset(seed=int(rng.integers(2**31)))[0] for _ in range(STARTS)])
            self.task = task.with_starts(system.observed.state(torch.as_tensor(begun, dtype=torch.float64)))

    def with_task(self, task: Task, seed: int = 0) -> ControlEnv:
        """Return this environment with another task, for evaluation: rows that end stay where they ended."""
        other = GymnasiumEnv(self.foreign, task, dt=self.dt, dtype=self.float_type, seed=seed)
        other.ends, other.copies = False, self.copies
        return other

    def start_from(self, states: Tensor) -> TensorDict:
        """Begin episodes where the environment begins them, one for each of the states, which are not used."""
        rows = states.shape[:-1].numel()
        while len(self.copies.pool) < rows:
            self.copies.pool.append(self.foreign.make(10**9))
        self.copies.user = self
        seeds = torch.randint(2**31, (rows,), generator=self.rng).tolist()
        begun = [copy.reset(seed=seed)[0] for copy, seed in zip(self.copies.pool, seeds)]
        seen = torch.as_tensor(np.stack(begun), dtype=self.float_type)
        self.now = self.foreign.observed.state(seen).reshape(states.shape)
        self.over = torch.zeros(states.shape[:-1], dtype=torch.bool)
        out = super().start_from(self.now)
        out.set("moved", torch.zeros(*states.shape[:-1], 1, dtype=torch.bool))
        return out.set("own_reward", torch.zeros(*states.shape[:-1], 1))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        x, u = tensordict["state"], tensordict["action"]
        if self.copies.user is not self or not torch.equal(x, self.now):
            raise RuntimeError("a Gymnasium environment goes on from its last state only; reset it first")
        held, rows, n = self.over, x.shape[:-1], x.shape[:-1].numel()
        paid, over = torch.zeros(n), held.reshape(-1).clone()
        lost, broken = torch.zeros(2, n, dtype=torch.bool)
        after, steps = self.now.reshape(n, -1).clone(), tensordict["step_count"].reshape(-1).tolist()
        low, high = self.foreign.low, self.foreign.high
        actions = u.detach().reshape(n, -1).double().numpy().clip(-1.0, 1.0)
        scaled = (low + (high - low) * 0.5 * (actions + 1.0)).astype(np.float32)
        for i in (~over).nonzero().flatten().tolist():
            seen, paid[i], lost[i], truncated, broken[i] = self._next(i, scaled[i], steps[i] + 1)
            after[i] = self.foreign.observed.state(torch.as_tensor(seen, dtype=self.float_type), after[i])
            over[i] = lost[i] | truncated
        self.now, self.over = after.reshape(x.shape), over.reshape(rows)
        clipped = ((self.now <= self.foreign.ends[0]) | (self.now >= self.foreign.ends[1])).any(-1)
        clipped = clipped | broken.reshape(rows)  # no equation holds in a period that ends early, either
        out = self._moved(tensordict, self.now.unsqueeze(-2), clipped)
        out["own_reward"], out["moved"] = paid.reshape(*rows, 1), ~held.unsqueeze(-1)
        cut = self.over.unsqueeze(-1) & self.ends
        if self.task.own:
            out["reward"], out["terminated"] = out["own_reward"].clone(), cut & lost.reshape(*rows, 1)
        # Any other reward is a cost: an end that were worth nothing would be the best that an agent could reach, so an
        # episode that the environment ends is cut short, not terminated.
        out["truncated"] = out["truncated"] | cut
        out["done"] = out["truncated"].clone()
        return out

    def _next(self, copy: int, action: Any, step: int) -> tuple[Any, float, bool, bool, bool]:
        """Return observation and reward of a step of one copy, whether it ends or is cut short there, and within it."""
        env = self.copies.pool[copy]
        try:
            seen, reward, terminated, truncated, _ = env.step(action)
        except ValueError as error:
            if "values to unpack" not in str(error):
                raise
            raise ValueError(
                f"env.id={self.foreign.id}: its step does not give five values; mend your environment, so that it "
                "gives observation, reward, terminated, truncated and info"
            ) from error
        seen = np.asarray(seen)
        if not np.isfinite(seen).all():
            place = int(np.flatnonzero(~np.isfinite(seen))[0])
            raise ValueError(
                f"env.id={self.foreign.id}: in step {step} of an episode component {place} of the observation, "
                f"'{self.foreign.observed.names[place]}', is {seen.reshape(-1)[place]}; mend your environment"
            )
        broken = isinstance(env, _Repeated) and env.steps < env.repeat
        return seen, float(reward), bool(terminated), bool(truncated), broken

    def _require_rates(self) -> None:
        """Ask for none, as the equations are not known."""

    def check_plant(self) -> None:
        """Refuse bounds that exclude where episodes begin; the equations are not known."""
        self._require_start_within()

    def _make_specs(self) -> None:
        super()._make_specs()
        shape = (*self.batch_size, 1)
        self.observation_spec["own_reward"] = Unbounded(shape=shape, dtype=torch.float32)
        self.observation_spec["moved"] = Binary(n=1, shape=shape, dtype=torch.bool)


class _Observed:
    """The states in a Gymnasium environment's observation: some of its entries, and angles by sine and cosine.

    An angle begins in (-pi, pi]; from then on it is the one nearest to that of the period before.
    """

    def __init__(
        self, names: Sequence[str], states: Sequence[str], angles: Mapping[str, Sequence[str]] | None = None
    ) -> None:
        angles, told = angles or {}, f"the observation's entries are {', '.join(names)}"
        if double := [name for k, name in enumerate(names) if name in names[:k]]:
            raise ValueError(f"plant.observed has {double[0]} twice; give each entry of the observation its own name")
        for angle, parts in angles.items():
            if angle in names or angle not in states or len(parts) != 2 or not {*parts} <= {*names}:
                raise ValueError(
                    f"plant.angles has {angle}: [{', '.join(parts)}]; name a state that is no entry itself, with its "
                    f"sine and its cosine: {told}"
                )
        if absent := [name for name in states if name not in names and name not in angles]:
            raise ValueError(
                f"plant.states has {absent[0]}, which is neither observed nor an angle; {told}: name it in "
                "plant.angles, with its sine and its cosine, or mend plant.observed"
            )
        self.names, self.is_angle = list(names), torch.tensor([name in angles for name in states])
        pairs = [angles.get(name, (name, name)) for name in states]
        self.sine, self.cosine = ([names.index(pair[k]) for pair in pairs] for k in (0, 1))

    def state(self, observation: Tensor, before: Tensor | None = None) -> Tensor:
        """Return the state, `(*batch, n_x)`, of observations `(*batch, n)`, and that `before`, unless they begin."""
        x = observation[..., self.sine]
        angle = torch.atan2(x, observation[..., self.cosine])
        if before is not None:
            angle = before + torch.remainder(angle - before + math.pi, 2 * math.pi) - math.pi
        return torch.where(self.is_angle, angle, x)

    def ends(self, ends: Tensor) -> Tensor:
        """Return the ends of the states, `(2, n_x)`, of those of the entries, `(2, n)`; an angle has none."""
        return torch.where(self.is_angle, ends.new_tensor([[-math.inf], [math.inf]]), ends[:, self.sine])
