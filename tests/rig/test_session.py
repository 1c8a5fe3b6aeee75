"""An afternoon with a simulated rig: from nothing to a controller that holds it."""

import csv
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from dynasindy import Controller, load
from dynasindy.agents.networks import actor
from dynasindy.control.controller import Pace
from dynasindy.excitation import Multisine
from dynasindy.rig import Guard, UdpRig, Wiring
from dynasindy.rig.session import Knowledge, Session, targets_within
from dynasindy.rig.simulated import SimulatedRig
from dynasindy.sensing import Sensors
from dynasindy.systems import Pendulum
from dynasindy.tasks import RandomStep, Tracking, TrackingReward
from dynasindy.world_models import SindyModel

COUNT = 2 * np.pi / 4096
KNOWLEDGE = Knowledge(
    ["1", "u", "theta", "Omega", "sin(theta)"],
    {"theta": "Omega"},
    {"theta": (-0.6, 0.6)},
    longest_delay=0.0,
    planning={"updates": 60, "rollouts": 32, "window": 30},
)


@pytest.fixture
def session(tmp_path):
    server = SimulatedRig(Pendulum(), 0.05, Sensors({"theta": {"resolution": COUNT}}), lockstep=10.0)
    thread = threading.Thread(target=partial(server.serve, 10_000), daemon=True)
    thread.start()
    rig = UdpRig(2, 1, port=server.port)
    wiring = Wiring(Pendulum().signature, (True, False), 0.05)
    session = Session(rig, wiring, Guard(late=100.0), tmp_path, tell=lambda line: None)
    session.server = server
    yield session
    rig.close()


@pytest.mark.slow
def test_from_nothing_to_a_controller_that_holds_the_rig(session):
    session.excite(Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0))
    controller = session.learn(KNOWLEDGE)
    model = SindyModel.load(session.folder / "model.json")
    torch.testing.assert_close(
        model.coefficients[model.library.index("sin(theta)"), 1], torch.tensor(-9.81).double(), rtol=0.05, atol=0
    )
    session.fly(controller, [[0.4], [-0.2]], 6.0)
    assert not session.failed
    states = np.array(session.server.record.states)[-240:, 0]
    assert np.abs(states[80:118] - 0.4).max() < 0.03
    assert np.abs(states[200:] + 0.2).max() < 0.03
    rows = len(session._source(True).training)
    assert rows == 159 + 239  # both logs, a transition less than samples each
    assert load(session.folder).outputs == ("theta",)


def test_a_controller_of_another_plant_is_refused_before_anything_moves(session):
    signature = session.wiring.signature
    task = Tracking(signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    policy = actor(task.n_o, 1, (4,))
    with pytest.raises(ValueError, match=r"a period of 0\.02 s, the rig 0\.05 s"):
        session.fly(Controller(policy, Pace(task, 0.02)), [[0.1]], 1.0)
    with pytest.raises(ValueError, match="reads Omega, which the rig does not measure"):
        session.fly(Controller(policy, Pace(task, 0.05)), [[0.1]], 1.0)
    session.wiring = replace(session.wiring, signature=replace(signature, input_names=("torque",)))
    with pytest.raises(ValueError, match="the rig has theta, Omega and torque"):
        session.fly(Controller(policy, Pace(task, 0.05)), [[0.1]], 1.0)
    assert session.flights == []


@pytest.mark.parametrize(("ends", "lines"), [((), 0), (((0.0, 12.0),), 1)])
def test_units_of_inputs_are_told_before_a_flight(session, ends, lines):
    """Of 0 to 12 V, zero is 6 V."""
    told = []
    session.tell, session.wiring = told.append, replace(session.wiring, seen=(True, True))
    signature = replace(session.wiring.signature, input_ends=ends)
    task = Tracking(signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    session.fly(Controller(actor(task.n_o, 1, (4,)), Pace(task, 0.05)), [[0.1]], 0.1)
    begun = told.index("flight 0: 0.1 s")
    assert begun == lines and all("u is 6 + 6 times the controller's" in line for line in told[:begun])


def test_a_fault_is_kept_and_told(session):
    told = []
    session.tell, session.guard = told.append, Guard(low={"theta": -1.0}, high={"theta": 0.05}, late=100.0)
    session.excite(Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0))
    assert session.failed
    assert "ended by range: theta is" in told[-1]
    with (session.folder / "excitation.csv").open() as file:
        rows = list(csv.reader(file))[1:]
    assert max(float(row[1]) for row in rows) <= 0.05


def test_delays_of_a_rig_are_looked_for_as_far_as_in_training():
    config = OmegaConf.load(Path(__file__).parents[2] / "conf" / "world_model" / "sindy.yaml")
    assert Knowledge(["u"], {}, {}).longest_delay == config.refinement.longest_delay


def test_targets_lie_in_the_box_of_the_plant():
    assert targets_within(KNOWLEDGE, [[0.6], [-0.1]]) == [[0.6], [-0.1]]
    wide = replace(KNOWLEDGE, targets={"theta": (-0.2, 0.6)})
    assert targets_within(wide, None) == [pytest.approx([0.4]), pytest.approx([0.0])]
    for wrong in ([[0.7]], [[0.1, 0.2]], [[]]):
        with pytest.raises(ValueError, match=r"within plant\.low=\[-0\.6\] and plant\.high=\[0\.6\]"):
            targets_within(KNOWLEDGE, wrong)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"library": ["1", "sinh(theta)"]}, "function 'sinh' is not known"),
        ({"library": ["1", "thta", "Omega"]}, "plant.library names thta, which is no state and no input"),
        ({"known": {"thta": "Omega"}}, "names thta, which is no state"),
        ({"targets": {"thta": (-0.6, 0.6)}}, "state 'thta' does not exist"),
    ],
)
def test_what_no_model_can_be_made_of_is_refused_before_anything_moves(change, message):
    KNOWLEDGE.require_of(Pendulum().signature)
    with pytest.raises(ValueError, match=message):
        replace(KNOWLEDGE, **change).require_of(Pendulum().signature)
