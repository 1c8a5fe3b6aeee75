"""Formulas compute what the library does, from text alone."""

import math

import pytest
import torch

from dynasindy.sindy.codegen import InfixWriter
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


class Written(InfixWriter):
    def _constant(self, value):
        return repr(value)

    def _plus_scaled(self, total, value, c):
        return f"{total} + {c!r} * {value}"


def test_formulas_of_states_and_inputs_compute_the_sums():
    a, b, u = (variable(name) for name in ("a", "b", "u"))
    library = Library(SIGNATURE, [CONSTANT, a * b, u * of("cos", "a", frequency=2.0), of("abs", "b") * b])
    xi = torch.tensor([[0.5, 0.0], [-2.0, 0.0], [3.0, 0.0], [0.0, 0.25]], dtype=torch.float64)
    writer = Written.of(library, xi)
    values = {"x": [0.3, -1.2], "u": [0.7], "cos": math.cos, "fabs": abs}
    for name, formula in writer.named:
        values[name] = eval(formula, {}, values)
    found = [eval(result, {}, values) for result in writer.results]
    wanted = [0.5 - 2.0 * 0.3 * -1.2 + 3.0 * 0.7 * math.cos(0.6), 0.25 * 1.2 * -1.2]
    assert found == pytest.approx(wanted, rel=1e-12)


def test_an_equation_without_terms_is_zero():
    writer = Written.of(Library(SIGNATURE, [variable("a")]), torch.tensor([[0.0, 2.0]], dtype=torch.float64))
    assert float(eval(writer.results[0], {}, dict(writer.named))) == 0.0


def test_a_model_of_too_many_terms_is_refused_by_their_number():
    class Deep(Written):
        def __init__(self, library, coefficients):
            super().__init__(library, coefficients)
            self.__init__(library, coefficients)

    library = Library(SIGNATURE, [variable("a"), variable("b")])
    with pytest.raises(ValueError, match="remove"):
        Deep.of(library, torch.zeros(2, 2, dtype=torch.float64))
