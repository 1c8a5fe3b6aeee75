"""A plant in discrete time that no differential equation follows."""

from dynasindy.systems.base import Signature, System


class Alternating(System):
    """x[k+1] = -0.6 x[k] + u[k], by steps of 0.5 s."""

    step = 0.5

    def __init__(self):
        super().__init__(Signature(("x",), ("-",), ("u",), (1.0,)))

    def forward(self, x, u):
        return (-1.6 * x + u) / 0.5
