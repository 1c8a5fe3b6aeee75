"""A compiled controller is called and timed; without a compiler one line says so."""

import pytest

from dynasindy.control.c_code import Native
from dynasindy.export import controller_sources
from dynasindy.systems.compiler import compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


@needs_compiler
def test_two_controllers_of_one_name_live_side_by_side(pendulum):
    one, other = (Native(controller_sources(pendulum(observer=False, integral=i))) for i in (None, {"gain": 5.0}))
    first = [one.act([0.1, 0.0], [0.12])[0], other.act([0.1, 0.0], [0.12])[0]]
    assert first[0] == first[1]
    assert one.act([0.1, 0.0], [0.12])[0] == first[0]
    assert other.act([0.1, 0.0], [0.12])[0] != first[1]
    with pytest.raises(ValueError, match=r"1 .* where 2"):
        one.act([0.1], [0.12])


@needs_compiler
def test_calls_that_are_timed_are_forgotten(pendulum):
    one = Native(controller_sources(pendulum(observer=False, integral={})))
    first = one.act([0.1, 0.0], [0.12])
    assert one.microseconds() > 0
    assert one.act([0.1, 0.0], [0.12]) == first
