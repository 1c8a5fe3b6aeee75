"""A controller out of its file acts as the one that was saved, and a damaged file costs one line."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, Observer, load, save
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.safe_io import DamagedFileError
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Stops

SIGNATURE = Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.5, 3.0))


def tracking(signature):
    """Return a task with numbers that are no defaults."""
    return Tracking(
        signature,
        Step([[0.0]]),
        ("theta",),
        ("Omega",),
        TrackingReward((1.0,)),
        observe_rate=True,
        error_scale=0.7,
        low=[-0.5],
        high=[1.3],
    )


def built(observer=True, integral=None, delay=0.07, stops=None):
    """Return a controller with numbers that are no defaults."""
    task = tracking(SIGNATURE)
    setup = ControlSetup(task, 0.04, 3, stops or Stops((0,), (1,), (-0.6,), (0.6,)))
    with torch.random.fork_rng():
        torch.manual_seed(1)
        policy = actor(task.n_o, 1, (8, 5)).requires_grad_(False)
    if not observer:
        return Controller(policy, setup, None, integral)
    model = SindyModel(SIGNATURE, ["u", "Omega", "tanh(~4 theta)"], known={"theta": "Omega"})
    model.library = model.library.with_shapes([3.7])
    model.set_coefficients(torch.tensor([[0.0, 8.0], [1.0, -0.6], [0.0, -9.5]], dtype=torch.float64))
    model.delay = delay
    sensors = Sensors(
        {"theta": {"resolution": 0.01, "noise": 0.002}}, rates={"theta": "Omega"}, delay=1, disturbance=True
    )
    watching = Observer(model, sensors, setup)
    watching.load_state_dict({"process_noise": [0.013, 0.021, 0.4], "nis": 1.1})
    return Controller(policy, setup, watching, integral)


def acts(controller):
    controller.reset()
    return np.array([controller.act([0.09 * math.sin(k), math.nan], [0.3], [0.1 * k]) for k in range(30)])


def acts_seeing_all(controller):
    controller.reset()
    return np.array([controller.act([0.3 * math.sin(k), 0.1 * k], [0.3], [0.1 * k]) for k in range(30)])


@pytest.mark.parametrize("integral", [None, {"gain": 3.0, "band": 0.9}])
def test_what_is_loaded_acts_as_what_was_saved(tmp_path, integral):
    controller = built(integral=integral)
    save(controller, tmp_path / "controller.json")
    expected = acts(controller)
    assert expected.std() > 1e-3
    np.testing.assert_array_equal(acts(load(tmp_path)), expected)
    np.testing.assert_array_equal(acts(load(str(tmp_path / "controller.json"))), expected)


def test_ends_of_inputs_are_kept_and_a_file_that_has_none_has_the_actuators(tmp_path):
    controller = built()
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
    heated = replace(SIGNATURE, input_ends=((-12, 12),), input_limits=((0, 1),), input_units=("V",))
    controller = built(observer=False)
    controller.network.layers()[-1].bias.sub_(0.17)  # about zero
    free = acts_seeing_all(controller)
    assert free.min() < -1e-3 and free.max() > 1e-3
    free_task, inputs = controller.setup.task, torch.tensor(heated.input_limits).mT
    task = tracking(heated)
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


def test_without_an_observer_too(tmp_path):
    controller = built(observer=False, integral={"limit": 0.1})
    save(controller, tmp_path / "controller.json")
    expected = acts_seeing_all(controller)
    assert expected.std() > 1e-3
    np.testing.assert_array_equal(acts_seeing_all(load(tmp_path)), expected)


def damaged(tmp_path, change):
    save(built(), tmp_path / "c.json")
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
    controller = built(observer=False, stops=Stops((0,), (1,), (-math.inf,), (0.6,)))
    save(controller, tmp_path / "c.json")
    record = json.loads((tmp_path / "c.json").read_text())
    assert record["task"]["stops"]["low"] == [None]
    setup = load(tmp_path / "c.json").setup
    assert (setup.substeps, setup.stops) == (3, Stops((0,), (1,), (-math.inf,), (0.6,)))


def test_the_targets_of_the_plan_are_kept_and_a_file_that_has_none_is_read(tmp_path):
    controller, path = built(), tmp_path / "controller.json"
    save(controller, path)
    assert load(path).setup.task.ends == ((-0.5,), (1.3,))
    record = json.loads(path.read_text())
    del record["task"]["targets"]
    path.write_text(json.dumps(record))
    old = load(path)
    assert old.setup.task.ends is None and old.targets_in_words() == []
    np.testing.assert_array_equal(acts(old), acts(controller))
    record["task"]["targets"] = [[None], [1.3]]
    path.write_text(json.dumps(record))
    with pytest.raises(DamagedFileError, match="belongs"):
        load(path)
