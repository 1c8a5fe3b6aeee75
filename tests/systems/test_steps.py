"""Which steps a time is made of, and what is refused."""

import pytest
import torch

from dynasindy.systems import Pendulum
from dynasindy.systems.steps import UNTOLD, Rates, step_of, steps_of


def test_a_differential_equation_takes_as_many_steps_as_it_is_told():
    assert steps_of(None, 0.3, 4) == (pytest.approx(0.075), 4, False)


@pytest.mark.parametrize(("seconds", "number"), [(0.1, 1), (0.10000000001, 1), (0.3, 3), (1.0, 10)])
def test_a_difference_equation_takes_its_own_steps_whatever_it_is_told(seconds, number):
    assert steps_of(0.1, seconds, 7) == (0.1, number, True)


@pytest.mark.parametrize("seconds", [0.05, 0.15, 0.1001, 0.0])
def test_a_time_of_parts_of_steps_is_refused_in_a_line(seconds):
    with pytest.raises(ValueError, match=r"a step of 0.1 s and cannot move by .* give env.dt=0.1") as error:
        steps_of(0.1, seconds, 1)
    assert "\n" not in str(error.value)


def test_before_a_fit_any_time_is_one_step():
    assert steps_of(UNTOLD, 0.37, 5) == (0.37, 1, True)


def test_a_function_is_of_a_difference_equation_where_it_says_so():
    def field(x, u):
        return 2 * x

    assert step_of(field) is None and step_of(Pendulum()) is None
    rates = Rates(field, 0.2)
    assert step_of(rates) == 0.2 and float(rates(torch.tensor(3.0), torch.zeros(1))) == 6.0
