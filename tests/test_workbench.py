"""From a log to a controller in three calls, tried on the plant that the log is of."""

import copy
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

import dynasindy
from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup
from dynasindy.data.recording import Recording
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Channel, ControlEnv, Multisine, RandomStep, Sensors, Step, Tracking, TrackingReward
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.findings import FindingError, wrong
from dynasindy.identification.source import Source
from dynasindy.progress import listening
from dynasindy.sindy import SindyModel
from dynasindy.sindy.shooting import STABLE
from dynasindy.systems import Pendulum, Signature
from dynasindy.workbench import forecast, refit_shortage

COUNT = 2 * math.pi / 4096
WORDS = ["1", "u", "theta", "Omega", "sin(theta)", "Omega^2"]


@pytest.fixture(scope="module")
def path(tmp_path_factory, write_log):
    """Write a log of the pendulum, whose angle is read by an encoder and whose rate by nobody."""
    data = record_plant(Pendulum(), Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    file = tmp_path_factory.mktemp("log") / "log.csv"
    return write_log(file, ["theta [rad]", "u"], (data.x[:, :1] / COUNT).round() * COUNT, data.u)


@pytest.fixture(scope="module")
def log(path):
    return dynasindy.read(path, {"theta": {"name": "theta", "unit": "rad"}, "Omega": {"unit": "rad/s"}})


@pytest.fixture(scope="module")
def model(log):
    return dynasindy.identify(log, WORDS, {"theta": "Omega"}, "trajectory", longest_delay=0.0)


def test_a_model_out_of_its_file_gets_the_same_verdict(log, model, tmp_path):
    """The forecast fits it to parts of the log again, by the settings that it was fitted with."""
    model.save(tmp_path / "model.json")
    models = model, SindyModel.load(tmp_path / "model.json")
    first, second = (forecast(proportional(model), each, log, STILL) for each in models)
    assert len(first.flights) == 3 and first.flights[0] != first.flights[1]  # by what each part of the log says
    assert second.record() == first.record()


def test_what_is_under_way_is_told_and_nothing_is_printed_and_one_thread_computes(exact, capfd):
    heard, threads = [], set()
    torch.set_num_threads(2)
    with listening(lambda event: (heard.append(event.phase), threads.add(torch.get_num_threads()))):
        found = dynasindy.identify(exact, WORDS, {"theta": "Omega"}, "one_step")
        dynasindy.plan(found, {"theta": (-0.6, 0.6)}, exact, **SHORT)
    phases, parts = list(dict.fromkeys(heard)), [f"fit to part {k} of 2 of the log" for k in (1, 2)]
    assert phases[:3] == ["fit", *parts] and "planning" in phases and capfd.readouterr() == ("", "")
    assert (threads, torch.get_num_threads()) == ({1}, 2)
    torch.set_num_threads(1)


def test_without_a_log_all_states_are_to_be_measured_and_a_task_of_ones_own_is_taken_as_it_is(model):
    own = Tracking(model.signature, RandomStep([0.0], [0.2]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    controller = dynasindy.plan(model, own, **SHORT)
    assert controller.observer is None and controller.dt == 0.05 and controller.setup.task is own
    with pytest.raises(ValueError, match="Omega is nan"):
        controller.act({"theta": 0.1}, [0.3])


def test_an_output_that_no_input_moves_is_refused(model):
    """The pendulum's equations without their input swing on, whatever is commanded."""
    still = copy.deepcopy(model)
    still.coefficients[model.library.names.index("u")] = 0.0
    with pytest.raises(FindingError) as error:
        dynasindy.plan(still, {"theta": (-0.5, 0.5)})
    assert error.value.finding == wrong("model.uncontrolled", outputs=["theta"])


SHORT = {"updates": 1, "rollouts": 4, "window": 5}
STILL, BRIEF = (Scenario("step", Step([[0.2]]), seconds=seconds) for seconds in (30.0, 2.0))


@pytest.fixture(scope="module")
def exact():
    """Return a log at 50 Hz without noise."""
    u = Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0).samples(0.02)
    return Source.of(Recording(record_plant(Pendulum(), u, 0.02), Pendulum().signature))


def brief(samples, kept=0.25):
    """Return a log of so many samples without noise, of which a share is kept for the forecast."""
    u = Multisine(1, duration=samples / 50, dt=0.05, amplitude=[0.8], seed=0).samples(0.02)
    return Source.of(Recording(record_plant(Pendulum(), u, 0.02), Pendulum().signature), kept)


def test_where_equations_explode_at_targets_far_beyond_the_log_these_are_told(exact):
    wild = dynasindy.identify(exact, [*WORDS, "theta^3"], {"theta": "Omega"}, "one_step")
    wild.coefficients[wild.library.names.index("theta^3"), 1] = 5000.0
    with pytest.raises(FindingError) as error:
        dynasindy.plan(wild, {"theta": (-1000, 1000)}, exact, **SHORT)
    told = error.value.finding
    assert (told.code, told.values["high"]) == ("forecast.beyond_log", 1000) and told.values["most"] < 4


@pytest.fixture(scope="module")
def late(exact):
    """Return a model, identified without noise, whose inputs act two control periods late."""
    model = dynasindy.identify(exact, WORDS, {"theta": "Omega"}, "one_step")
    model.delay = 0.08
    return model


def test_the_control_period_is_the_nearest_multiple_of_the_logs(exact):
    """0.04 s and 0.06 s are as near to 0.05 s; of two the shorter is taken."""
    model = dynasindy.identify(exact, WORDS, method="one_step")
    controller = dynasindy.plan(model, {"theta": (-0.6, 0.6)}, exact, **SHORT)
    assert controller.dt == pytest.approx(0.04)


def test_an_observer_makes_up_for_a_delay(exact, late):
    """What is shown is the state two periods on: that of the plant, if the inputs are those commanded."""
    controller = dynasindy.plan(late, {"theta": (-0.6, 0.6)}, exact, **SHORT)
    assert list(controller.observer.sensors.channels) == ["theta", "Omega"]
    plant, x = ControlEnv(Pendulum(), controller.setup.task, 0.04, dtype=torch.float64), torch.zeros(2).double()
    waiting, shown, policy = [torch.zeros(1).double()] * 2, [], controller.policy
    shows = lambda seen: (shown.append(seen["state"]), policy(seen))[1]  # noqa: E731
    controller = Controller(shows, controller.setup, controller.observer, controller.integral)
    for _ in range(40):
        waiting.append(torch.from_numpy(controller.act(x.tolist(), [0.4])))
        ahead = x
        for u in waiting[:2]:
            ahead = plant.advance(ahead, u)[0][-1]
        x = plant.advance(x, waiting.pop(0))[0][-1]
        np.testing.assert_allclose(shown[-1].numpy(), ahead.numpy(), atol=1e-3)


def held_with(integral, model):
    """Return where the pendulum rests that is driven by a constant input for 0.19 rad, though 0.2 rad are asked for."""
    return forecast(proportional(model, integral), model, None, STILL)


def proportional(model, integral=None):
    """Return a proportional controller of the pendulum."""

    def policy(tensordict):
        error = tensordict["observation"][..., task.error_columns] * task.error_scale
        rate = tensordict["state"][..., 1:].float()
        return tensordict.set("action", 0.5 * error * 1.2 - 0.2 * rate)

    task = dynasindy.workbench.tracking_task(model, {"theta": (-0.6, 0.6)})
    return Controller(policy, ControlSetup(task, 0.05), integral=integral)


def test_the_prediction_has_the_controllers_integral_action(model):
    """A proportional controller leaves an error, its integral none."""
    without, shown = (held_with(integral, model) for integral in (None, {"band": 1.0, "limit": 5.0}))
    assert without.flights[0].share["theta"] > 0.03
    assert shown.flights[0].share["theta"] < 0.003
    assert shown.controlled
    assert not without.controlled


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_models_are_flown_under_the_pushes_of_the_log(size, write_log, tmp_path):
    """A cart v' = 10 u - 10 v + 5 w with pushes of 0.06 s, sampled with noise, whose input is left at zero.

    Its speed then varies by w alone, as that of a plant does that is simulated beside it.
    """
    rng, h, x, w, rows, far = np.random.default_rng(0), 0.01, np.zeros(2), np.zeros(2), [], []
    for k in range(3000):
        if k % 12 == 0:
            u = rng.uniform(-1, 1)
        rows.append([x[0] + 0.003 * rng.standard_normal(), u])
        far.append(abs(x[1]))
        w = np.exp(-h / 0.06) * w + size * math.sqrt(1 - np.exp(-2 * h / 0.06)) * rng.standard_normal(2)
        settled = np.array([u, 0.0]) + 0.5 * w
        x = settled + np.exp(-10 * h) * (x - settled)
    rows = torch.tensor(rows)
    log = dynasindy.read(write_log(tmp_path / "log.csv", ["v [m/s]", "u"], rows[:, :1], rows[:, 1:]))
    model = dynasindy.identify(log, ["v", "u"], method="trajectory", longest_delay=0.0)
    task = dynasindy.workbench.tracking_task(model, {"v": (-0.5, 0.5)})
    setup = ControlSetup(task, h)

    def idle(tensordict):
        return tensordict.set("action", torch.zeros(*tensordict.batch_size, 1))

    scenario = Scenario("step", Step([[0.0]] * 32), episodes=32, seconds=4.0)
    observer = Observer(model, Sensors({"v": Channel(noise=0.003)}), setup)
    observer.learn(rows[:1501, :1].double(), rows[:1500, 1:].double())
    found = forecast(Controller(idle, setup, observer), model, log, scenario)
    share = [flight.share["v"] for flight in found.flights]
    assert share[0] == pytest.approx(np.mean(far), rel=0.25, abs=1e-3) and max(share) < 1.6 * np.mean(far) + 1e-3


def test_dry_friction_may_hold_a_plant_at_rest_though_its_fit_creeps(write_log, tmp_path):
    """A motor w' = 60 u - 8 w - 4 tanh(50 w): static friction of twice as much balances inputs of up to 8 / 60."""
    rng, q, w, rows = np.random.default_rng(0), 0.0, 0.0, []
    for k in range(1200):
        if k % 25 == 0:
            u = rng.uniform(-0.6, 0.6)
        rows.append([q, w, u])
        for _ in range(40):
            w += 0.00025 * (60 * u - 8 * w - 4 * math.tanh(50 * w))
            q += 0.00025 * w
    log = dynasindy.read(write_log(tmp_path / "log.csv", ["q [rad]", "w [rad/s]", "u"], torch.tensor(rows)))
    model = dynasindy.identify(log, ["u", "w", "tanh(~40 w)"], {"q": "w"}, "one_step", longest_delay=0.0)
    task = dynasindy.workbench.tracking_task(model, {"q": (-1.0, 1.0)})

    def proportional(tensordict):
        x, wanted = tensordict["state"], tensordict["reference"]
        return tensordict.set("action", (0.5 * (wanted - x[..., :1]) - 0.05 * x[..., 1:]).clamp(-1, 1).float())

    scenario = Scenario("step", Step([[-0.8], [0.5], [0.9]]), episodes=3, seconds=20.0)
    found = forecast(Controller(proportional, ControlSetup(task, 0.05)), model, log, scenario)
    band = 8 / 60 / 0.5 / 2  # of the error, in ranges of the targets
    (best, worst), (flight,) = [(0.0, math.inf), found.static_friction]
    for share, told in ((best, False), (worst, True)):
        other = replace(found, static_friction=(replace(flight, share={"q": share}),))
        assert told == ("forecast.static_friction" in {each.code for each in other.findings})
    lost = replace(found, static_friction=(None,))
    assert {each.code: each for each in lost.findings}["forecast.static_friction"].values["outputs"] == {
        "q": (None, None)
    }
    assert max(flight.worst["q"] for flight in found.flights) < 0.1 * band
    (stuck,) = (each for each in found.findings if each.code == "forecast.static_friction")
    assert 0.5 * band < stuck.values["outputs"]["q"][1] < 1.05 * band


def test_a_log_that_begins_in_motion_shows_no_push_where_none_was(write_log, tmp_path):
    """A motor with dry friction, w' = 60 u - 8 w - 4 tanh(50 w), by its encoder alone."""
    rng, q, w, rows = np.random.default_rng(0), 0.0, 7.0, []
    for k in range(1200):
        if k % 25 == 0:
            u = rng.uniform(0.6, 1.0) * (-1) ** (k // 300)
        rows.append([q, math.nan, u])
        for _ in range(40):
            w += 0.00025 * (60 * u - 8 * w - 4 * math.tanh(50 * w))
            q += 0.00025 * w
    rows = torch.tensor(rows, dtype=torch.float64)
    rows[:, 0] += 1e-3 * torch.from_numpy(rng.standard_normal(len(rows)))
    log = dynasindy.read(write_log(tmp_path / "log.csv", ["q [rad]", "u"], rows[:, ::2]))
    signature = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 7.0))
    model = SindyModel(signature, ["u", "w", "tanh(50 w)"], known={"q": "w"})
    model.set_coefficients(torch.tensor([[0.0, 60.0], [1.0, -8.0], [0.0, -4.0]], dtype=torch.float64))
    task = dynasindy.workbench.tracking_task(model, {"q": (-1.0, 1.0)})

    def proportional(tensordict):
        x, wanted = tensordict["state"], tensordict["reference"]
        return tensordict.set("action", (0.5 * (wanted - x[..., :1]) - 0.05 * x[..., 1:]).clamp(-1, 1).float())

    setup = ControlSetup(task, 0.05)
    observer = Observer(model, Sensors({"q": Channel(noise=1e-3)}, rates={"q": "w"}), setup)
    observer.learn(rows[:1201:5, :2], rows[:-5:5, 2:])
    scenario = Scenario("step", Step([[-0.8], [0.5], [0.9]]), episodes=3, seconds=20.0)
    found = forecast(Controller(proportional, setup, observer), model, log, scenario)
    assert max(flight.worst["q"] for flight in found.flights) < 0.03


def test_nothing_is_promised_by_a_log_of_which_nothing_was_kept(exact):
    alone = Source.of(Recording(exact.whole, exact.signature), 0)
    model = dynasindy.identify(alone, WORDS, {"theta": "Omega"}, "one_step")
    controller = dynasindy.plan(model, {"theta": (-0.6, 0.6)}, alone, **SHORT)
    found = forecast(controller, model, alone)
    assert found.in_sample and not found.promised
    assert found.evaluation.trajectory.batch_size[0] == 64  # steps over the range of the targets


def test_nothing_is_promised_where_what_the_log_keeps_is_shorter_than_the_equations():
    log = brief(250, 0.02)
    model = dynasindy.identify(log, WORDS, {"theta": "Omega"}, "one_step")
    shortage = refit_shortage(model, log)  # known before the plan
    assert shortage.values["samples"] == len(log.validation) // 2 < shortage.values["functions"]
    controller = dynasindy.plan(model, {"theta": (-0.6, 0.6)}, log, **SHORT)
    found = forecast(controller, model, log, BRIEF)
    assert shortage in found.findings and not found.promised and found.evaluation is not None
    assert refit_shortage(model, None) is None


def test_a_controller_stays_where_the_log_has_tried_its_input_if_the_equations_bend_in_it(exact):
    """On a log of inputs from -0.8 to 0.8 of a pendulum whose torque is 12 u, and then has a trace of u^2."""
    straight = dynasindy.identify(exact, [*WORDS, "u^2"], {"theta": "Omega"}, "one_step")
    assert not dynasindy.plan(straight, {"theta": (-0.6, 0.6)}, exact, **SHORT).setup.task.limited
    bent = copy.deepcopy(straight)
    bent.coefficients[bent.library.index("u^2"), 1] = 1e-6
    controller = dynasindy.plan(bent, {"theta": (-0.6, 0.6)}, exact, **SHORT)
    u = exact.training.u
    room = 0.05 * float(u.max() - u.min())
    wanted = [float(u.min()) - room, float(u.max()) + room]
    assert controller.setup.task.input_limits.flatten().tolist() == pytest.approx(wanted)
    assert max(abs(end) for end in wanted) < 0.95
    acts = [float(controller.act([0.1, 0.0], [target])[0]) for target in (-50.0, 50.0)]
    assert wanted[0] - 1e-6 <= min(acts) and max(acts) <= wanted[1] + 1e-6

    def full(tensordict):
        return tensordict.set("action", torch.ones_like(tensordict["state"][..., :1]).float())

    limited = forecast(Controller(full, controller.setup), bent, exact, BRIEF)
    assert limited.evaluation.inputs.unique().tolist() == pytest.approx([wanted[1]]) and limited.doubts == ()
    free = replace(controller.setup, task=controller.setup.task.with_input_limits([[-1.0], [1.0]]))
    (said,) = forecast(Controller(full, free), bent, exact, BRIEF).doubts
    assert (said.code, said.severity) == ("forecast.beyond_inputs", "wrong")
    ends = [said.values[name] for name in ("low", "high", "least", "most")]
    assert said.values["input"] == "u" and ends == pytest.approx([1, 1, *wanted])


def test_volts_stay_volts_from_a_log_without_rates_to_a_controller(tmp_path, write_log):
    """6 V rest, and 6 V more turn the pendulum with 12 rad/s^2, which is what 1 does in [-1, 1]."""
    data = record_plant(Pendulum(), Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    path = write_log(tmp_path / "log.csv", ["angle [rad]", "motor [V]"], data.x[:, :1], 6 + 6 * data.u)
    log = dynasindy.read(path, inputs={"motor": {"name": "motor", "unit": "V", "low": 0, "high": 12, "rest": 6}})
    words = ["1", "motor", "angle", "angle_rate", "sin(angle)"]
    model = dynasindy.identify(log, words, {"angle": "angle_rate"}, "trajectory", longest_delay=0.0)
    assert float(model.coefficients[model.library.names.index("motor"), 1]) == pytest.approx(12.0, rel=0.02)
    controller = dynasindy.plan(model, {"angle": (-0.5, 0.5)}, log, **SHORT)
    assert model.signature.input_ends == controller.signature.input_ends == ((0.0, 12.0),)
    alone = dynasindy.read(path, inputs=["motor"])
    (ends,) = [each.values["inputs"] for each in alone.findings if each.code == "log.guessed_ends"]
    assert f"read(inputs={ends})" in repr(alone)
    again = dynasindy.read(path, inputs=ends)
    assert again.signature.input_ends[0] == pytest.approx(alone.signature.input_ends[0], rel=1e-5)


def test_targets_that_no_input_holds_are_told(model):
    """A motor of 4 rad/s^2 holds the pendulum up to asin(4 / 9.81) = 0.42 rad; 0.6 rad take 9.81 sin(0.6) / 4 of it."""
    feeble = copy.deepcopy(model)
    drive = feeble.coefficients[model.library.names.index("u")]
    drive[drive != 0] = 4.0
    (told,) = (each for each in held_with(None, feeble).findings if each.code != "forecast.tracked")
    assert (told.code, told.severity) == ("forecast.no_equilibrium", "wrong")
    span = re.search(r"theta from (\S+) to ([\d.]+)", told.values["targets"])
    assert -float(span[1]) == pytest.approx(math.asin(4 / 9.81), abs=0.03) and float(span[2]) < 0.45


def angle_alone(source):
    """Return the pendulum's angle without its rate."""
    t = source.training
    signature = Signature(("theta",), ("rad",), ("u",), (1.0,))
    return Source.of(Recording(replace(t, x=t.x[:, :1], x_next=t.x_next[:, :1]), signature))


@pytest.mark.parametrize("library", [(), (["u", "theta", "theta_rate", "sin(theta)"],)], ids=["found", "named"])
def test_a_rate_that_a_log_lacks_is_added_and_estimated(exact, library):
    """theta'' = 12 u - 9.81 sin(theta) - 0.5 theta', as the pendulum's constants say, out of theta alone."""
    model = dynasindy.identify(angle_alone(exact), *library)
    assert model.signature.state_names == ("theta", "theta_rate")
    theta, rate, u = (exact.training.x[:, 0], exact.training.x[:, 1], exact.training.u[:, 0])
    with torch.no_grad():
        found = model(exact.training.x, exact.training.u)
    wanted = torch.stack([rate, 12 * u - 9.81 * theta.sin() - 0.5 * rate], 1)
    torch.testing.assert_close(found, wanted.double(), rtol=0, atol=1e-4)  # rad/s and rad/s^2, of 2 and 7


def test_a_motion_that_is_fast_against_the_period_is_flown_in_steps_that_are_stable():
    """A lag of 2 ms, as that of a current, under a period of 0.05 s."""
    plant = Signature(("v", "i"), ("m/s", "A"), ("u",), (1.0, 1.0))
    model = SindyModel(plant, ["v", "i", "u"])
    model.coefficients = torch.tensor([[-1.0, 0.0], [1.0, -500.0], [0.0, 500.0]]).double()
    period = 0.05
    steps = model.substeps(period, STABLE)
    assert 500 * period / steps <= STABLE and model.substeps(0.001, STABLE) == 1
    controller = dynasindy.plan(model, {"v": (-0.5, 0.5)}, dt=period, updates=2)
    assert controller.setup.substeps == steps
    assert math.isfinite(float(abs(dynasindy.simulate(controller, model, {"v": 0.2}).states).max()))


@pytest.mark.parametrize(
    "call",
    [
        lambda log, model: dynasindy.read(None),
        lambda log, model: dynasindy.identify("log.csv"),
        lambda log, model: dynasindy.identify(log, known={"theta": 5}),
        lambda log, model: dynasindy.plan(model, {"theta": 0.4}),  # task.theta, and nothing of pydantic's
        lambda log, model: dynasindy.simulate(model, log, {"theta": 0.4}),
    ],
)
def test_arguments_of_other_kinds_are_refused_by_their_names(call):
    log = dynasindy.excite(Pendulum(), duration=2.0)
    model = SindyModel(log.signature, "polynomial")
    with pytest.raises(ValueError, match=r"^\w+ has [a-z.]+=.*$"):
        call(log, model)
