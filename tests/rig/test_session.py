"""An afternoon with a simulated rig: from nothing to a controller that holds it."""

import csv
import re
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
from far_end import FarEnd
from fast_clock import FastClock

from dynasindy import Controller
from dynasindy.agents.networks import actor
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Multisine, RandomStep, Sensors, Tracking, TrackingReward
from dynasindy.rig import Guard, UdpRig, Wiring
from dynasindy.rig.session import Knowledge, Session
from dynasindy.rig.simulated import SimulatedRig
from dynasindy.sindy import SindyModel
from dynasindy.systems import BlackBox, Pendulum

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
    server = FarEnd(Pendulum(), 0.05, Sensors({"theta": {"resolution": COUNT}}))
    thread = threading.Thread(target=server.serve, args=(10_000,), daemon=True)
    thread.start()
    rig = UdpRig(2, 1, port=server.port)
    wiring = Wiring(Pendulum().signature, (True, False), 0.05)
    session = Session(rig, wiring, Guard(late=100.0), tmp_path, tell=lambda line: None)
    session.server = server
    yield session
    rig.close()


def test_a_controller_of_another_plant_is_refused_before_anything_moves(session):
    signature = session.wiring.signature
    task = Tracking(signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    policy = actor(task.n_o, 1, (4,))
    with pytest.raises(ValueError, match="period"):
        session.run_flight(Controller(policy, ControlSetup(task, 0.02)), [[0.1]], 1.0)
    with pytest.raises(ValueError, match="measure"):
        session.run_flight(Controller(policy, ControlSetup(task, 0.05)), [[0.1]], 1.0)
    session.wiring = replace(session.wiring, signature=replace(signature, input_names=("torque",)))
    with pytest.raises(ValueError, match="torque"):
        session.run_flight(Controller(policy, ControlSetup(task, 0.05)), [[0.1]], 1.0)
    assert not session.flights


def test_an_excitation_beyond_an_actuator_is_refused_and_the_words_that_are_told_fit(tmp_path):
    """A pump of 0 to 12 V cannot be excited by -0.3 to 0.3 of its range."""
    session, rig = blind(tmp_path, inputs={"u": {"low": 0, "high": 12, "unit": "V"}})
    with pytest.raises(ValueError, match="reaches") as error:
        session.excite(Multisine(1, duration=2, dt=0.05, amplitude=0.4, offset=0.1, seed=0))
    assert not session.flights and rig.u.tolist() == [0.0]
    words = re.findall(r"plant\.(\w+)=\[([\d.]+)\]", str(error.value))
    told = []
    session.tell = told.append
    fits = {key: float(value) for key, value in words}
    assert fits == {"amplitude": 0.4, "offset": 0.4}
    assert session.excite(Multisine(1, duration=2, dt=0.05, seed=0, **fits)).fault is None
    assert "controller" in told[0]
    u = np.genfromtxt(tmp_path / "excitation.csv", delimiter=",", skip_header=1)[:, 2]
    assert u.min() >= 0.0 and u.max() <= 0.8 and np.ptp(u) > 0.4


def test_a_fault_is_kept_and_told(session):
    told = []
    session.tell, session.guard = told.append, Guard(low={"theta": -1.0}, high={"theta": 0.05}, late=100.0)
    session.excite(Multisine(1, duration=8, dt=0.05, amplitude=[0.8], seed=0))
    assert session.failed
    assert "ended" in told[-1]
    with (session.folder / "excitation.csv").open() as file:
        rows = list(csv.reader(file))[1:]
    assert max(float(row[1]) for row in rows) <= 0.05


def test_targets_lie_in_the_box_of_the_plant():
    assert KNOWLEDGE.within([[0.6], [-0.1]]) == [[0.6], [-0.1]]
    wide = replace(KNOWLEDGE, targets={"theta": (-0.2, 0.6)})
    assert wide.within(None) == [pytest.approx([0.4]), pytest.approx([0.0])]
    for wrong in ([[0.7]], [[0.1, 0.2]], [[]]):
        with pytest.raises(ValueError, match="within"):
            KNOWLEDGE.within(wrong)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"library": ["1", "sinh(theta)"]}, "sinh"),
        ({"targets": {"thta": (-0.6, 0.6)}}, "thta"),
        ({"planning": {"window": "long"}}, "window"),
    ],
)
def test_what_no_model_can_be_made_of_is_refused_before_anything_moves(change, message):
    KNOWLEDGE.require_of(Pendulum().signature)
    with pytest.raises(ValueError, match=message):
        replace(KNOWLEDGE, **change).require_of(Pendulum().signature)


class AngleOnly(SimulatedRig):
    """A pendulum of which the angle alone is sent, as the sample of a rig with one sensor."""

    def read(self, seconds):
        y = super().read(seconds)
        return None if y is None else y[:1]


def blind(folder, delay=0.0, unit="rad", inputs=("u",), **settings):
    """Return a session with a pendulum of which nobody knows more than a name and a unit, and its rig."""
    clock = FastClock()
    rig = AngleOnly(Pendulum(), Sensors({"theta": {"resolution": COUNT}}), clock, delay=delay)
    wiring = Wiring(BlackBox({"theta": unit}, inputs).signature, (True,), 0.05)
    return Session(rig, wiring, Guard(**settings), folder, tell=lambda line: None, clock=clock), rig


UNKNOWN = replace(KNOWLEDGE, known={"theta": "Omega"}, longest_delay=None, ranged=False)


def multisine(seconds=10.0):
    return Multisine(1, duration=seconds, dt=0.05, amplitude=[0.5], seed=0)


