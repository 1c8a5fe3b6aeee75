"""Excitation: unchanged where the plant stays within its limits, flown by a linear model where it would not."""

from types import SimpleNamespace

import pytest
import torch
from plants import Plant, Upright
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from dynasindy.control import Observer
from dynasindy.control.sensing import Sensing
from dynasindy.dyna.excite import (
    RegulatedExcitation,
    _excitation_limits,
    _fit_local_model,
    _interact,
    excitation_findings,
    excite,
)
from dynasindy.envs import (
    ControlEnv,
    Foreign,
    GymnasiumEnv,
    Multisine,
    RandomStep,
    Sensors,
    Step,
    Tracking,
    TrackingReward,
)
from dynasindy.findings import note, weak
from dynasindy.systems import Pendulum, Xi
from dynasindy.systems.transitions import Transitions

BOUNDS = {"theta": 0.5, "p": 2.0}


def parts(plant, n_r=1, duration=10.0, sensing=None, careful=None, **settings):
    names = plant.signature.state_names
    random = RandomStep([-0.2] * n_r, [0.2] * n_r)
    task = Tracking(plant.signature, random, names[:n_r], (), TrackingReward((1.0,)), **settings)
    env = ControlEnv(plant, task, dtype=torch.float64)
    signal = Multisine(plant.signature.n_u, duration=duration, dt=0.05, amplitude=0.3, seed=1, **(careful or {}))
    return SimpleNamespace(plant=env, env=env, excitation=signal, sensing=sensing)


def finding(code, made, rows):
    """Return what is said of an excitation under a code, None if nothing."""
    return next((each for each in excitation_findings(made, rows) if each.code == code), None)


def test_a_plant_within_its_limits_is_excited_open_loop_as_ever():
    mine, plain = parts(Xi(), 2, 2.0), parts(Xi(), 2, 2.0)
    excited, wanted = excite(mine), _interact(plain.env, plain.excitation, 40)
    assert set(excited.keys(True, True)) == set(wanted.keys(True, True)) and excited.shape == wanted.shape == (40,)
    for key in wanted.keys(True, True):
        torch.testing.assert_close(excited[key], wanted[key], atol=0.0, rtol=0.0)
    assert finding("excitation.restarts", mine, excited) is None


def test_a_plant_that_falls_is_caught_after_its_first_fall():
    experiment = parts(Upright(5.0, 8.0, 1.0), bounds={"theta": 0.5})
    excited = excite(experiment)
    assert len(excited) == 200
    begins = [*(excited["step_count"].flatten() == 0).nonzero().flatten().tolist(), 200]
    assert not excited["state"][begins[:-1]].any()  # each try begins where episodes do
    lengths = [b - a for a, b in zip(begins, begins[1:], strict=False)]
    assert lengths[0] < 40 and max(lengths) > 100
    inside = excited["next", "state"][:, 0].abs() <= 0.5
    last = torch.zeros(200, dtype=torch.bool)
    last[[b - 1 for b in begins[1:]]] = True
    assert inside[~last].all() and not inside[begins[1] - 1]
    assert excited["action"][begins[-2] :].std() > 0.05  # the signal goes on, on top of the loop
    times = len(lengths) - 1
    left = {"state": "theta", "low": -0.5, "high": 0.5, "unit": "rad", "times": times}
    assert finding("excitation.restarts", experiment, excited) == note(
        "excitation.restarts", times=times, beyond=[left]
    )


def test_a_plant_that_begins_many_ranges_from_zero_is_excited_there_without_bounds():
    """A tank of 350 K, of which some kelvin are usual, cools towards 340 K."""
    tank = Plant("T", lambda x, u: [0.1 * (340.0 - x) + u], (5.0,))
    experiment = parts(tank, start={"T": 350.0})
    rows = excite(experiment)
    assert finding("excitation.restarts", experiment, rows) is None and rows["step_count"].max() == len(rows) - 1 == 199
    experiment.plant.task = experiment.plant.task.with_starts(torch.tensor([[350.0], [352.0]]))
    assert [end.tolist() for end in _excitation_limits(experiment)] == [[300.0], [402.0]]
    unsure = parts(tank, start={"T": 350.0}, careful={"first": 0.1}, low=[350.0], high=[354.0])
    assert [end.tolist() for end in _excitation_limits(unsure)] == [[346.0], [358.0]]  # a range beyond its targets


