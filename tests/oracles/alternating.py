"""Plants in discrete time, the second one of which no differential equation follows."""

from dynasindy.systems.base import Signature, System


class Mapped(System):
    """x[k+1] = a x[k] + b u[k], by steps of 0.5 s."""

    step = 0.5

    def __init__(self, a, b):
        super().__init__(Signature(("x",), ("-",), ("u",), (1.0,)))
        self.a, self.b = a, b

    def forward(self, x, u):
        return ((self.a - 1) * x + self.b * u) / 0.5


class Alternating(Mapped):
    """x[k+1] = -0.6 x[k] + u[k], by steps of 0.5 s."""

    def __init__(self):
        super().__init__(-0.6, 1.0)
