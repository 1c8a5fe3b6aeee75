"""The environment, against loops in plain numbers, independent integrations and TorchRL's own rollout."""

import math

import numpy as np
import pytest
import torch
from alternating import Mapped
from controllers import angle_task
from plants import Linear, Plant, held_motion, pendulum_rates, scipy_motion
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from dynasindy.control.sensing import Sensing
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import ControlEnv, RandomStep, Step, Tracking, TrackingReward, Wave
from dynasindy.systems import Pendulum, Stops, Tras, Xi
from dynasindy.systems.transitions import Transitions


def make(system=None, **settings):
    system = system or Tras()
    task = Tracking(system.signature, RandomStep([-0.5, -0.5], [0.5, 0.4]), max_steps=settings.pop("max_steps", 400))
    return ControlEnv(system, task, **settings)


class Constant:
    def __init__(self, *u):
        self.u = torch.tensor(u)

    def __call__(self, tensordict):
        return tensordict.set("action", self.u.expand(*tensordict.batch_size, len(self.u)))


def test_partial_reset_leaves_the_other_rows():
    env = make()
    after = env.rollout(3, Constant(0.3, 0.3), auto_reset=False, tensordict=env.reset(TensorDict(batch_size=[3])))
    ongoing = env.step_mdp(after[:, -1])
    mask = torch.tensor([[False], [True], [False]])
    reset = env.reset(ongoing.clone().set("_reset", mask), select_reset_only=True, set_state=False)
    assert reset["step_count"].flatten().tolist() == [3, 0, 3]
    assert torch.equal(reset["state"][[0, 2]], ongoing["state"][[0, 2]])
    assert (reset["state"][1] == 0).all()
    assert not torch.equal(reset["task_params"][1], ongoing["task_params"][1])


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_a_state_that_leaves_its_range_stays_at_the_end_and_the_others_where_that_period_began(batch):
    """da/dt = u, db/dt = 1: states are straight lines."""
    plant = Plant("a b", lambda a, b, u: [u, torch.ones_like(u)], (1.0, 100.0))
    task = Tracking(plant.signature, RandomStep([-0.5], [0.5]), ("a",), (), TrackingReward((1.0,)), max_steps=8)
    env = ControlEnv(plant, task, dt=0.5, substeps=5, dtype=torch.float64)
    env.left_beyond = 2.0
    firsts = [0.8 - 0.35 * k for k in range(math.prod(batch))]
    begun = torch.tensor([[a, 5.0] for a in firsts], dtype=torch.float64).reshape(*batch, 2)
    made = env.rollout(8, Constant(1.0), auto_reset=False, tensordict=env.start_from(begun))
    for a, states in zip(firsts, made["next", "state"].reshape(-1, 8, 2).tolist(), strict=True):
        whole = math.floor((2 - a) / 0.5)  # periods that end within the range
        for k, state in enumerate(states, 1):
            assert state == pytest.approx([a + 0.5 * k if k <= whole else 2.0, 5 + 0.5 * min(k, whole)])


