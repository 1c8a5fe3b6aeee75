"""Datagrams byte by byte, and what a rig over UDP believes."""

import socket
import threading

import numpy as np
import pytest

from dynasindy.rig import Fault
from dynasindy.rig.udp import REST, UdpRig


@pytest.fixture
def ends():
    far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    far.bind(("127.0.0.1", 0))
    far.settimeout(5.0)
    rig = UdpRig(2, 1, port=far.getsockname()[1])
    rig.begin()
    hello, caller = far.recvfrom(100)
    yield rig, far, caller, hello
    far.close()
    rig._socket.close()


@pytest.mark.parametrize("datagram", [b"", b"DYN1", b"DYN2" + bytes(20), b"DYN1" + bytes(12), b"DYN1" + bytes(28)])
def test_what_is_no_datagram_is_left_out(datagram):
    assert UdpRig.unpack(datagram, 2) is None


def test_the_newest_sample_counts_and_old_ones_do_not(ends):
    rig, far, caller, _ = ends
    for number in (3, 5, 4):
        far.sendto(UdpRig.pack(number, np.array([number, 0.5])), caller)
    assert rig.read(2.0).tolist() == [5.0, 0.5]
    far.sendto(UdpRig.pack(5, np.array([9.0, 9.0])), caller)
    far.sendto(b"nonsense", caller)
    assert rig.read(0.05) is None
    far.sendto(UdpRig.pack(6, np.array([6.0, 6.0])), caller)
    assert rig.read(2.0).tolist() == [6.0, 6.0]


def test_inputs_answer_the_last_sample(ends):
    rig, far, caller, _ = ends
    far.sendto(UdpRig.pack(11, np.array([0.0, 0.0])), caller)
    rig.read(2.0)
    rig.write(np.array([0.75]))
    number, values = UdpRig.unpack(far.recv(100), 1)
    assert (number, values.tolist()) == (11, [0.75])
    with pytest.raises(Fault, match="inputs"):
        rig.write(np.array([0.1, 0.2]))


def test_nobody_at_the_other_end_is_told_with_host_and_port():
    """A port that was bound and let go refuses datagrams; the next call hears of it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    rig = UdpRig(2, 1, port=port)
    rig.begin()
    with pytest.raises(ConnectionRefusedError, match=rf"\(127\.0\.0\.1, port {port}\)"):
        rig.read(2.0)
    rig.close()
    with pytest.raises(OSError, match="host"):
        UdpRig(2, 1, host="nowhere.invalid")


def test_the_end_asks_for_the_safe_input(ends):
    rig, far, _, _ = ends
    rig.close()
    assert [UdpRig.unpack(far.recv(100), 1)[0] for _ in range(3)] == [REST] * 3  # datagrams get lost
    rig.rest()  # nothing to send it with any more, and no error


def test_a_flight_begins_with_a_fresh_sample_even_of_a_far_end_that_began_anew(ends):
    rig, far, caller, _ = ends
    far.sendto(UdpRig.pack(900, np.zeros(2)), caller)
    assert rig.read(2.0) is not None
    for number in range(901, 2000):
        far.sendto(UdpRig.pack(number, np.ones(2)), caller)
    rig.begin()
    assert UdpRig.unpack(far.recv(100), 1)[0] == REST  # the far end learns anew whom to talk to
    assert rig.number is None
    assert rig.read(0.02) is None
    for number, expected in ((4, 0), (5, 1), (8, 4)):
        far.sendto(UdpRig.pack(number, np.array([number, 0.0])), caller)
        assert rig.read(2.0)[0] == number
        assert rig.number == expected


def test_a_flood_of_garbage_does_not_hold_a_flight(ends):
    rig, far, caller, _ = ends
    stop = threading.Event()

    def flood():
        while not stop.is_set():
            far.sendto(b"nonsense", caller)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        assert rig.read(0.2) is None
    finally:
        stop.set()
        thread.join()
