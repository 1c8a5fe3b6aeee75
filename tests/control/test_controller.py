"""A controller flies as its evaluation does, leaves no steady error, and comes whole out of its file."""

import copy
import json
import math
import pickle
import warnings
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from controllers import PENDULUM, angle_task, pendulum_controller
from plants import A, B, Plant, spring

from dynasindy.agents import actor
from dynasindy.control import Controller, Observer, load, save
from dynasindy.control.controller import ControlSetup, IntegralAction, acting
from dynasindy.control.sensing import Sensing
from dynasindy.envs import ControlEnv, Sensors, Step, Tracking, TrackingReward, Wave
from dynasindy.evaluation.disturbances import PerturbedPlant
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.safe_io import DamagedFileError
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum, Stops

WORDS = ["u", "Omega", "sin(theta)"]
COUNT = 2 * math.pi / 4096


def pendulum_model():
    model = SindyModel(Pendulum().signature, WORDS, known={"theta": "Omega"})
    coefficients = torch.zeros(3, 2, dtype=torch.float64)
    for name, i, value in (("Omega", 0, 1.0), ("u", 1, 11.0), ("Omega", 1, -0.6), ("sin(theta)", 1, -9.5)):
        coefficients[model.library.index(name), i] = value
    model.set_coefficients(coefficients)
    return model


def setting(reference=None, observe_rate=False):
    task = angle_task(reference or Step([[0.3]]), observe_rate=observe_rate, low=[-0.2], high=[0.6])
    with torch.random.fork_rng():
        torch.manual_seed(3)
        policy = actor(task.n_o, 1, (16, 16)).requires_grad_(False)
    return ControlEnv(Pendulum(), task, dtype=torch.float64), policy


def watching(env, disturbance=True, **settings):
    channels = {"theta": {"resolution": COUNT}}
    sensors = Sensors(channels, rates={"theta": "Omega"}, disturbance=disturbance, **settings)
    observer = Observer(pendulum_model(), sensors, env)
    observer.load_state_dict({"process_noise": [0.01, 0.02] + [0.01] * disturbance, "nis": 1.0})
    return observer


def flown(controller, plant, references, rates=None, measured=None):
    """Fly a plant with a controller, all in plain loops; returns states and inputs."""
    x, states, inputs = torch.zeros(2, dtype=torch.float64), [], []
    for k, r in enumerate(references):
        y = x.numpy() if measured is None else measured[k]
        u = controller.act(y, r, None if rates is None else rates[k])
        states.append(x.numpy().copy())
        inputs.append(u)
        x = plant.advance(x, torch.from_numpy(u).float().double())[0][-1]
    return np.array(states), np.array(inputs)