def test_a_rollout_is_what_a_loop_in_plain_numbers_makes():
    """A pendulum under a moving reference: Runge-Kutta, observation and reward without a tensor."""
    plant = Pendulum(mass=2.0, length=0.8, damping=0.3, max_torque=9.0)
    wave = Wave([0.4], [0.8], offset=[0.1])
    reward = TrackingReward((2.0,), 0.3, 0.5, tolerance=0.2)
    task = Tracking(plant.signature, wave, ("theta",), ("Omega",), reward, max_steps=6, observe_rate=True)
    env = ControlEnv(plant, task, dt=0.1, substeps=3, dtype=torch.float64)
    inputs = [0.5, -1.0, 0.25, 1.0, -0.5, 0.75]
    start = env.start_from(torch.tensor([0.3, -0.7], dtype=torch.float64))
    actions = iter(torch.tensor(inputs).unsqueeze(-1))
    made = env.rollout(99, lambda td: td.set("action", next(actions)), auto_reset=False, tensordict=start)
    assert made.shape == (6,)

    def field(angle, speed, u):
        return speed, 9.0 * u / 1.28 - 9.81 / 0.8 * math.sin(angle) - 0.3 * speed / 1.28

    def advanced(state, u, h):
        slopes = [field(*state, u)]
        for share in (h / 2, h / 2, h):
            slopes.append(field(state[0] + share * slopes[-1][0], state[1] + share * slopes[-1][1], u))
        return [s + h / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, *map(list, slopes), strict=True)]

    state = [0.3, -0.7]
    for k, u in enumerate(inputs):
        before, row, then = state, made[k], made[k]["next"]
        reference = 0.1 + 0.4 * math.sin(1.6 * math.pi * 0.1 * (k + 1))
        slope = 0.4 * 1.6 * math.pi * math.cos(1.6 * math.pi * 0.1 * (k + 1))
        for sample in then["samples"]:
            state = advanced(state, u, 0.1 / 3)
            assert sample.tolist() == pytest.approx(state, rel=1e-12)
        error = reference - state[0]
        pay = -2 * error**2 - 0.3 * (state[1] - before[1]) ** 2 + 0.5 * (abs(error) < 0.2)
        assert row["state"].tolist() == pytest.approx(before) and then["state"].tolist() == pytest.approx(state)
        assert then["reference"].item() == pytest.approx(reference) and then["step_count"].item() == k + 1
        assert then["observation"].tolist() == pytest.approx([state[0], state[1] / 3, error / 0.5, slope], rel=1e-5)
        assert then["reward"].item() == pytest.approx(pay, rel=1e-5)
        flags = [then[key].item() for key in ("truncated", "done", "terminated", "at_stop")]
        assert flags == [k == 5, k == 5, False, False]


def test_episodes_start_at_the_states_given_at_time_zero():
    env = make(dtype=torch.float64, substeps=3)
    states = torch.rand(2, 4, 6)
    start = env.start_from(states)
    assert start.batch_size == (2, 4) and start["state"].dtype == start["task_params"].dtype == torch.float64
    torch.testing.assert_close(start["state"], states.double())
    torch.testing.assert_close(start["samples"], states.double().unsqueeze(-2).expand(2, 4, 3, 6))
    torch.testing.assert_close(start["reference"], start["task_params"][..., 0])
    assert not start["step_count"].any() and start["step_count"].dtype == torch.int64
    for key in ("at_stop", "done", "terminated", "truncated"):
        assert start[key].shape == (2, 4, 1) and not start[key].any(), key


def test_another_system_keeps_stops_task_and_settings():
    env = make(Tras(azimuth_stop=1.5, pitch_stop=0.3), dt=0.1, substeps=4, dtype=torch.float64, batch_size=(3,))
    other = env.with_system(Xi())
    assert isinstance(other.system, Xi) and other.task is env.task
    assert (other.stops.low, other.stops.high) == ((-1.5, -0.3), (1.5, 0.3))
    assert (other.dt, other.substeps, other.float_type, tuple(other.batch_size)) == (0.1, 4, torch.float64, (3,))
    # The beam is driven up: a model that knows no stop is held by the plant's.
    seen = other.rollout(30, lambda td: td.set("action", torch.ones(3, 2)))["next"]
    assert seen["state"][..., 1].max().item() == 0.3 and seen["at_stop"].any()
    assert env.with_system(Xi(), torch.float32).float_type == torch.float32


def test_environments_made_of_another_draw_by_their_own_seed():
    def drawn(env):
        return env.reset()["reference"]

    env = make(seed=5)
    for other in (env.with_system(Xi(), seed=5), env.with_task(env.task, seed=5)):
        assert torch.equal(drawn(other), drawn(make(seed=5)))
    assert torch.equal(drawn(env.with_system(Xi())), drawn(make(seed=0)))
    assert torch.equal(drawn(env.with_task(env.task)), drawn(make()))
    assert not torch.equal(drawn(make(seed=5)), drawn(make()))


def test_types_and_bounds_are_those_that_policies_expect():
    env = make(dtype=torch.float64, batch_size=(2,))
    row = env.rollout(1, Constant(0.1, 0.2))[:, 0]
    for key in ("observation", "action", ("next", "reward"), ("next", "observation")):
        assert row[key].dtype == torch.float32, key
    for key in ("state", "reference", "task_params", ("next", "samples")):
        assert row[key].dtype == torch.float64, key
    assert (env.action_spec.space.low == -1).all() and (env.action_spec.space.high == 1).all()
    assert row["next", "samples"].shape == (2, 5, 6) and row["next", "reward"].shape == (2, 1)


