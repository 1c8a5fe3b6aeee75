"""A rig over UDP: datagrams as documented, inputs that answer samples, and a safe input whatever goes wrong."""

import csv
import math
import shlex
import socket
import struct
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from plants import pendulum_rates, scipy_motion

import dynasindy
from dynasindy.rig import Guard, UdpRig, Wiring, run_flight
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum

ROOT = Path(__file__).resolve().parents[2]
WIRING = Wiring(Pendulum().signature, (True, True), 0.05)
REST = 2**32 - 1
"""The number of a datagram that asks for the safe input."""


def moved(x, u):
    """Return the state of a pendulum a control period on."""
    return scipy_motion(pendulum_rates, x, [u], 0.05)[-1]


class FarEnd(threading.Thread):
    """The program of a rig: it sends a sample, waits for its answer, and goes wrong from some sample on.

    It waits up to ten seconds, so that a busy computer is no fault of a flight.
    """

    def __init__(self, periods, fault="", at=0, move=moved, x=(0.0, 0.0)):
        super().__init__(daemon=True)
        self.periods, self.fault, self.at, self.move, self.x = periods, fault, at, move, np.array(x)
        self.states, self.answers, self.numbers = [], [], []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(60.0)
        self.port = self.socket.getsockname()[1]

    def run(self):
        hello, caller = self.socket.recvfrom(1000)
        self.numbers.append(struct.unpack("<I", hello[4:8])[0])
        self.socket.settimeout(10.0)
        for k in range(self.periods):
            self.socket.sendto(self.datagram(k), caller)
            if not self.answered():
                break
        self.socket.close()

    def datagram(self, k):
        wrong = self.fault if k >= self.at else ""
        self.states.append(self.x)
        y = {"nan": [math.nan, 0.0], "range": [1e9, 0.0]}.get(wrong, self.x)
        number = min(k, self.at) if wrong == "old" else k
        return b"garbage" if wrong == "garbage" else b"DYN1" + struct.pack(f"<I{len(y)}d", number, *y)

    def answered(self):
        """Take the answer to a sample; False where it is the wish for the safe input, or none comes."""
        try:
            answer = self.socket.recv(1000)
        except TimeoutError:
            return False
        assert answer[:4] == b"DYN1"
        number, *u = struct.unpack(f"<I{(len(answer) - 8) // 8}d", answer[4:])
        self.numbers.append(number)
        if number == REST:
            return False
        self.answers.append(u)
        self.x = self.move(self.x, *u)
        return True


def swing(y, t):
    return np.array([0.5 * math.sin(3 * t) - 0.1 * y[1]])


def flown(tmp_path, far, act=swing, periods=12, late=100.0, **guard):
    far.start()
    rig = UdpRig(2, 1, port=far.port)
    try:
        return run_flight(rig, act, WIRING, periods, tmp_path / "log.csv", Guard(late=late, **guard))
    finally:
        rig.close()
        far.join()


def rows(path):
    with path.open() as file:
        return list(csv.reader(file))


def test_a_flight_moves_the_plant_as_the_controller_says_and_is_logged(tmp_path):
    far = FarEnd(13)
    result = flown(tmp_path, far)
    assert (result.periods, result.fault) == (12, None)
    expected = [float(swing(x, 0.05 * k)[0]) for k, x in enumerate(far.states[:12])]
    np.testing.assert_allclose(np.ravel(far.answers), expected, atol=1e-12)
    assert np.std(expected) > 0.1
    assert far.numbers == [REST, *range(12), REST]
    head, *lines = rows(tmp_path / "log.csv")
    assert head == ["time [s]", "theta [rad]", "Omega [rad/s]", "u [-]"]
    written = np.array(lines, dtype=float)
    np.testing.assert_allclose(written[:, 0], 0.05 * np.arange(12), atol=1e-9)
    np.testing.assert_allclose(written[:, 1:], np.column_stack([far.states[:12], expected]), atol=1e-6)


FAULTS = [("nan", "invalid", 1), ("range", "range", 5), ("garbage", "lost", 5), ("old", "lost", 1)]


@pytest.mark.parametrize(("fault", "kind", "at"), FAULTS)
def test_a_rig_that_fails_is_asked_for_its_safe_input(tmp_path, fault, kind, at):
    far = FarEnd(at + 8, fault, at)
    result = flown(tmp_path, far, late=40.0, low={"theta": -2.0}, high={"theta": 2.0}, lost=0)
    at += fault == "old"  # the first of those that are all alike is new
    assert (result.fault.kind, result.periods) == (kind, at)
    assert len(far.answers) == at and far.numbers[-1] == REST
    assert len(rows(tmp_path / "log.csv")) == 1 + at


