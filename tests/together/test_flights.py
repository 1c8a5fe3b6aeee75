"""Runs that fly together come to what each comes to alone."""

import math
from functools import partial

import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.envs import ControlEnv
from dynasindy.planning import replay_error
from dynasindy.systems import Tras, Xi
from dynasindy.systems.compiler import compiler
from dynasindy.tasks import RandomStep, Tracking, Wave
from dynasindy.together import Company, fly
from dynasindy.together.flights import replay
from dynasindy.world_models import Oracle, SindyModel

COMPILER = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"))


def env(seed, plant=Xi, steps=12, dt=0.05, **given):
    system = plant(**given)
    moving = Wave([0.4, 0.3], [0.5, 0.3], random=True)  # what is told of the wrong time is seen
    task = Tracking(system.signature, moving, max_steps=steps, observe_rate=True)
    return ControlEnv(system, task, dt=dt, dtype=torch.float64, seed=seed)


def model(seed, machine_code=True):
    """Return the paper's model, off by some per cent: another one for each seed."""
    found, rng = SindyModel(Xi().signature, machine_code=machine_code), torch.Generator().manual_seed(0)
    x = torch.randn(400, 6, generator=rng).double() * torch.tensor(Xi().signature.x_scale)
    u = torch.randn(400, 2, generator=rng).double()
    found.fit_derivatives(x, u, Xi()(x, u))
    found.set_coefficients(found.coefficients * (1.0 + 0.03 * (seed + 1)))
    return found


def agent(seed):
    return TD3(10, 2, seed=seed, hidden=(16, 8), exploration_noise=0.3)


def assert_same(found, wanted):
    assert set(found.keys(True, True)) == set(wanted.keys(True, True))
    assert found.batch_size == wanted.batch_size
    for key in wanted.keys(True, True):
        assert found[key].dtype == wanted[key].dtype, key
        torch.testing.assert_close(
            found[key], wanted[key], rtol=1e-4, atol=1e-5, msg=lambda said, key=key: f"{key}: {said}"
        )


@pytest.mark.parametrize("device", ["cpu", GPU])
@pytest.mark.parametrize("plant", [Xi, Tras])
def test_real_episodes_are_those_of_each_run_alone(plant, device):
    def _fly(seed):
        place = env(seed, plant)
        return fly(place, agent(seed).explore, place.reset, 12, "real episode")

    found = Company(device).run([partial(_fly, seed) for seed in range(3)])
    for seed, rollout in enumerate(found):
        place = env(seed, plant)
        wanted = place.rollout(12, agent(seed).explore)
        assert_same(rollout, wanted)
    assert not torch.equal(found[0]["action"], found[1]["action"])


@pytest.mark.parametrize(("rows", "steps"), [(1, 6), (3, 1)])
def test_a_rollout_stays_as_it_is_when_the_next_one_is_flown(rows, steps):
    place, mine = env(0), agent(0)

    def _fly(size):
        start = partial(place.start_from, size * torch.ones(rows, 6, dtype=torch.float64))
        return fly(place, mine.explore_imagined, start, steps, "imagined")

    with Company().alone():
        first = _fly(0.1)
        kept, second = first.clone(), _fly(0.3)
    assert all(torch.equal(first[key], kept[key]) for key in first.keys(True, True))
    assert not torch.equal(first["action"], second["action"])


def test_noise_decays_with_real_steps_alone():
    def _fly(seed):
        mine, place = agent(seed), env(seed)
        fly(place, mine.explore_imagined, place.reset, 5, "imagined")
        kept = mine.noise.sigma
        fly(place, mine.explore, place.reset, 5, "real episode")
        return kept, mine.noise.sigma

    assert Company().run([partial(_fly, 0)]) == [(0.3, pytest.approx(0.3 * (1 - 1e-3) ** 5))]


@pytest.mark.parametrize("device", ["cpu", GPU])
def test_models_with_coefficients_of_their_own_fly_at_once(device):
    def _start(place):
        return place.start_from(0.1 * torch.ones(4, 6, dtype=torch.float64))

    def _fly(seed):
        place = env(0).with_system(model(seed), torch.float32, seed)
        return fly(place, agent(seed).deployed, partial(_start, place), 6, "imagined")

    company = Company(device)
    for seed, rollout in enumerate(company.run([partial(_fly, seed) for seed in range(2)])):
        place = env(0).with_system(model(seed), torch.float32, seed)
        wanted = place.rollout(6, agent(seed).deployed, auto_reset=False, tensordict=_start(place))
        assert_same(rollout, wanted)
    assert len(company.kept) == 1


