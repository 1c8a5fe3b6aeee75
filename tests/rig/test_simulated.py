"""A simulated rig keeps a watch of its own: a flight that falls silent ends in the safe input."""

import socket
import threading

import numpy as np
import pytest
from tank import Tank

from dynasindy.rig import simulated
from dynasindy.rig.simulated import SimulatedRig, rehearsal
from dynasindy.rig.udp import REST, pack
from dynasindy.sensing import Sensors
from dynasindy.systems import Pendulum
from dynasindy.systems.integrators import integrate

SAFE = np.array([0.25])


def talked(answers, periods):
    """Return the record of a rig whose caller answers as given, None for nothing."""
    server = SimulatedRig(Pendulum(), 0.05, safe=SAFE)
    thread = threading.Thread(target=server.serve, args=(periods,))
    thread.start()
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    caller.connect(("127.0.0.1", server.port))
    caller.send(pack(REST, np.zeros(1)))
    caller.settimeout(10.0)
    for answer in answers:
        caller.recv(100)
        if answer is not None:
            caller.send(answer)
    thread.join()
    caller.close()
    return server.record


def test_silence_is_bridged_once():
    """What this busy computer answers late counts as silence too, so that the first input is looked for."""
    record = talked([pack(0, np.array([0.5]))], 8)
    inputs = [float(u[0]) for u in record.applied]
    first = next((k for k, u in enumerate(inputs) if u == 0.5), None)
    assert first is not None
    assert inputs[first : first + 2] == [0.5, 0.5]
    assert set(inputs[first + 2 :]) == {0.25}
    assert record.answered.count(True) == 1


@pytest.mark.parametrize(("last", "applied", "asked"), [(1, 0.75, False), (REST, 0.25, True)])
def test_a_rig_that_keeps_a_clock_takes_the_newest_of_what_arrived(last, applied, asked):
    server = SimulatedRig(Pendulum(), 0.3, safe=SAFE)
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    caller.connect(("127.0.0.1", server.port))
    for number, level in ((REST, 0.0), (0, 0.5), (last, 0.75)):  # a call, then two answers before the rig looks
        caller.send(pack(number, np.array([level])))
    record = server.serve(1)
    caller.close()
    assert record.applied[0].tolist() == [applied]
    assert (record.answered, record.asked) == ([True], [asked])


def test_rest_is_the_safe_input_and_not_what_stands_beside_it():
    assert {float(u[0]) for u in talked([pack(REST, np.array([0.9]))], 4).applied} == {0.25}


def test_what_is_no_datagram_changes_nothing():
    assert {float(u[0]) for u in talked([b"up!"], 4).applied} == {0.25}


@pytest.mark.slow
def test_a_rehearsal_is_a_rig_of_its_own_clock():
    with rehearsal(Pendulum(), 0.05) as rig:
        rig.begin()
        assert rig.read(60.0).tolist() == [0.0, 0.0]
        rig.write(np.array([1.0]))
        # Full torque takes hold for two periods at least: one in which it arrives, and one that is bridged.
        turned = [y[0] for y in (rig.read(10.0) for _ in range(4)) if y is not None]
        assert max(turned) > 0.01


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_rehearsal_begins_where_its_user_says_and_asks_the_plant_about_nothing_beyond_its_bounds():
    with rehearsal(Tank(), 0.05, bounds={"h": [0.0, 2.0]}, start={"h": 0.25}) as rig:
        rig.begin()
        samples = [rig.read(60.0).item() for _ in range(3)]
    assert samples == pytest.approx([0.25] * 3, abs=1e-9)  # where 0.1 flows in and 0.2 sqrt(0.25) out


@pytest.mark.slow
def test_a_rehearsal_without_bounds_warns_of_where_the_plant_cannot_be():
    words = r"not finite, of h, where h is -0\.98 m"
    with pytest.warns(UserWarning, match=words), rehearsal(Tank(), 0.05):
        pass
    with pytest.raises(ValueError, match=r"bounds.* depth"), rehearsal(Tank(), 0.05, bounds={"depth": 1.0}):
        pass


def test_the_plant_is_ready_before_anybody_calls(monkeypatch):
    """Its first period takes long, as it is made machine code: no caller may lose samples to that."""
    asked = []
    monkeypatch.setattr(simulated, "integrate", lambda *given: asked.append(given) or integrate(*given))
    SimulatedRig(Pendulum(), 0.05, safe=SAFE)
    assert [float(given[2][0]) for given in asked] == [0.25]


def test_a_command_reaches_the_plant_as_many_periods_late_as_its_sensors_say():
    """Omega' = 12 u: the rate begins to move after two periods, and not before."""
    late = Sensors({"theta": {}, "Omega": {}}, actuator_delay=2)
    server = SimulatedRig(Pendulum(), 0.05, late)
    thread = threading.Thread(target=server.serve, args=(4, 10.0))
    thread.start()
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    caller.connect(("127.0.0.1", server.port))
    caller.send(pack(REST, np.zeros(1)))
    for k in range(4):
        caller.recv(100)
        caller.send(pack(k, np.array([0.5])))
    thread.join()
    caller.close()
    rates = [x[1] for x in server.record.states]
    assert rates[:3] == [0.0, 0.0, 0.0] and rates[3] == pytest.approx(12 * 0.5 * 0.05, rel=0.02)
