"""A controller flies a plant exactly as the evaluation of its policy does, and refuses what is no measurement."""

import copy
import math
import pickle
import warnings

import numpy as np
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup, IntegralAction
from dynasindy.control.sensing import Sensing
from dynasindy.envs import ControlEnv, Sensors, Step, Tracking, TrackingReward, Wave
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum, Signature, System

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
    plant = Pendulum()
    task = Tracking(
        plant.signature,
        reference or Step([[0.3]]),
        ("theta",),
        ("Omega",),
        TrackingReward((4.0,)),
        observe_rate=observe_rate,
        low=[-0.2],
        high=[0.6],
    )
    with torch.random.fork_rng():
        torch.manual_seed(3)
        policy = actor(task.n_o, 1, (16, 16)).requires_grad_(False)
    return ControlEnv(plant, task, dtype=torch.float64), policy


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


class Driven(System):
    """A place that two inputs move, x' = u1 + 10 u2."""

    def __init__(self):
        super().__init__(Signature(("x",), ("m",), ("u1", "u2"), (1.0,)))

    def forward(self, x, u):
        return u[..., :1] + 10 * u[..., 1:]


def constant():
    """Return a controller of that place whose action is constant."""
    plant = Driven()
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
    sensing = Sensing(env, observer, torch.Generator().manual_seed(0))
    wrapped = policy if integral is None else IntegralAction(policy, env, **integral)
    expected = evaluate(env, wrapped, Scenario("step", seconds=4.0), sensing).trajectory[0]
    controller = Controller(policy, ControlSetup(env.task, env.dt, env.substeps), observer, integral)
    measured = expected["measurement"].numpy()
    assert np.isnan(measured[:, 1]).all()
    _, inputs = flown(controller, env, [[0.3]] * 80, measured=measured)
    np.testing.assert_allclose(inputs, expected["action"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(controller.estimate, expected["observer", "mean"][-1, :2], rtol=0, atol=1e-6)


def test_a_reset_forgets_everything():
    env, policy = setting()
    controller = Controller(policy, ControlSetup(env.task, env.dt, env.substeps), watching(env), {"band": 0.5})
    assert controller.estimate is None
    first = [controller.act([0.1 * k, math.nan], [0.3]) for k in range(5)]
    again = [controller.act([0.1 * k, math.nan], [0.3]) for k in range(5)]
    assert not np.allclose(first, again)
    controller.reset()
    np.testing.assert_array_equal(first, [controller.act([0.1 * k, math.nan], [0.3]) for k in range(5)])


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