@pytest.mark.parametrize("steps", [1, 2])
def test_models_in_discrete_time_fly_as_each_alone_and_not_with_others(steps):
    """A period of 0.05 s is one step, or two; a model of the same functions in continuous time is of another kind."""

    def _timed(seed):
        found = model(seed)
        found.library = found.library.with_step(None if seed == 2 else 0.05 / steps)
        return env(0).with_system(found, torch.float32, seed)

    def _start(place):
        return place.start_from(0.1 * torch.ones(4, 6, dtype=torch.float64))

    def _fly(seed):
        place = _timed(seed)
        return fly(place, agent(seed).deployed, partial(_start, place), 6, "imagined")

    company = Company("cpu")
    for seed, rollout in enumerate(company.run([partial(_fly, seed) for seed in range(3)])):
        wanted = _timed(seed).rollout(6, agent(seed).deployed, auto_reset=False, tensordict=_start(_timed(seed)))
        assert_same(rollout, wanted)
    assert len(company.kept) == 2


@pytest.mark.parametrize("given", [{"plant": Tras}, {"dt": 0.1}, {"azimuth_stop": 1e-3}, {"steps": 13}])
def test_runs_of_other_plants_paces_and_tasks_fly_apart(given):
    def _fly(given):
        place = env(0, **given)
        return fly(place, agent(0).deployed, place.reset, 12, "evaluation")

    cases = ({}, given)
    for case, found in zip(cases, Company().run([partial(_fly, case) for case in cases]), strict=True):
        assert_same(found, env(0, **case).rollout(12, agent(0).deployed, break_when_any_done=False))


def test_policies_of_other_widths_fly_apart():
    def _fly(width):
        place, mine = env(0), TD3(10, 2, seed=0, hidden=(width,))
        return fly(place, mine.deployed, place.reset, 4, "evaluation")["action"].shape

    assert Company().run([partial(_fly, width) for width in (4, 6)]) == [(4, 2)] * 2


def test_models_of_other_kinds_fly_apart_and_equal_ones_at_once():
    def _fly(seed, plant):
        place = env(0).with_system(Oracle(Xi().signature, plant()))
        return fly(place, agent(seed).deployed, place.reset, 4, "imagined")

    for plants, kinds in (((Xi, Xi), 1), ((Xi, Tras), 2)):
        company = Company()
        found = company.run([partial(_fly, seed, plant) for seed, plant in enumerate(plants)])
        assert len(company.kept) == kinds
        for seed, (plant, rollout) in enumerate(zip(plants, found, strict=True)):
            place = env(0).with_system(Oracle(Xi().signature, plant()))
            assert_same(rollout, place.rollout(4, agent(seed).deployed, break_when_any_done=False))


def test_a_plant_that_runs_away_stays_at_the_end_of_its_ranges():
    def _env():
        place = env(0)
        place.left_beyond = 0.01
        return place

    with Company().alone():
        found = fly(_env(), agent(0).deployed, _env().reset, 12, "evaluation")
    assert_same(found, _env().rollout(12, agent(0).deployed, break_when_any_done=False))
    assert (found["next", "state"].abs() >= 0.01).any()