def test_a_plant_that_moves_in_steps_has_periods_of_whole_steps_and_no_samples_within_them():
    plant = Mapped(-0.5, 1.0, 0.1)
    task = Tracking(plant.signature, RandomStep([-0.5], [0.5]), ["x"], [], TrackingReward([1.0]))
    env = ControlEnv(plant, task, 0.1, 1, dtype=torch.float64)
    env.check_plant()
    rollout = env.rollout(2, Constant(0.3), auto_reset=False, tensordict=env.start_from(torch.tensor([0.8])))
    assert rollout["next", "state"].flatten().tolist() == pytest.approx([-0.1, 0.35])  # -0.5 x + u
    with pytest.raises(ValueError, match="substeps=5"):
        ControlEnv(plant, task, 0.1, 5).check_plant()
    with pytest.raises(ValueError, match="Mapped"):
        ControlEnv(plant, task, 0.05, 1).check_plant()


def test_bounds_that_exclude_where_episodes_begin_are_refused_before_anything_moves():
    system = Pendulum()
    settings = {"outputs": ["theta"], "rates": ["Omega"], "bounds": {"theta": [0.5, 2.0]}}
    task = Tracking(system.signature, RandomStep([1.0], [1.5]), **settings, reward=TrackingReward((1.0,)))
    with pytest.raises(ValueError, match="theta") as error:
        ControlEnv(system, task).check_plant()
    assert "\n" not in str(error.value)
    begun = Tracking(
        system.signature, RandomStep([1.0], [1.5]), **settings, reward=TrackingReward((1.0,)), start={"theta": 0.5}
    )
    ControlEnv(system, begun).check_plant()
    with pytest.raises(ValueError, match="theta"):
        ControlEnv(system, begun.with_starts(torch.tensor([[0.6, 0.0], [0.4, 0.0]]))).check_plant()


class Busy:
    """A policy that writes more than its action: what goes on, what follows and what every period has anew."""

    def __call__(self, tensordict):
        h = tensordict.get("h", torch.zeros(*tensordict.batch_size, 1)) + 0.1
        tensordict["h"], tensordict["next", "k"] = h, h**2
        tensordict["odds"] = tensordict["observation"].sum(-1, keepdim=True)
        return tensordict.set("action", torch.cat([torch.sin(h), -h], -1))


@pytest.mark.parametrize("batch", [(), (3,), (2, 2)])
@pytest.mark.parametrize(
    ("periods", "settings"),
    [(4, {}), (30, {}), (30, {"break_when_any_done": False}), (1, {"break_when_any_done": False})],
)
def test_a_rollout_is_the_one_of_torchrl(batch, periods, settings):
    """Also past the end of episodes; with its options, here that of one piece of memory, it is TorchRL that does it."""
    envs = [make(max_steps=12, batch_size=batch, seed=3) for _ in range(2)]
    ours, theirs = (
        env.rollout(periods, Busy(), **settings, **more) for env, more in zip(envs, ({}, {"return_contiguous": True}))
    )
    assert ours.batch_size == theirs.batch_size and ours.names == theirs.names
    assert set(ours.keys(True, True)) == set(theirs.keys(True, True))
    for key in theirs.keys(True, True):
        assert ours[key].dtype == theirs[key].dtype and torch.equal(ours[key], theirs[key]), key
    ours["observation"].fill_(9.0)  # numbers of one period are its own
    assert torch.equal(ours["next", "observation"], theirs["next", "observation"])
    assert theirs["next", "state"].is_contiguous()
    assert ours.reshape(-1).contiguous().batch_size == theirs.reshape(-1).batch_size


def test_a_rollout_tells_of_each_period_but_the_last_and_goes_on_from_another():
    env, heard = make(max_steps=20), []
    first = env.rollout(5, Constant(0.3, 0.3), lambda _, now: heard.append(int(now["step_count"])))
    assert heard == [1, 2, 3, 4]
    whole = env.rollout(8, Constant(0.3, 0.3))
    begun = env.step_mdp(first[-1])
    rest = env.rollout(3, Constant(0.3, 0.3), auto_reset=False, tensordict=begun)
    assert torch.equal(torch.cat([first, rest])["next", "state"], whole["next", "state"])
    assert rest["step_count"].flatten().tolist() == [5, 6, 7]


