"""Plants in discrete time, the second one of which no differential equation follows."""

from dynasindy.systems.base import Signature, System


class Mapped(System):
    """x[k+1] = a x[k] + b u[k], by steps of half a second or another time."""

    step = 0.5

    def __init__(self, a, b, step=0.5):
        super().__init__(Signature(("x",), ("-",), ("u",), (1.0,)))
        self.a, self.b, self.step = a, b, step

    def forward(self, x, u):
        return ((self.a - 1) * x + self.b * u) / self.step


class Alternating(Mapped):
    """x[k+1] = -0.6 x[k] + u[k], by steps of 0.5 s."""

    def __init__(self):
        super().__init__(-0.6, 1.0)