@pytest.mark.parametrize("integral", [None, {"gain": 0.4, "band": 0.5}])
def test_it_flies_as_the_evaluation_does_where_all_states_are_seen(integral):
    env, policy = setting()
    wrapped = policy if integral is None else IntegralAction(policy, env, **integral)
    expected = evaluate(env, wrapped, Scenario("step", seconds=4.0)).trajectory[0]
    controller = Controller(policy, ControlSetup(env.task, env.dt), integral=integral)
    states, inputs = flown(controller, env, [[0.3]] * 80)
    np.testing.assert_allclose(inputs, expected["action"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(states, expected["state"], rtol=0, atol=1e-6)


def test_it_is_shown_how_fast_the_reference_moves():
    env, policy = setting(Wave([0.3], [0.4]), observe_rate=True)
    expected = evaluate(env, policy, Scenario("sine", seconds=4.0)).trajectory[0]
    t = 0.05 * np.arange(80)
    references, rates = 0.3 * np.sin(0.8 * math.pi * t), 0.24 * math.pi * np.cos(0.8 * math.pi * t)
    _, inputs = flown(Controller(policy, ControlSetup(env.task, env.dt)), env, references[:, None], rates[:, None])
    np.testing.assert_allclose(inputs, expected["action"], rtol=0, atol=1e-6)
    _, blind = flown(Controller(policy, ControlSetup(env.task, env.dt)), env, references[:, None])
    assert np.abs(blind - inputs).max() > 1e-3


def constant():
    """Return a controller whose action is constant, of a place that two inputs move."""
    plant = Plant("x", lambda x, one, two: [one + 10 * two], inputs="one two")
    task = Tracking(plant.signature, Step([[0.0]]), ("x",), (), TrackingReward((1.0,)))
    observer = Observer(plant, Sensors({"x": {}}), ControlSetup(task, 0.1))
    observer.load_state_dict({"process_noise": [0.01], "nis": 1.0})
    setup = ControlSetup(task, 0.1)
    return Controller(lambda shown: shown.set("action", torch.tensor([0.5, -0.25])), setup, observer)


def test_a_lost_sample_is_bridged_with_all_inputs_that_were_given():
    """From 0.3 m, 0.1 s under inputs of 0.5 and -0.25 lead to 0.3 + 0.1 (0.5 - 2.5) m."""
    controller = constant()
    controller.act([0.3], [0.0])
    controller.act([math.nan], [0.0])
    np.testing.assert_allclose(controller.estimate, [0.1], rtol=0, atol=1e-6)


def test_measurements_beyond_all_limits_count_as_lost():
    """From 1.5e308 m to -1.5e308 m is further than the largest double, 1.8e308; the action is constant."""
    controller = constant()
    controller.act([1.5e308], [0.0])
    np.testing.assert_allclose(controller.estimate, [0.0], rtol=0, atol=1e-12)
    controller.act([0.3], [0.0])
    estimates = []
    for y in (-1.5e308, 0.3):
        np.testing.assert_array_equal(controller.act([y], [0.0]), [0.5, -0.25])
        estimates.append(controller.estimate[0])
    assert np.abs(estimates).max() < 1.0 and estimates[1] == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(("disturbance", "integral"), [(False, None), (True, {"band": 0.5})])
def test_it_flies_as_the_evaluation_does_behind_sensors(disturbance, integral):
    env, policy = setting()
    observer = watching(env, disturbance)
    wrapped = policy if integral is None else IntegralAction(policy, env, **integral)
    expected = evaluate(env, wrapped, Scenario("step", seconds=4.0), observer).trajectory[0]
    controller = Controller(policy, ControlSetup(env.task, env.dt, env.substeps), observer, integral)
    measured = expected["measurement"].numpy()
    assert np.isnan(measured[:, 1]).all()
    _, inputs = flown(controller, env, [[0.3]] * 80, measured=measured)
    np.testing.assert_allclose(inputs, expected["action"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(controller.estimate, expected["observer", "mean"][-1, :2], rtol=0, atol=1e-6)


def test_a_reset_reads_weights_that_were_changed():
    env, policy = setting()
    controller = Controller(policy, ControlSetup(env.task, env.dt))
    before = controller.act([0.1, 0.0], [0.3])
    for weight in policy.parameters():
        weight.mul_(0.5)
    controller.reset()
    found = controller.act([0.1, 0.0], [0.3])
    assert not np.allclose(found, before)
    np.testing.assert_allclose(found, Controller(policy, ControlSetup(env.task, env.dt)).act([0.1, 0.0], [0.3]))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_a_copy_of_a_controller_goes_on_by_itself(copied):
    env, policy = setting()
    controller = Controller(policy, ControlSetup(env.task, env.dt), watching(env), {"gain": 0.4, "band": 0.5})
    for k in range(3):
        controller.act([0.02 * k, math.nan], [0.1])
    other = copied(controller)
    wanted = [controller.act([0.04, math.nan], [0.1]) for _ in range(4)]
    assert len(set(np.ravel(wanted).tolist())) == 4
    np.testing.assert_array_equal([other.act([0.04, math.nan], [0.1]) for _ in range(4)], wanted)


def test_numbers_may_be_given_by_name():
    env, policy = setting()
    controller = Controller(policy, ControlSetup(env.task, env.dt))
    by_place = controller.act([0.1, -0.2], [0.3])
    controller.reset()
    np.testing.assert_array_equal(by_place, controller.act({"Omega": -0.2, "theta": 0.1}, {"theta": 0.3}))
    assert controller.signature.input_names == ("u",)
    assert (controller.dt, controller.outputs) == (0.05, ("theta",))


@pytest.mark.parametrize(
    ("measurement", "reference", "words"),
    [
        ([0.1], [0.3], "measurement has 1"),
        ([0.1, 0.0], ["a"], r"reference is \['a'\]; .*theta"),
        (None, [0.3], "measurement is None; .*theta, Omega"),
        ([0.1, math.nan], [0.3], "measurement of Omega is nan"),
        ({"theta": 0.1, "speed": 0.0}, [0.3], "measurement has 'speed'"),
        ([0.1, 0.0], [math.nan], "reference of theta is nan"),
        ([0.1, 0.0], {}, "reference of theta"),
    ],
)
def test_what_is_no_number_of_the_plant_is_refused(measurement, reference, words):
    env, policy = setting()
    with pytest.raises(ValueError, match=words):
        Controller(policy, ControlSetup(env.task, env.dt)).act(measurement, reference)


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("integral", [None, {"band": 0.5}])
def test_a_number_beyond_all_limits_is_refused_and_changes_nothing(observed, integral):
    env, policy = setting()
    setup = ControlSetup(env.task, env.dt, env.substeps)
    controller = Controller(policy, setup, watching(env) if observed else None, integral)

    def later():
        return [controller.act([0.1 * k, 0.2], [0.3]) for k in range(2, 6)]

    begin = [controller.act([0.1 * k, 0.2], [0.3]) for k in range(2)]
    expected = later()
    controller.reset()
    assert controller.estimate is None
    for wrong in ([1e300, 1e300], [1e300, -1e300]):
        with pytest.raises(ValueError, match="follows") as caught:
            controller.act(wrong, [-1e300])
        assert "\n" not in str(caught.value)
    np.testing.assert_array_equal([controller.act([0.1 * k, 0.2], [0.3]) for k in range(2)], begin)
    with pytest.raises(ValueError, match="follows"):
        controller.act([1e300, 1e300], [-1e300])
    np.testing.assert_array_equal(later(), expected)


def test_a_reference_far_beyond_the_targets_of_the_plan_is_warned_of_once():
    env, policy = setting()  # planned for -0.2 to 0.6 rad, which span 0.8 rad
    controller = Controller(policy, env)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller.act([0.0, 0.0], [1.39])
        controller.act([0.0, 0.0], [-0.99])
    words = r"1\.41.*-0\.2 to 0\.6 rad"
    with pytest.warns(UserWarning, match=words) as told:
        controller.act([0.0, 0.0], [1.41])
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller.act([0.0, 0.0], [900.0])
    with pytest.warns(UserWarning, match=r"-1\.01"):
        Controller(policy, env).act([0.0, 0.0], [-1.01])
    env.task.signature = replace(env.task.signature, state_units=("-", "1/s"))
    assert Controller(policy, env).targets_in_words() == ["theta from -0.2 to 0.6"]


def proportional_loop():
    task = angle_task(Step([[0.2]]), max_steps=600)
    env = ControlEnv(Pendulum(), task)

    def proportional(tensordict):
        error = tensordict["observation"][..., 2:3] * task.error_scale
        rate = tensordict["state"][..., 1:2].float()
        return tensordict.set("action", (error - 0.5 * rate).clamp(-1, 1))

    return env, proportional


def test_an_output_without_a_rate_is_integrated_as_if_it_stood_still():
    plant = Pendulum()
    outputs, reward = ("Omega", "theta"), TrackingReward((4.0,))
    task = Tracking(plant.signature, Step([[0.6, 0.2]]), outputs, (None, "Omega"), reward)
    env = ControlEnv(plant, task)
    action = IntegralAction(proportional_loop()[1], env, gain=2.0, band=10.0, rate=0.4, limit=10.0)
    action.policy = lambda tensordict: tensordict.set("action", torch.zeros(1))
    action(env.start_from(torch.tensor([0.0, 0.4])))
    error, box = torch.tensor([0.2, 0.2]), task.boxes().float()
    share = torch.tensor([1.0, 1 / (1 + (1 / float(box[1])) ** 2)])  # of theta, whose rate is Omega = 0.4 rad/s
    torch.testing.assert_close(action.integral, 2.0 * env.dt * share * error / box)


def test_shift_and_integral_are_those_of_the_formulas_on_a_moving_reference():
    task = angle_task(Wave([0.3], [0.2]))
    env = ControlEnv(Pendulum(), task, dtype=torch.float64)
    seen = []

    def policy(tensordict):
        seen.append(tensordict["observation"].clone())
        return tensordict.set("action", torch.tensor([0.123]))

    action = IntegralAction(policy, env, gain=3.0, band=0.25, limit=0.02, rate=0.5)
    integral = 0.0
    for k, (angle, speed) in enumerate([(-0.2, 0.1), (-0.1, 0.3), (0.0, 0.5), (0.1, 0.2), (0.4, 0.2), (0.5, -1.0)]):
        now = env.start_from(torch.tensor([angle, speed]))
        now["task_params"] = task.sample(torch.Size(()), torch.Generator()).double()
        now["step_count"] = torch.tensor([5 * k])
        t = 0.25 * k  # the count in control periods of 0.05 s
        true = task.observation(now["state"], now["task_params"], torch.tensor([t])).float()
        now["observation"] = true.clone()
        out = action(now)
        expected = true.clone()
        expected[2] += integral / 0.5  # states first, then the error over 0.5 rad
        torch.testing.assert_close(seen[-1], expected)
        torch.testing.assert_close(out["observation"], true)
        assert out["action"].item() == pytest.approx(0.123)
        error = 0.3 * math.sin(2 * math.pi * 0.2 * t) - angle
        moving = (0.3 * 2 * math.pi * 0.2 * math.cos(2 * math.pi * 0.2 * t) - speed) / 0.5
        step = 3.0 * 0.05 * error / (1 + moving**2) if abs(error) < 0.25 else 0.0
        integral = max(-0.02, min(0.02, integral + step))
        assert action.integral.item() == pytest.approx(integral, abs=1e-7)
    assert len({round(o[2].item(), 3) for o in seen}) == 6 and integral != 0.02  # the limit was met, and left again


def test_a_row_that_begins_anew_forgets_alone():
    env, proportional = proportional_loop()
    action = IntegralAction(proportional, env, gain=2.0, band=1.0)
    start = env.start_from(torch.zeros(2, 2))
    action(start.clone().set("step_count", torch.tensor([[3], [3]])))
    action(start.clone().set("step_count", torch.tensor([[4], [0]])))
    assert action.integral.flatten().tolist() == pytest.approx([0.04, 0.02])  # twice and once 2/s * 0.05 s * 0.2 rad
    action(env.start_from(torch.zeros(3, 2)).set("step_count", torch.ones(3, 1, dtype=torch.int64)))
    assert action.integral.flatten().tolist() == pytest.approx([0.02] * 3)  # another batch begins at zero


def test_band_limit_and_rate_count_in_boxes_of_targets():
    """Half the box and twice the numbers are the same controller."""
    states = []
    for box, factor in ((0.5, 2.0), (1.0, 1.0)):
        task = angle_task(Step([[0.2]]), max_steps=100, error_scale=0.5 * factor, low=[0.0], high=[box])
        env = ControlEnv(Pendulum(), task)

        def proportional(tensordict):
            return tensordict.set("action", (0.5 * tensordict["observation"][..., 2:3]).clamp(-1, 1))

        numbers = {"band": 0.15 * factor, "limit": 0.06 * factor, "rate": 0.3 * factor}
        states.append(env.rollout(100, IntegralAction(proportional, env, gain=2.0, **numbers))["next", "state"])
        assert not torch.allclose(states[-1], env.rollout(100, proportional)["next", "state"], atol=1e-2)
    torch.testing.assert_close(*states)


def counteracted(system, x, u, push, shift):
    """One period's answer to a push on the rate of `p`, of an observer that relies on the system."""
    env = SimpleNamespace(dt=0.1, substeps=1, stops=None)
    observer = Observer(system, Sensors({"p": {}}, {"p": "v"}, disturbance=True), env)
    observer.load_state_dict({"process_noise": [1.0] * (x.shape[-1] + 1), "nis": 1.0})
    return observer.correction(torch.cat([x, push], -1), u.unsqueeze(-2), [0], shift)


def test_on_a_linear_plant_it_solves_the_steady_state_equations():
    push = torch.tensor([[0.3], [-1.0]], dtype=torch.float64)
    shift = torch.zeros(2, 4, dtype=torch.float64)
    for _ in range(5):
        shift = counteracted(spring(), torch.rand(2, 3).double(), torch.rand(2, 1).double(), push, shift)
    held = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    both = torch.cat([torch.cat([A, B], 1), held])
    expected = torch.linalg.solve(both, torch.cat([0 * push, -push, torch.zeros(2, 2)], -1).T).T
    torch.testing.assert_close(shift, expected, rtol=1e-6, atol=1e-6)
    assert shift[0, 2].item() == pytest.approx(-0.15) and shift[0, 3].item() == pytest.approx(-0.15)


CRANE = Plant("p v", lambda p, v, u: [v, torch.tanh(u) - torch.sin(p) - 0.3 * v], (1.5, 3.0))
"""A weight on an arm, of which no slope is that of a chord."""


def test_a_push_on_a_curved_plant_is_counteracted_by_newton_s_steps():
    """tanh(u - du) = tanh(u) + push, by hand; five calls of two steps leave next to nothing."""
    x, u = torch.tensor([0.4, 0.0], dtype=torch.float64), torch.tensor([0.2], dtype=torch.float64)
    push = torch.tensor([-0.2], dtype=torch.float64)
    shift, left = torch.zeros(3, dtype=torch.float64), []
    wanted = 0.2 - math.atanh(math.tanh(0.2) - 0.2)
    for _ in range(5):
        shift = counteracted(CRANE, x, u, push, shift)
        left.append(abs(float(shift[2]) - wanted))
    assert left[1] < 1e-6 and left[-1] < 1e-8
    assert shift[:2].abs().max() < 1e-8


PROPELLER = Plant("p v w", lambda p, v, w, u: [v, 4 * w * w.abs(), 10 * (u - w)], (2.0, 2.0, 0.5))


def test_a_push_is_counteracted_by_a_thrust_that_has_no_slope_at_rest():
    x, u, push = (torch.zeros(n, dtype=torch.float64) for n in (3, 1, 1))
    shift = torch.zeros(4, dtype=torch.float64)
    for _ in range(6):
        shift = counteracted(PROPELLER, x, u, push + 0.2, shift)
    # The first steps overshoot. 4 w |w| = push, by hand, and the input of that speed.
    assert shift[2:].tolist() == pytest.approx([-math.sqrt(0.05)] * 2, rel=1e-2)


WEATHERCOCK = Plant("p v q", lambda p, v, q, u: [v, u - torch.sin(q), 0 * q], (1.0, 1.0, 1.5))
"""A cart that a vane at an angle q pushes, which is the same a turn of the vane away."""


def test_a_push_is_not_counteracted_by_a_turn_of_what_is_not_tracked():
    x, u = torch.zeros(3, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    push, turned = torch.tensor([0.2], dtype=torch.float64), torch.tensor([0, 0, 2 * math.pi, 0], dtype=torch.float64)
    shift = counteracted(WEATHERCOCK, x, u, push, turned)
    assert shift[2].abs() <= 3.0
    for _ in range(9):
        shift = counteracted(WEATHERCOCK, x, u, push, shift)
    # u - du - sin(q - dq) = u - sin(q) + push
    assert float(torch.sin(shift[2]) - shift[3]) == pytest.approx(0.2, abs=1e-3)


def pushed(disturbance=True):
    plant = spring()
    task = Tracking(plant.signature, Step([[0.0]]), ["p"], ["v"], TrackingReward([1.0]))
    env = ControlEnv(plant, task, substeps=1, dtype=torch.float64)
    sensors = Sensors({"p": {"resolution": 1e-3}}, {"p": "v"}, disturbance=disturbance)
    sensing = Sensing(env, Observer(plant, sensors, env), torch.Generator().manual_seed(0))
    sensing.observer.nis = 1.0
    sensing.observer.q[:3] = 1e-3
    return plant, sensing, env


def steer(tensordict):
    """Hold r with u = 2 r, the input of its steady state, and some feedback."""
    seen = tensordict["observation"]
    error, speed = 0.5 * seen[..., 3:4], 2.0 * seen[..., 1:2]
    reference = error + seen[..., :1]
    return tensordict.set("action", 2 * reference + error - 0.5 * speed)


def test_a_constant_push_leaves_no_steady_error_and_without_it_does():
    scenario = Scenario("s", Step([[0.2], [-0.1]]), 2, 15.0, plant=partial(PerturbedPlant, push={"v": 0.3}))
    errors = {}
    for disturbance in (True, False):
        _, sensing, env = pushed(disturbance)
        result = evaluate(env, steer, scenario, sensing.observer)
        errors[disturbance] = result.metrics["steady_state_error"].max().item()
        if disturbance:
            found = result.trajectory["observer", "mean"][:, -50:, 3].mean().item()
            assert found == pytest.approx(0.3, abs=0.01)
    assert errors[True] < 2e-3 and errors[False] > 0.03


def test_the_action_stays_within_its_limits_and_observations_are_shifted():
    _, sensing, env = pushed()
    start = sensing.begin(env.start_from(torch.zeros(1, 3)))
    start["observer", "shift"] = torch.tensor([[0.0, 0.0, 0.1, 3.0]], dtype=torch.float64)
    seen = {}

    def watch(tensordict):
        seen["observation"] = tensordict["observation"]
        return tensordict.set("action", torch.zeros(1, 1))

    before = start["observation"].clone()
    acted = sensing.controller(watch)(start)
    assert acted["action"].tolist() == [[1.0]]
    torch.testing.assert_close(seen["observation"][0, 2], before[0, 2] - 0.1 / 0.5)
    assert torch.equal(acted["observation"], before)


def test_an_input_stays_between_its_ends_with_a_push_and_without_one():
    _, _, env = pushed()
    env.task = env.task.with_input_limits([[-0.25], [0.5]])
    start = env.start_from(torch.zeros(3, 3))
    commands = torch.tensor([[-1.0], [0.25], [0.75]])
    told = acting(lambda tensordict: tensordict.set("action", commands), env)(start)
    assert told["action"].flatten().tolist() == [-0.25, 0.25, 0.5]
    shift = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64).expand(3, -1)
    shifted = acting(lambda tensordict: tensordict.set("action", commands), env, pushed=True)
    start["observer", "shift"] = shift
    assert shifted(start)["action"].flatten().tolist() == [0.0, 0.5, 0.5]


def test_a_plant_without_rates_is_pushed_on_what_is_measured_at_its_own_pace():
    """A vessel empties in some 50 s: 0 = 0.05 (0.4 r + r - x) - 0.02 x + 0.01, which leaves x - r = 0.01 / 0.07 cm."""
    plant = Plant("level flow", lambda x, flow, u: [0.05 * u - 0.02 * x, 0.5 * (u - flow)], (2.0, 1.0))
    task = Tracking(plant.signature, Step([[0.0]]), ["level"], [], TrackingReward([1.0]))
    env, rng = ControlEnv(plant, task, 1.0, 1, dtype=torch.float64), torch.Generator().manual_seed(0)

    def feed(tensordict):
        seen = tensordict["observation"]
        error, level = 0.5 * seen[..., 2:3], 2.0 * seen[..., :1]
        return tensordict.set("action", 0.4 * (level + error) + error)

    scenario, left = (
        Scenario("s", Step([[0.5], [-0.5]]), 2, 250.0, plant=partial(PerturbedPlant, push={"level": 0.01})),
        {},
    )
    u = 2 * torch.rand(300, 1, generator=rng, dtype=torch.float64) - 1
    x = [torch.zeros(2, dtype=torch.float64)]
    for one in u:
        x.append(env.advance(x[-1], one)[0][-1])
    log = torch.stack(x)
    y = torch.stack([log[:, 0] + 0.01 * torch.randn(301, generator=rng), torch.full((301,), torch.nan)], -1)
    for disturbance in (True, False):
        observer = Observer(plant, Sensors({"level": {"noise": 0.01}}, disturbance=disturbance), env)
        assert observer.pushed == ([0] if disturbance else [])
        observer.learn(y.double(), u)
        result = evaluate(env, feed, scenario, observer)
        left[disturbance] = result.metrics["steady_state_error"].max().item()
        if disturbance:
            # The range of its push is how fast the level usually changes, not a range in a second.
            usual = plant(log[:-1], u)[:, 0].square().mean().sqrt()
            torch.testing.assert_close(observer.scale[2], usual, rtol=0.02, atol=0.0)
            again = Observer(plant, observer.sensors, env)
            again.load_state_dict(observer.state_dict())
            assert torch.equal(again.scale, observer.scale)
            with pytest.raises(ValueError, match=r"range > 0 .* 1"):
                again.load_state_dict(observer.state_dict() | {"push_ranges": [-1.0]})
    # The estimate lags behind what is pushed, too, so that more is left than of a level that is known.
    assert left[True] < 0.01 and left[False] > 0.01 / 0.07


def acts(controller):
    controller.reset()
    return np.array([controller.act([0.09 * math.sin(k), math.nan], [0.3], [0.1 * k]) for k in range(30)])


def acts_seeing_all(controller):
    controller.reset()
    return np.array([controller.act([0.3 * math.sin(k), 0.1 * k], [0.3], [0.1 * k]) for k in range(30)])


@pytest.mark.parametrize("observer", [True, False])
@pytest.mark.parametrize("integral", [None, {"gain": 3.0, "band": 0.9}, {"limit": 0.1}])
def test_what_is_loaded_acts_as_what_was_saved(tmp_path, integral, observer):
    controller, act = pendulum_controller(observer, integral), acts if observer else acts_seeing_all
    save(controller, tmp_path / "controller.json")
    expected = act(controller)
    assert expected.std() > 1e-3
    np.testing.assert_array_equal(act(load(tmp_path)), expected)
    np.testing.assert_array_equal(act(load(str(tmp_path / "controller.json"))), expected)


def test_ends_of_inputs_are_kept_and_a_file_that_has_none_has_the_actuators(tmp_path):
    controller = pendulum_controller()
    controller.setup = replace(controller.setup, task=controller.setup.task.with_input_limits([[-0.25], [0.5]]))
    save(controller, tmp_path / "c.json")
    assert load(tmp_path / "c.json").setup.task.input_limits.tolist() == [[-0.25], [0.5]]
    assert "sets u in [-0.25, 0.5]" in repr(load(tmp_path / "c.json"))
    record = json.loads((tmp_path / "c.json").read_text())
    del record["task"]["input_limits"]
    (tmp_path / "c.json").write_text(json.dumps(record))
    assert load(tmp_path / "c.json").setup.task.input_limits.tolist() == [[-1.0], [1.0]]


def test_a_one_sided_actuator_rests_at_its_zero_and_an_earlier_file_at_the_middle_that_it_meant(tmp_path):
    """A motor of 0 to 12 V: 0 V was -1 and 6 V was 0, as no file said anything of limits; now 0 V is 0."""
    heated = replace(PENDULUM, input_ends=((-12, 12),), input_limits=((0, 1),), input_units=("V",))
    controller = pendulum_controller(observer=False)
    controller.network.layers()[-1].bias.sub_(0.17)  # about zero
    free = acts_seeing_all(controller)
    assert free.min() < -1e-3 and free.max() > 1e-3
    free_task, inputs = controller.setup.task, torch.tensor(heated.input_limits).mT
    task = pendulum_controller(observer=False, signature=heated).setup.task
    assert torch.equal(task.input_limits, inputs) and not free_task.limited
    controller.setup = replace(controller.setup, task=task)
    save(controller, tmp_path / "c.json")
    assert acts_seeing_all(load(tmp_path / "c.json")) == pytest.approx(free.clip(0.0, 1.0))
    assert load(tmp_path / "c.json").signature.own_inputs() == [
        "the plant's u is 12 V times the controller's, which is in [0, 1]"
    ]
    record = json.loads((tmp_path / "c.json").read_text())
    del record["task"]["input_limits"], record["signature"]["input_limits"], record["signature"]["input_units"]
    record["signature"]["input_ends"] = [[0, 12]]
    (tmp_path / "c.json").write_text(json.dumps(record))
    earlier = load(tmp_path / "c.json")
    assert acts_seeing_all(earlier) == pytest.approx(free)
    assert earlier.signature.own_inputs() == ["the plant's u is 6 + 6 times the controller's, which is in [-1, 1]"]
    assert earlier.signature.in_own_units([[-1.0], [0.0], [1.0]]).flatten().tolist() == [0.0, 6.0, 12.0]


def damaged(tmp_path, change):
    save(pendulum_controller(), tmp_path / "c.json")
    record = json.loads((tmp_path / "c.json").read_text())
    change(record)
    (tmp_path / "c.json").write_text(json.dumps(record))
    return tmp_path / "c.json"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.update(format="other"), "format"),
        (lambda r: r.pop("policy"), "it lacks 'policy'"),
        (lambda r: r["task"].update(dt=-1), "positive"),
        (lambda r: r["task"].update(outputs=["phi"]), "phi"),
        (lambda r: r["policy"][0].update(weight="AAAAAA=="), "1 weights"),
        (lambda r: r["policy"][0].update(weight="!!!" + r["policy"][0]["weight"]), "damaged"),
        (lambda r: r["policy"][0].update(out=10**9), "4000000000"),
        (lambda r: r["policy"].pop(), "4 inputs"),
        (lambda r: r["observer"]["model"].update(format="x"), "format"),
        (lambda r: r["observer"]["model"]["signature"].update(state_units=["m", "m/s"]), "other states"),
        (lambda r: r["observer"]["state"].update(process_noise=[1.0]), "process noise"),
        (lambda r: r["observer"]["sensors"].update(lost=2), "lost=2"),
        (lambda r: r["task"]["stops"].update(low=[5.0]), "low < high"),
        (lambda r: r["task"]["stops"].update(positions=[-1]), "state '-1'"),
        (lambda r: r["task"].update(substeps=1001), "1 to 1000"),
        (lambda r: r["task"].update(box=[1.0, 1.0]), "theta"),
        (lambda r: r.update(integral={"gain": math.nan}), "'nan'"),
        (lambda r: r["observer"]["model"].update(delay=0.5), r"0\.5 s.*0\.4 s"),
    ],
)
def test_a_damaged_file_costs_one_line(tmp_path, change, words):
    file = damaged(tmp_path, change)
    with pytest.raises(ValueError, match=words) as caught:
        load(file)
    assert "c.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_controller_says_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="ended"):
        load(tmp_path)


def test_steps_and_stops_are_kept_without_an_observer_and_with_one_open_end(tmp_path):
    controller, stops = pendulum_controller(observer=False), Stops((0,), (1,), (-math.inf,), (0.6,))
    controller.setup = replace(controller.setup, stops=stops)
    save(controller, tmp_path / "c.json")
    record = json.loads((tmp_path / "c.json").read_text())
    assert record["task"]["stops"]["low"] == [None]
    setup = load(tmp_path / "c.json").setup
    assert (setup.substeps, setup.stops) == (3, stops)


def test_targets_and_starts_of_the_plan_are_kept_and_a_file_that_has_none_is_read(tmp_path):
    controller, path = pendulum_controller(), tmp_path / "controller.json"
    ends = controller.setup.task.start  # its own tensor
    ends[:, 0] = torch.tensor([0.25, 0.75])
    save(controller, path)
    assert load(path).setup.task.ends == ((-0.4,), (1.0,))
    assert torch.equal(load(path).setup.task.start_ends, ends)
    record = json.loads(path.read_text())
    del record["task"]["targets"], record["task"]["start"]
    path.write_text(json.dumps(record))
    old = load(path)
    assert old.setup.task.ends is None and not old.setup.task.start_ends.any() and old.targets_in_words() == []
    np.testing.assert_array_equal(acts(old), acts(controller))
    record["task"]["targets"] = [[None], [1.0]]
    path.write_text(json.dumps(record))
    with pytest.raises(DamagedFileError, match="belongs"):
        load(path)