@pytest.mark.parametrize(
    ("given", "at"), [([math.nan], 0), ([0.1, 0.2], 5), ([1.5], 0), (ZeroDivisionError("no idea"), 5)]
)
def test_a_controller_that_fails_leaves_the_safe_input(tmp_path, given, at):
    def act(y, t):
        if round(t / 0.05) < at:
            return swing(y, t)
        if isinstance(given, Exception):
            raise given
        return np.array(given)

    far = FarEnd(at + 8)
    result = flown(tmp_path, far, act)
    assert (result.fault.kind, result.periods) == ("controller", at)
    assert len(far.answers) == at and far.numbers[-1] == REST


TRAS = ROOT / "docs" / "results" / "policies" / "tras" / "controller.json"
SAVED = ("system=tras", "sensors=exact", f"controller={TRAS}", "rig=udp", "targets=[[0.3,-0.2]]", "seconds=1")


def still(x, *u):
    return x


@pytest.mark.parametrize(("fault", "code"), [("", 0), ("nan", 1), ("range", 1)])
def test_the_command_flies_a_saved_controller_and_its_code_says_how_it_ended(command, tmp_path, fault, code):
    """A rig that stays where it is gets at every sample what the controller answers to that state."""
    x = np.array([0.05, -0.1, 0.0, 0.0, 300.0, -200.0])
    far = FarEnd(50, fault, 4, still, x)
    far.start()
    words = (*SAVED, f"rig.port={far.port}", "guard.late=40", "guard.low={alpha_a: -1}", "guard.high={alpha_a: 1}")
    done = command("rig", *words, "folder=run", cwd=tmp_path)
    far.join()
    assert done.code == code and "Traceback" not in done.err, done
    head, *lines = rows(tmp_path / "run" / "flight_1.csv")
    assert len(lines) == (4 if fault else 20) and far.numbers[-1] == REST
    assert [cell.partition(" ")[0] for cell in head] == ["time", *names(), "u_a", "u_p"]
    expected = dynasindy.load(TRAS).act(x, [0.3, -0.2])
    assert 0 < np.abs(expected).max() <= 1
    np.testing.assert_allclose(far.answers, np.tile(expected, (len(lines), 1)), atol=1e-9)
    np.testing.assert_allclose(np.array(lines, dtype=float)[:, -2:], far.answers, atol=1e-6)


def names():
    return dynasindy.load(TRAS).signature.state_names


@pytest.mark.slow
def test_a_rig_in_another_process_is_excited_identified_planned_for_flown_and_refined(command, tmp_path):
    """The pendulum behind its encoder, over UDP in real time: Omega' = 12 u - 9.81 sin(theta) - 0.5 Omega."""
    small = ["plant.amplitude=[0.25]", "planner={updates: 150}"]  # with more the pendulum goes over the top
    words = ["flights=2", "seconds=4", "targets=[[0.5],[-0.4]]", *small]
    patient = ["guard.late=20", "guard.lost=100"]  # other jobs may hold the cores; nothing here can be damaged
    words += ["system=pendulum", "folder=run", "sensors=bench"]
    done = command("rig", *words, *patient, cwd=tmp_path, figures=True)
    assert done.code == 0, done
    (check,) = [line for line in done.out.splitlines() if "check.py run=" in line]
    small = ("points=1", "draws=1", "grid=2", "seconds=3")
    looked = command("check", *shlex.split(check, comments=True)[2:], *small, cwd=tmp_path)
    assert looked.code == 0, looked
    run = tmp_path / "run"
    files = [run / f"{name}.csv" for name in ("excitation", "flight_1", "flight_2")]
    assert {rows(file)[0][1] for file in files} == {"theta [rad]"}  # the encoder measures the angle alone
    assert {path.stem for path in (run / "figures").iterdir()} == {file.stem for file in files}
    excited, first, second = (np.genfromtxt(file, delimiter=",", skip_header=1).T for file in files)
    for moments, *_ in (excited, first, second):
        assert np.allclose(np.diff(moments), 0.05)
    assert np.nanmax(excited[1]) - np.nanmin(excited[1]) > 0.2
    # While it planned, the rig swung freely at its safe input, and half its damping of 0.5/s takes a swing down. How
    # long that took is the machine's affair: it is told by when the logs were written last, and by their lengths.
    for last, now, before, after in zip((excited, first), (first, second), files, files[1:], strict=False):
        planned = after.stat().st_mtime - 0.05 * now.shape[1] - before.stat().st_mtime
        assert planned > 1.0
        assert abs(now[1, 0]) < 2 * np.nanmax(np.abs(last[1])) * np.exp(-0.25 * planned) + 0.005
    end = second[1].reshape(2, -1)[:, -20:]
    assert np.nanmean(np.abs(end - [[0.5], [-0.4]])) < 0.1
    model = SindyModel.load(run / "model.json")
    theta, omega, u = (torch.linspace(-1, 1, 9).double() * k for k in (0.6, 1.0, 0.5))
    found = model(torch.stack([theta, omega], -1), u.unsqueeze(-1))[:, 1]
    torch.testing.assert_close(found, 12 * u - 9.81 * theta.sin() - 0.5 * omega, atol=0.3, rtol=0.02)