@pytest.mark.parametrize("spring", [0.0, 4.0])
def test_behind_sensors_a_pole_that_falls_is_held_after_a_few_tries(spring):
    """The pole falls e-fold in a quarter of a second, five periods, and its rates are not measured."""

    def rates(p, theta, v, omega, u):
        push = 8.0 * u - spring * p  # of a cart whose acceleration is given, with a spring that pulls it home
        return [v, omega, push, 16.0 * torch.sin(theta) - 1.5 * torch.cos(theta) * push]

    plant = Plant("p theta v omega", rates, (1, 0.2, 1, 1))
    box = [-1.0, 0.0], [1.0, 0.0]
    task = Tracking(plant.signature, RandomStep(*box), ["p", "theta"], [], TrackingReward((1.0,)), bounds=BOUNDS)
    env = ControlEnv(plant, task, dtype=torch.float64)
    sensors = Sensors({"p": {"resolution": 1e-3}, "theta": {"resolution": 1.5e-3}}, rates={"p": "v", "theta": "omega"})
    sensing = Sensing(env, Observer(plant, sensors, env), torch.Generator().manual_seed(0))
    signal = Multisine(1, duration=10.0, dt=0.05, amplitude=0.2, seed=1)
    excited = excite(
        SimpleNamespace(plant=env, env=TransformedEnv(env, sensing.on(env)), excitation=signal, sensing=sensing)
    )
    begins = [*(excited["step_count"].flatten() == 0).nonzero().flatten().tolist(), 200]
    assert len(begins) <= 5 and max(b - a for a, b in zip(begins, begins[1:], strict=False)) > 80


class Bursting(Upright):
    """The same pendulum, no number any more where it leaves its limits, all within one period."""

    def forward(self, x, u):
        dx = super().forward(x, u)
        return torch.where(x[..., :1].abs() > 0.5, torch.nan, dx)


def test_a_plant_that_blows_up_within_one_period_is_caught_too():
    excited = excite(parts(Bursting(5.0, 8.0, 1.0), bounds={"theta": 0.9}))
    assert len(excited) == 200 and excited["next", "state"].isfinite().all()
    begins = [*(excited["step_count"].flatten() == 0).nonzero().flatten().tolist(), 200]
    lengths = [b - a for a, b in zip(begins, begins[1:], strict=False)]
    assert lengths[0] < 40 and max(lengths) > 100  # the first try falls, and a later one is held


def test_an_episode_that_the_task_ends_closes_no_loop(monkeypatch):
    monkeypatch.setattr(RegulatedExcitation, "close", lambda *_: pytest.fail("the loop is closed"))
    excited = excite(parts(Xi(), 2, 2.0, max_steps=15))
    assert excited["step_count"].flatten().tolist() == [*range(15), *range(15), *range(10)]


def test_periods_at_a_stop_are_told_as_they_are_left_out():
    experiment = parts(Xi(), 2, 2.0)
    rows = excite(experiment)
    assert finding("excitation.stops", experiment, rows) is None
    rows["next", "at_stop"][[3, 4, 17]] = True
    fine = Transitions.from_periods(rows, 0.01)
    assert finding("excitation.stops", experiment, rows) == note("excitation.stops", count=3, total=40, much=False)
    assert len(fine) == (40 - 3) * rows["next", "samples"].shape[-2]
    # What would leave more data is said only where much is lost.
    for count, kind in ((9, note), (10, weak)):
        rows["next", "at_stop"][:] = False
        rows["next", "at_stop"][:count] = True
        assert finding("excitation.stops", experiment, rows) == kind(
            "excitation.stops", count=count, total=40, much=kind is weak
        )


def kept_share(rate, steps):
    """Return what n Runge-Kutta steps of z in a period of 0.05 s leave of x - u, where e^(-0.05 rate) is right."""
    z = 0.05 * rate / steps
    return (1 - z + z**2 / 2 - z**3 / 6 + z**4 / 24) ** steps


