"""Which steps a time is made of, what is refused, and stops."""

import pytest
import torch
from tank import Tank

from dynasindy.systems import Pendulum, Stops
from dynasindy.systems.steps import Rates, steps_of, time_step_of


def test_a_differential_equation_takes_as_many_steps_as_it_is_told():
    assert steps_of(None, 0.3, 4) == (pytest.approx(0.075), 4, False)


@pytest.mark.parametrize(("seconds", "number"), [(0.1, 1), (0.10000000001, 1), (0.3, 3), (1.0, 10)])
def test_a_difference_equation_takes_its_own_steps_whatever_it_is_told(seconds, number):
    assert steps_of(0.1, seconds, 7) == (0.1, number, True)


@pytest.mark.parametrize("seconds", [0.05, 0.15, 0.1001, 0.0])
def test_a_time_of_parts_of_steps_is_refused_in_a_line(seconds):
    with pytest.raises(ValueError, match="dt=0") as error:
        steps_of(0.1, seconds, 1)
    assert "\n" not in str(error.value)


def test_a_function_is_of_a_difference_equation_where_it_says_so():
    def field(x, u):
        return 2 * x

    assert time_step_of(field) is None and time_step_of(Pendulum()) is None
    rates = Rates(field, 0.2)
    assert time_step_of(rates) == 0.2 and float(rates(torch.tensor(3.0), torch.zeros(1))) == 6.0


class Sampled(Tank):
    step = 0.1


def test_a_plant_is_a_difference_equation_where_its_class_has_a_number():
    assert time_step_of(Sampled()) == 0.1 and time_step_of(Tank()) is None
    with pytest.raises(TypeError, match="Stepped"):
        time_step_of(type("Stepped", (Tank,), {"step": lambda self: None})())


def test_gradient_passes_where_the_beam_is_free_and_vanishes_at_a_stop():
    x = torch.tensor([[0.5, 2.0], [1.5, 2.0]], requires_grad=True)
    held, _ = Stops((0,), (1,), (-1.0,), (1.0,)).apply(x)
    held.sum().backward()
    assert x.grad.tolist() == [[1.0, 1.0], [0.0, 0.0]]


def test_each_position_has_its_own_stops_and_all_are_tried():
    stops = Stops([0, 2], [1, 3], [-1.0, -0.2], [0.5, 0.3])
    x = torch.tensor([[0.7, 1.0, -0.4, -2.0], [-1.0, -3.0, 0.3, -1.0], [0.0, 4.0, 0.0, -4.0]], dtype=torch.float64)
    held, touched = stops.apply(x)
    assert held.tolist() == [[0.5, 0, -0.2, 0], [-1, 0, 0.3, -1], [0, 4, 0, -4]]
    assert touched.tolist() == [True, True, False]
    assert stops == Stops((0, 2), (1, 3), (-1.0, -0.2), (0.5, 0.3))
