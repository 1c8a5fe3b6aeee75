"""A plant that another process can import: this folder is on the path that it is handed."""

from dynasindy.systems.base import Signature, System


class Tank(System):
    """A tank of 1 m^2 that drains through a hole: h' = 0.1 (1 + u) - 0.2 sqrt(h)."""

    def __init__(self):
        super().__init__(Signature(("h",), ("m",), ("pump",), (1.0,)))

    def forward(self, x, u):
        return 0.1 * (1.0 + u) - 0.2 * x.sqrt()
