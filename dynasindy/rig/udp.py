"""A rig at the other end of a network: samples and inputs as datagrams of little-endian doubles.

| datagram | bytes                                                                      |
| -------- | -------------------------------------------------------------------------- |
| sample   | `DYN1`, number of the sample (uint32), measured states (n_x doubles)        |
| inputs   | `DYN1`, number of the sample that they answer (uint32), inputs (n_u doubles) |

The number 0xffffffff asks for the safe input; so does silence, which the far end has to notice by itself.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import numpy as np

from dynasindy.rig.base import Array, Fault
from dynasindy.systems import System

MAGIC = b"DYN1"
REST = 0xFFFFFFFF
"""Number of a datagram that asks for the safe input."""
TIMES = 3
"""How often it is sent."""
MOST = 100_000
"""Datagrams that are thrown away before a flight; more are a flood."""


class UdpRig:
    """A rig that streams samples over UDP and takes inputs the same way.

    Attributes:
        strange: What came since the last sample that is none, in words; empty if nothing did.

    Args:
        n_x: Number of states in a sample.
        n_u: Number of inputs.
        host: Address of the rig.
        port: Its port.

    Raises:
        ValueError: There is no such port.
        OSError: There is no such address; like all errors of the connection it names host and port.
    """

    streams = True

    def __init__(self, n_x: int, n_u: int, host: str = "127.0.0.1", port: int = 9870) -> None:
        self.n_x, self.n_u, self.place = n_x, n_u, f"{host}, port {port}"
        self.last = -1
        self.first: int | None = None
        self.strange = ""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            with self._named():
                self._socket.connect((host, port))
        except OverflowError as error:
            raise ValueError(f"port {port} of a rig does not exist; give one of 1 to 65535") from error

    @staticmethod
    def pack(number: int, values: Array) -> bytes:
        """Return a datagram."""
        return MAGIC + struct.pack(f"<I{len(values)}d", number, *values)

    @staticmethod
    def unpack(datagram: bytes, n: int) -> tuple[int, Array] | None:
        """Return number and values, None if it is no datagram of n values."""
        if len(datagram) != 8 + 8 * n or datagram[:4] != MAGIC:
            return None
        number, *values = struct.unpack(f"<I{n}d", datagram[4:])
        return number, np.array(values)

    @property
    def number(self) -> int | None:
        """Periods from the first sample after `begin` to the last one."""
        return None if self.first is None else self.last - self.first

    def begin(self) -> None:
        """Forget what has arrived so far, and tell the far end whom to send samples to; it may have been started anew.

        Raises:
            OSError: The connection is broken.
        """
        self.last, self.first, self.strange = -1, None, ""
        self._socket.settimeout(0.0)
        for _ in range(MOST):
            try:
                self._socket.recv(65536)
            except ConnectionError:  # of a datagram that was sent before
                continue
            except (TimeoutError, BlockingIOError):
                break
        with self._named():
            self._socket.send(self.pack(REST, np.zeros(self.n_u)))

    def read(self, seconds: float) -> Array | None:
        """Return the newest sample that is newer than the last one, `(n_x,)`; None if none came in time.

        What is no sample of this rig, or an old one, is left out.

        Raises:
            OSError: The connection is broken.
        """
        end = time.monotonic() + seconds
        newest: Array | None = None
        while True:
            left = 0.0 if newest is not None else end - time.monotonic()
            if newest is None and left <= 0:
                return None
            self._socket.settimeout(left)
            try:
                with self._named():
                    datagram = self._socket.recv(65536)
            except (TimeoutError, BlockingIOError):
                if newest is not None:
                    return newest
                continue
            found = self.unpack(datagram, self.n_x)
            if found is None:
                self.strange = (
                    f"what came last is no sample: {len(datagram)} bytes that begin with {datagram[:4]!r}; a sample of "
                    f"this rig is {8 + 8 * self.n_x} bytes: DYN1, its number as a uint32, and a double for each state"
                )
            elif found[0] > self.last:
                self.last, newest, self.strange = *found, ""
                self.first = self.last if self.first is None else self.first

    def write(self, u: Array) -> None:
        """Send inputs, `(n_u,)`, as the answer to the last sample.

        Raises:
            Fault: There are not as many as the rig has.
            OSError: The connection is broken.
        """
        if len(u) != self.n_u:
            raise Fault("controller", f"{len(u)} inputs for a rig with {self.n_u}")
        with self._named():
            self._socket.send(self.pack(max(self.last, 0), u))

    def rest(self) -> None:
        """Ask for the safe input, several times, as datagrams get lost; an answer is not waited for."""
        for _ in range(TIMES):
            # An error may be that of an earlier datagram, and the next one go through. If nobody is there any more, the
            # far end has noticed the silence.
            with suppress(OSError):
                self._socket.send(self.pack(REST, np.zeros(self.n_u)))

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Name host and port in errors of the connection; that nothing came in time is none."""
        try:
            yield
        except (TimeoutError, BlockingIOError):
            raise
        except OSError as error:
            mend = "give the rig's rig.host and rig.port"
            if error.errno == errno.ECONNREFUSED:
                mend = "no program of a rig listens there: start it, or give its rig.host and rig.port"
            raise OSError(error.errno, f"{error.strerror or error} ({self.place}); {mend}") from error

    def close(self) -> None:
        """Ask for the safe input and let go of the network."""
        self.rest()
        self._socket.close()


@contextmanager
def connect(system: System, dt: float, host: str = "127.0.0.1", port: int = 9870) -> Iterator[UdpRig]:
    """Talk to a rig, and leave it at its safe input.

    Args:
        system: Plant whose states and inputs it has.
        dt: Control period [s], which the rig keeps by itself.
        host: Address of the rig.
        port: Its port.
    """
    with closing(UdpRig(system.signature.n_x, system.signature.n_u, host, port)) as rig:
        yield rig
