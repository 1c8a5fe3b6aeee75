"""The far end of a network: a plant that streams samples over UDP, each once the one before was answered."""

import socket

import numpy as np
import torch

from dynasindy.rig.udp import REST, UdpRig
from dynasindy.systems import integrate


class FarEnd:
    """Serve a plant over UDP on a free port, and keep its states and the inputs of each period.

    A period without inputs is bridged with those before, a second one ends in the safe input.
    """

    def __init__(self, system, dt, sensors=None, safe=None):
        self.system, self.dt, self.sensors = system, dt, sensors
        self.safe = np.zeros(system.signature.n_u) if safe is None else safe
        self.states, self.applied = [], []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.moved(torch.zeros(system.signature.n_x).double(), self.safe)  # makes its code before any thread asks

    def serve(self, periods):
        """Wait for a caller, then run so many periods; a busy computer is no fault of the flight."""
        self.socket.settimeout(300.0)
        caller = self.socket.recvfrom(65536)[1]
        self.socket.settimeout(10.0)
        x, u, missed, rng = torch.zeros(self.system.signature.n_x).double(), self.safe, 0, torch.Generator()
        for k in range(periods):
            y = x if self.sensors is None else self.sensors.read(x, self.system.signature, rng)
            self.socket.sendto(UdpRig.pack(k, y.numpy()), caller)
            found = self.answer()
            missed = 0 if found is not None else missed + 1
            u = found if found is not None else u if missed < 2 else self.safe
            self.states.append(x.numpy().copy())
            self.applied.append(u)
            x = self.moved(x, u)
        self.socket.close()

    def moved(self, x, u):
        return integrate(self.system, x, torch.from_numpy(u), self.dt, 5, self.system.stops)[0][-1]

    def answer(self):
        """Return the inputs that arrive, None if none do or the caller is gone."""
        try:
            number, u = UdpRig.unpack(self.socket.recv(65536), len(self.safe))
        except (TimeoutError, ConnectionError):
            return None
        return self.safe if number == REST else u