def test_a_rig_of_which_names_and_units_are_known_is_identified_and_held_though_its_input_is_late(tmp_path):
    """Omega' = 12 u(t - 80 ms) - 9.81 sin(theta) - 0.5 Omega, from an encoder of the angle alone."""
    session, rig = blind(tmp_path, 0.08)
    told = []
    session.tell = told.append
    UNKNOWN.require_of(session.wiring.signature)
    session.excite(multisine())
    controller = session.learn(UNKNOWN)
    model = SindyModel.load(tmp_path / "model.json")
    assert model.delay == pytest.approx(0.08, abs=0.004)
    assert any(f"{model.delay:.4g} s late" in line for line in told)
    theta, omega, u = (torch.linspace(-1, 1, 9).double() * k for k in (0.4, 1.0, 0.3))
    found = model(torch.stack([theta, omega], -1), u.unsqueeze(-1))[:, 1]
    torch.testing.assert_close(found, 12 * u - 9.81 * theta.sin() - 0.5 * omega, atol=0.15, rtol=0.02)
    session.run_flight(controller, [[0.4], [-0.2]], 6.0)
    assert not session.failed
    assert abs(float(rig.x[0]) + 0.2) < 0.02


def test_a_session_goes_on_in_its_folder_and_what_was_cut_short_is_repeated(tmp_path):
    first, _ = blind(tmp_path, high={"theta": 0.1}, low={"theta": -9.0})
    first.excite(multisine())
    assert first.failed and "theta is" in str(first.flights["excitation"].fault)
    second, _ = blind(tmp_path)
    assert second.excite(multisine()).periods == 200
    third, rig = blind(tmp_path)
    told = []
    third.tell = told.append
    assert third.excite(multisine()) is None and rig.x.tolist() == [0.0, 0.0]
    assert "excitation_1.csv" in told[0]
    task = Tracking(Pendulum().signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    wiring = replace(third.wiring, signature=Pendulum().signature, seen=(True, True))
    assert [path.name for path in third.logs("excitation")] == ["excitation.csv", "excitation_1.csv"]
    assert len(third._source(False).training) == 199  # the first one is too short to learn from
    assert "excitation.csv" in told[-1] and "left out" in told[-1]
    whole = Session(
        rig := SimulatedRig(Pendulum(), clock=third.clock), wiring, Guard(), tmp_path / "more", clock=third.clock
    )
    whole.tell = told.append
    for _ in range(2):
        whole.run_flight(Controller(actor(task.n_o, 1, (4,)), ControlSetup(task, 0.05)), [[0.1]], 0.1)
    again = replace(whole, flights={}, shown={})
    again.run_flight(Controller(actor(task.n_o, 1, (4,)), ControlSetup(task, 0.05)), [[0.1]], 0.1)
    assert [path.name for path in again.logs("flight")] == ["flight_1.csv", "flight_2.csv", "flight_3.csv"]


def test_a_rig_that_is_unplugged_leaves_its_log_and_the_next_session_excites_it_again(tmp_path):
    session, rig = blind(tmp_path)
    read = rig.read

    def unplugged(seconds):
        if rig.clock.monotonic() > 3.0:
            raise ConnectionRefusedError("nobody is there")
        return read(seconds)

    rig.read = unplugged
    flown = session.excite(multisine())
    assert flown.fault.kind == "connection" and session.failed
    rows = list(session.logs("excitation").values())
    assert rows == [flown.periods] and 59 <= flown.periods <= 61
    second, _ = blind(tmp_path)
    assert second.excite(multisine()).fault is None
    assert len(second._source(False).training) == 199 + flown.periods - 1


def test_logs_of_another_rig_are_refused_before_anything_moves(tmp_path):
    session, _ = blind(tmp_path)
    session.excite(multisine(1.0))
    other, rig = blind(tmp_path, unit="deg")
    with pytest.raises(ValueError, match="columns"):
        other.excite(multisine())
    assert rig.x.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("mine", "theirs", "message"),
    [
        ({"state_units": ("deg", "rad/s")}, {}, "deg.*rad"),
        ({"input_ends": ((0.0, 12.0),)}, {}, r"\[0.0, 12.0, .*\[-1.0, 1.0, "),
        ({"input_ends": ((0.0, 12.0),)}, {"input_ends": ((-12.0, 12.0),)}, r"\[0.0, 12.0, .*\[-12.0, 12.0, "),
    ],
)
def test_a_controller_in_other_units_is_refused_before_anything_moves(session, mine, theirs, message):
    signature = session.wiring.signature
    session.wiring = replace(session.wiring, signature=replace(signature, **mine), seen=(True, True))
    task = Tracking(
        replace(signature, **theirs), RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), TrackingReward((1.0,))
    )
    with pytest.raises(ValueError, match=message):
        session.run_flight(Controller(actor(task.n_o, 1, (4,)), ControlSetup(task, 0.05)), [[0.1]], 1.0)
    assert not session.flights


def test_a_rig_is_moved_little_at_first(tmp_path):
    session, _ = blind(tmp_path)
    signal = Multisine(1, duration=3, dt=0.05, amplitude=0.4, offset=0.1, seed=0, first=0.1)
    assert session.excite(signal).fault is None
    sent = np.genfromtxt(tmp_path / "excitation.csv", delimiter=",", skip_header=1)[:60, 2]  # time, angle, input
    share = np.minimum(1.0, 0.1 * 2 ** (np.arange(60) / 10))
    np.testing.assert_allclose(sent, 0.1 + share * (signal.samples().numpy()[:, 0] - 0.1), atol=1e-6)
