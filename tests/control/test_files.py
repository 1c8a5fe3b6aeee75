"""A controller out of its file acts as the one that was saved, and a damaged file costs one line."""

import json
import math

import numpy as np
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, load, save
from dynasindy.control.controller import Pace
from dynasindy.sensing import Observer, Sensors
from dynasindy.systems import Signature, Stops
from dynasindy.tasks import Step, Tracking, TrackingReward
from dynasindy.world_models import Oracle, SindyModel

SIGNATURE = Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.5, 3.0))


def built(observer=True, integral=None, delay=0.07, stops=None):
    """Return a controller with numbers that are no defaults."""
    task = Tracking(
        SIGNATURE,
        Step([[0.0]]),
        ("theta",),
        ("Omega",),
        TrackingReward((1.0,)),
        observe_rate=True,
        error_scale=0.7,
        low=[-0.5],
        high=[1.3],
    )
    pace = Pace(task, 0.04, 3, stops or Stops((0,), (1,), (-0.6,), (0.6,)))
    with torch.random.fork_rng():
        torch.manual_seed(1)
        policy = actor(task.n_o, 1, (8, 5)).requires_grad_(False)
    if not observer:
        return Controller(policy, pace, None, integral)
    model = SindyModel(SIGNATURE, ["u", "Omega", "tanh(~4 theta)"], known={"theta": "Omega"})
    model.library = model.library.with_shapes([3.7])
    model.set_coefficients(torch.tensor([[0.0, 8.0], [1.0, -0.6], [0.0, -9.5]], dtype=torch.float64))
    model.delay = delay
    sensors = Sensors(
        {"theta": {"resolution": 0.01, "noise": 0.002}}, rates={"theta": "Omega"}, delay=1, disturbance=True
    )
    watching = Observer(model, sensors, pace)
    watching.load_state_dict({"process_noise": [0.013, 0.021, 0.4], "nis": 1.1})
    return Controller(policy, pace, watching, integral)


def acts(controller):
    controller.reset()
    return np.array([controller.act([0.09 * math.sin(k), math.nan], [0.3], [0.1 * k]) for k in range(30)])


def acts_seeing_all(controller):
    controller.reset()
    return np.array([controller.act([0.3 * math.sin(k), 0.1 * k], [0.3], [0.1 * k]) for k in range(30)])


@pytest.mark.parametrize("integral", [None, {}, {"gain": 3.0, "band": 0.9}])
def test_what_is_loaded_acts_as_what_was_saved(tmp_path, integral):
    controller = built(integral=integral)
    save(controller, tmp_path / "controller.json")
    expected = acts(controller)
    assert expected.std() > 1e-3
    np.testing.assert_array_equal(acts(load(tmp_path)), expected)
    np.testing.assert_array_equal(acts(load(str(tmp_path / "controller.json"))), expected)


def test_without_an_observer_too(tmp_path):
    controller = built(observer=False, integral={"limit": 0.1})
    save(controller, tmp_path / "controller.json")
    expected = acts_seeing_all(controller)
    assert expected.std() > 1e-3
    np.testing.assert_array_equal(acts_seeing_all(load(tmp_path)), expected)


def test_the_file_tells_names_units_and_period_to_a_reader(tmp_path):
    save(built(), tmp_path / "c.json")
    record = json.loads((tmp_path / "c.json").read_text())
    assert record["signature"]["state_units"] == ["rad", "rad/s"]
    assert record["task"] == {
        "dt": 0.04,
        "outputs": ["theta"],
        "rates": ["Omega"],
        "observe_rate": True,
        "error_scale": 0.7,
        "box": [pytest.approx(1.8)],
    }
    assert record["observer"]["model"]["delay"] == 0.07
    assert record["observer"]["stops"]["low"] == [-0.6]
    assert record["integral"] is None


def damaged(tmp_path, change):
    save(built(), tmp_path / "c.json")
    record = json.loads((tmp_path / "c.json").read_text())
    change(record)
    (tmp_path / "c.json").write_text(json.dumps(record))
    return tmp_path / "c.json"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.update(format="other"), "is not of the format"),
        (lambda r: r.pop("policy"), "it lacks 'policy'"),
        (lambda r: r["task"].update(dt=-1), "a positive number belongs"),
        (lambda r: r["task"].update(box=[0.0]), "a positive number belongs"),
        (lambda r: r["task"].update(outputs=["phi"]), "state 'phi' does not exist"),
        (lambda r: r["policy"][0].update(weight="AAAA"), "0 weights where 32 finite ones belong"),
        (lambda r: r["policy"][0].update(weight="AAAAAA=="), "1 weights where 32 finite ones belong"),
        (lambda r: r["policy"][1].update(bias="§"), "is damaged"),
        (lambda r: r["policy"][0].update(out=10**9), "at most 20 of 1 to 4096"),
        (lambda r: r["policy"].pop(), "maps 4 numbers to 5"),
        (lambda r: r["observer"]["model"].update(format="x"), "is not of the format"),
        (lambda r: r["observer"]["model"]["signature"].update(x_scale=[1.0, 1.0]), "other states than the controller"),
        (lambda r: r["observer"]["state"].update(process_noise=[1.0]), "process noise"),
        (lambda r: r["observer"]["sensors"].update(lost=2), "probability"),
        (lambda r: r["observer"]["stops"].update(low=[5.0]), "stops need low < high"),
    ],
)
def test_a_damaged_file_costs_one_line(tmp_path, change, words):
    file = damaged(tmp_path, change)
    with pytest.raises(ValueError, match=words) as caught:
        load(file)
    assert "c.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_controller_says_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="the folder of a run that has ended"):
        load(tmp_path)


def test_a_policy_of_another_kind_is_refused(tmp_path):
    controller = built(observer=False)
    controller.policy = lambda tensordict: tensordict
    with pytest.raises(ValueError, match="which no file holds; allowed is the actor"):
        save(controller, tmp_path / "c.json")
    assert not list(tmp_path.iterdir())


def test_an_observer_on_another_kind_of_model_is_refused(tmp_path):
    controller = built()
    controller.observer.model = Oracle(SIGNATURE, system=controller.observer.model)
    with pytest.raises(ValueError, match="works on a Oracle, which no file holds"):
        save(controller, tmp_path / "c.json")