@pytest.mark.parametrize(("rate", "steps"), [(5.0, None), (100.0, None), (220.0, 10), (800.0, 20)])
def test_runge_kutta_steps_too_long_for_the_plant_are_told_with_as_many_as_it_needs(rate, steps):
    experiment = parts(Plant("x", lambda x, u: [rate * (u - x)]), duration=2.0)
    rows = excite(experiment)
    told, most = finding("plant.coarse_steps", experiment, rows), float((rows["state"] - rows["action"]).abs().max())
    fewer = [n for n in (5, 10, 20) if n < (steps or 5)]
    assert all(abs(kept_share(rate, n) - kept_share(rate, 2 * n)) * most > 1e-3 for n in fewer)
    assert abs(kept_share(rate, steps or 5) - kept_share(rate, 2 * (steps or 5))) * most <= 1e-3
    elsewhere = abs(kept_share(rate, 5) - kept_share(rate, 10)) * most
    wanted = weak("plant.coarse_steps", apart=pytest.approx(elsewhere, rel=0.01), needed=steps)
    assert told == (None if steps is None else wanted)


@pytest.mark.parametrize(("steps", "longer"), [(200, False), (201, True)])
def test_episodes_longer_than_an_environment_is_registered_with_are_said(steps, longer):
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"])
    task = Tracking(system.signature, Step([[1.0, 0.0]]), ("c", "s"), (), TrackingReward((4.0,)), steps)
    rows = TensorDict({"step_count": torch.zeros(1, 1), "next": {"at_stop": torch.zeros(1, 1)}}, [1])
    told = note("plant.longer_episodes", steps=steps, registered=200) if longer else None
    assert finding("plant.longer_episodes", SimpleNamespace(plant=GymnasiumEnv(system, task), sensing=1), rows) == told
    plant = Pendulum()
    task = Tracking(plant.signature, RandomStep([0], [1]), ("theta",), (), TrackingReward((4.0,)), 9000)
    assert finding("plant.longer_episodes", SimpleNamespace(plant=ControlEnv(plant, task), sensing=True), rows) is None


ENDS = torch.tensor([-0.5, -torch.inf]), torch.tensor([0.5, torch.inf])


def falling_parts(measured):
    plant = Upright(40.0, 60.0, 3.0, 1.0, (0.5, 3.0))
    task = Tracking(plant.signature, RandomStep([-0.2], [0.2]), ["theta"], [], TrackingReward((1.0,)))
    env = ControlEnv(plant, task, dtype=torch.float64)
    made = SimpleNamespace(plant=env, env=env, sensing=None)
    if measured:
        sensors = Sensors({"theta": {"resolution": 1.5e-3}}, rates={"theta": "Omega"})
        made.sensing = Sensing(env, Observer(plant, sensors, env), torch.Generator().manual_seed(0))
        made.env = TransformedEnv(env, made.sensing.on(env))
    return made


def tries(made, number):
    """Falls under random inputs."""
    generator = torch.Generator().manual_seed(3)

    def shaken(tensordict):
        return tensordict.set("action", 0.3 * torch.randn(1, generator=generator))

    return torch.cat([_interact(made.env, shaken, 40, ENDS) for _ in range(number)])


@pytest.mark.parametrize("measured", [False, True])
def test_slopes_are_those_of_the_plant_at_its_start(measured):
    made = falling_parts(measured)
    assert _fit_local_model(tries(made, 1)[:1], made) is None  # five samples for four numbers an equation
    found = _fit_local_model(tries(made, 6), made)
    assert found.home.tolist() == [0.0, 0.0]
    torch.testing.assert_close(found.a[0], torch.tensor([0.0, 1.0]).double(), atol=0.02, rtol=0.0)
    assert found.a[1, 0].item() == pytest.approx(40.0, rel=0.06)
    assert found.a[1, 1].item() == pytest.approx(-1.0, abs=1.0)
    assert found.b.flatten().tolist() == pytest.approx([0.0, 60.0], rel=0.06, abs=0.02)
    assert found.c.tolist() == pytest.approx([0.0, 3.0], abs=0.3)
    assert (found.model is None) != measured
    if measured:
        x, u = torch.tensor([[0.1, -0.4]]).double(), torch.tensor([[0.2]]).double()
        linear = x @ found.a.mT + u @ found.b.mT + found.c
        torch.testing.assert_close(found.model(x, u), linear)


def test_true_states_are_not_read_behind_an_encoder():
    made = falling_parts(True)
    rows = tries(made, 4)
    blind = rows.clone()
    blind["true_state"].fill_(torch.nan)
    blind["next", "true_state"].fill_(torch.nan)
    assert torch.equal(_fit_local_model(rows, made).a, _fit_local_model(blind, made).a)