def test_a_stop_that_is_touched_and_left_within_a_period_is_told():
    # Up against the stop, from which gravity pulls the beam back before the period ends.
    x = torch.tensor([[0.0, 0.0999, 0.0, 0.05, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    place, other = env(0, pitch_stop=0.1), env(0, pitch_stop=0.1)
    with Company().alone():
        found = fly(place, agent(0).deployed, lambda: place.start_from(x), 1, "evaluation")
    assert found["next", "at_stop"].flatten().tolist() == [True, False]
    assert found["next", "state"][0, 0, 1] < 0.0999
    assert_same(found, other.rollout(1, agent(0).deployed, auto_reset=False, tensordict=other.start_from(x)))


def test_nothing_flies_together_outside_of_a_company_or_with_a_policy_of_another_kind():
    place = env(0)
    assert fly(place, agent(0).deployed, place.reset, 2, "evaluation") is None
    with Company().alone():
        assert fly(place, lambda seen: seen.set("action", torch.zeros(2)), place.reset, 2, "evaluation") is None


def test_tasks_that_learn_what_a_plant_pays_fly_alone():
    class Learning(Tracking):
        def learn(self, x, u, x_next, paid):
            self.paid = paid

    system = Xi()
    place = ControlEnv(system, Learning(system.signature, RandomStep([-0.5, -0.5], [0.5, 0.4])), dtype=torch.float64)
    with Company().alone():
        assert fly(place, agent(0).deployed, place.reset, 2, "evaluation") is None


@pytest.mark.parametrize("device", ["cpu", GPU])
@pytest.mark.parametrize("windows", [None, torch.tensor([2, 5])])
@pytest.mark.parametrize("machine_code", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("stop", [{}, {"azimuth_stop": 1e-3}])
def test_replays_of_models_are_those_of_each_run_alone(windows, device, machine_code, stop):
    """Those of models with machine code are not asked of the company, as the run is through with them sooner."""

    def _judge(seed):
        place = env(seed, **stop)
        episode = place.rollout(12, agent(seed).explore)
        model_env = place.with_system(model(seed, machine_code), torch.float32)
        return replay_error(model_env, episode, windows, None if windows is None else 4)

    company = Company(device)
    found = company.run([partial(_judge, seed) for seed in range(2)])
    assert len(company.kept) == (not machine_code)
    for seed, error in enumerate(found):
        wanted = _judge(seed)
        assert error.reward_error == pytest.approx(wanted.reward_error, rel=1e-4)
        assert error.state_error == pytest.approx(wanted.state_error, rel=1e-4)
        torch.testing.assert_close(error.states, wanted.states, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("machine_code", [pytest.param(True, marks=COMPILER), False])
@pytest.mark.parametrize("used", [False, True])
def test_an_infinite_function_counts_where_an_equation_has_it_and_nowhere_else(used, machine_code):
    """e^(omega_a) is beyond all numbers at 2000 rpm: the model that lacks it goes on, in company as alone."""
    signature = Xi().signature

    def _model():
        names = [*signature.state_names, *signature.input_names, "exp(omega_a)"]
        found = SindyModel(signature, names, machine_code=machine_code)
        xi = torch.zeros(len(names), 6, dtype=torch.float64)
        xi[2, 0] = xi[3, 1] = 1.0
        xi[range(2, 6), range(2, 6)] = -1.0
        xi[6, 4] = xi[7, 5] = 500.0
        xi[8, 4] = 1e-3 * used
        found.set_coefficients(xi)
        return found

    def _moved():
        place = env(0).with_system(_model())
        x = torch.tensor([[0.1, 0.0, 0.2, 0.1, 2000.0, 300.0]], dtype=torch.float64)
        start = place.start_from(x)
        u = torch.full((3, 1, 2), 0.2, dtype=torch.float64)
        return replay(place, x, start["task_params"], start["step_count"].squeeze(-1), u, "replay"), place.follow(x, u)

    with Company().alone():
        (states, earned), (alone, _) = _moved()
    wanted = alone[..., -1, :]
    assert bool(wanted.isfinite().all()) == bool(states.isfinite().all()) == (not used)
    if not used:
        torch.testing.assert_close(states, wanted, rtol=1e-9, atol=1e-9)
        # omega' = 500 u - omega, from 2000, 0.15 s later, by hand
        assert float(states[-1, 0, 4]) == pytest.approx(100 + 1900 * math.exp(-0.15), rel=1e-6)
        assert bool(earned.isfinite().all())


@pytest.mark.parametrize("machine_code", [pytest.param(True, marks=COMPILER), False])
def test_a_replay_ends_where_states_leave_their_ranges_as_an_episode_does(machine_code):
    place = env(0).with_system(model(0, machine_code))
    place.left_beyond = 0.01
    start = place.reset()
    rollout = place.rollout(12, agent(0).deployed, auto_reset=False, tensordict=start)
    wanted, u = rollout["next", "state"], rollout["action"].double().unsqueeze(1)
    x, params, begun = start["state"].unsqueeze(0), start["task_params"].unsqueeze(0), start["step_count"]
    assert (wanted[-1].abs() >= 0.01 * torch.tensor(place.system.signature.x_scale) - 1e-9).any()
    torch.testing.assert_close(place.follow(x, u)[0][:, 0, -1], wanted, rtol=1e-9, atol=1e-12)
    with Company().alone():
        states, _ = replay(place, x, params, begun, u, "replay")
    torch.testing.assert_close(states[:, 0], wanted, rtol=1e-6, atol=1e-9)