def test_derivatives_go_through_a_rollout():
    env, push = make(), torch.tensor([0.2, 0.3], requires_grad=True)
    rows = env.rollout(6, lambda td: td.set("action", push.expand(2)))
    slope = torch.autograd.grad(rows["next", "reward"].sum(), push)[0]
    for j in range(2):
        ends = [make(seed=0).rollout(6, Constant(*(push + sign * 1e-2 * torch.eye(2)[j]).tolist())) for sign in (1, -1)]
        rise, fall = (end["next", "reward"].sum().item() for end in ends)
        assert slope[j].item() == pytest.approx((rise - fall) / 2e-2, rel=0.05, abs=1e-4)


DT = 0.05


def late(delay, substeps=5):
    task = angle_task(Step([[0.3]]), max_steps=40)
    return ControlEnv(Pendulum(), task, DT, substeps, delay=delay, dtype=torch.float64)


def test_specs_hold():
    check_env_specs(late(0.12))


@pytest.mark.parametrize("periods", [0.0, 1.0, 2.0, 2.5])
def test_each_sample_is_where_the_late_inputs_have_brought_the_plant(periods):
    """Omega' = 12 u(t - delay) - 9.81 sin(theta) - 0.5 Omega, by SciPy from one change of the input to the next."""
    inputs = np.sin(0.7 * np.arange(20))
    env = late(periods * DT)
    rows = env.rollout(20, lambda td: td.set("action", torch.from_numpy(inputs)[td["step_count"]].float()))
    seen = rows["next", "samples"].reshape(-1, 2).numpy()
    x, truth = np.zeros(2), []
    for k in range(len(seen)):
        for half in (0.0, 0.5):  # an input changes in the middle of a sample at 2.5 periods
            begun = int(np.floor((k + half) / 5 - periods + 1e-9))
            u = inputs[begun] if begun >= 0 else 0.0
            x = scipy_motion(pendulum_rates, x, [u], 0.005)[-1]
        truth.append(x)
    np.testing.assert_allclose(seen, truth, atol=2e-3 if periods == 2.5 else 1e-5)


def test_another_plant_and_another_task_have_the_same_delay():
    env = late(0.1)
    assert env.with_task(env.task).delay == env.with_system(Pendulum()).delay == 0.1
    with pytest.raises(ValueError, match="delay"):
        late(-0.1)


@pytest.mark.parametrize(("delay", "late_steps"), [(0.05, 2), (0.075, 3)])
def test_a_difference_equation_gets_its_inputs_whole_steps_late(delay, late_steps):
    """x[k+1] = -0.5 x[k] + u[k - late], two steps of 0.025 s to a control period."""
    plant = Mapped(-0.5, 1.0, 0.025)
    task = Tracking(plant.signature, Step([[0.3]]), ("x",), (), TrackingReward((4.0,)), max_steps=40)
    env = ControlEnv(plant, task, DT, 2, delay=delay, dtype=torch.float64)
    inputs = torch.sin(torch.arange(20.0))
    rows = env.rollout(20, lambda td: td.set("action", inputs[td["step_count"]]))
    x, seen = 0.0, []
    for k in range(40):
        x = -0.5 * x + (float(inputs[(k - late_steps) // 2]) if k >= late_steps else 0.0)
        seen.append(x)
    np.testing.assert_allclose(rows["next", "state"].flatten(), seen[1::2], rtol=1e-6)
    with pytest.raises(ValueError, match="cannot"):
        ControlEnv(plant, task, DT, 2, delay=0.06, dtype=torch.float64).rollout(3)


OSCILLATOR = [[0.0, 1.0], [-4.0, -0.4]], [[0.0], [3.0]]


def inputs(n: int = 60) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (n, 1)))


def test_a_linear_plant_moves_as_the_matrix_exponential_says():
    u, start = inputs(), np.array([0.3, -0.2])
    data = record_plant(Linear(*OSCILLATOR), u, 0.05, x0=torch.from_numpy(start))
    motion = held_motion(*OSCILLATOR, start, u, 0.05)
    assert np.allclose(data.x, motion[:-1], atol=1e-9) and np.allclose(data.x_next, motion[1:], atol=1e-9)
    assert torch.equal(data.u, u) and data.dt == 0.05 and data.segment.unique().tolist() == [0]


def test_a_recording_starts_at_rest_in_double_precision_without_gradients():
    data = record_plant(Linear(*OSCILLATOR), inputs(3).float().requires_grad_(), 0.05)
    assert data.x[0].tolist() == [0.0, 0.0]
    assert data.x.dtype == data.u.dtype == torch.float64 and not data.x_next.requires_grad


def test_samples_that_touch_a_stop_are_left_out_and_split_the_recording():
    plant = Linear(*OSCILLATOR)
    plant.stops = Stops((0,), (1,), (-0.5,), (0.5,))
    u = torch.cat([torch.full((20, 1), 1.0), torch.zeros(40, 1)]).double()
    data = record_plant(plant, u, 0.05)
    free = held_motion(*OSCILLATOR, [0, 0], u, 0.05)
    before = int(np.argmax(free[1:, 0] >= 0.5))  # transitions that end below the stop
    assert 0 < before < len(data) < 60
    assert bool((data.x_next[:, 0].abs() < 0.5).all())
    assert np.allclose(data.x_next[:before], free[1 : before + 1], atol=1e-9)
    assert data.segment.tolist() == [0] * before + [1] * (len(data) - before)


def test_noise_does_not_leak_over_a_gap():
    clean = record_plant(Linear(*OSCILLATOR), inputs(60), 0.05)
    clean = clean.select(torch.arange(60) != 30)
    noisy = clean.disturbed(0.1, seed=3)
    assert not torch.equal(noisy.x[30] - clean.x[30], noisy.x_next[29] - clean.x_next[29])
    assert clean.disturbed(0.0, seed=3) is clean


def test_noise_is_its_seeds_numbers_times_the_spread_of_each_state():
    clean = record_plant(Linear(*OSCILLATOR), inputs(20), 0.05)
    noisy, rng = clean.disturbed(0.2, seed=7), torch.Generator().manual_seed(7)
    after, first = (torch.randn(20, 2, generator=rng, dtype=torch.float64) for _ in range(2))
    spread = torch.from_numpy(np.std(clean.x_next.numpy(), 0, ddof=1))
    torch.testing.assert_close(noisy.x_next, clean.x_next + 0.2 * spread * after)
    torch.testing.assert_close(noisy.x[0], clean.x[0] + 0.2 * spread * first[0])
    torch.testing.assert_close(noisy.x[1:], clean.x[1:] + 0.2 * spread * after[:-1])
    assert torch.equal(noisy.u, clean.u)


def test_each_period_gives_its_own_rows_inputs_and_flag():
    """Four periods of two samples; the second and the last touched a stop."""
    start = torch.tensor([[0.0], [2.0], [4.0], [6.0]])
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [4.0]], [[5.0], [6.0]], [[7.0], [8.0]]])
    rows = TensorDict(
        {
            "state": start,
            "action": torch.tensor([[0.1, -0.1], [0.2, -0.2], [0.3, -0.3], [0.4, -0.4]]),
            "next": {"samples": samples, "at_stop": torch.tensor([[False], [True], [False], [True]])},
        },
        [4],
    )
    data = Transitions.from_periods(rows, 0.025)
    assert data.x.flatten().tolist() == [0, 1, 4, 5] and data.x_next.flatten().tolist() == [1, 2, 5, 6]
    expected = torch.tensor([[0.1, -0.1], [0.1, -0.1], [0.3, -0.3], [0.3, -0.3]])
    assert torch.equal(data.u.float(), expected) and data.u.dtype == data.x.dtype == data.x_next.dtype == torch.float64
    assert data.segment.tolist() == [0, 0, 1, 1] and data.dt == 0.025


def test_an_observer_reads_the_first_measurement_and_that_at_the_end_of_each_period():
    samples = torch.tensor([[[1.0], [2.0]], [[3.0], [torch.nan]]])
    rows = TensorDict(
        {
            "measurement": torch.tensor([[0.5], [2.0]]),
            "action": torch.tensor([[0.1], [0.2]]),
            "next": {"samples": samples},
        },
        [2],
    )
    y, u = Sensing.measured(rows)
    torch.testing.assert_close(y, torch.tensor([[0.5], [2.0], [torch.nan]]), equal_nan=True)
    assert u.flatten().tolist() == pytest.approx([0.1, 0.2])
