"""What a difference equation is fitted to, and what is refused."""

import math
from dataclasses import replace

import pytest
import torch

from dynasindy.sindy.difference_equation import step_rows, with_time
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems import Signature
from dynasindy.systems.steps import UNTOLD
from dynasindy.systems.transitions import Transitions

LIBRARY = build_library(["a", "b", "u"], Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0)))
DATA = Transitions.from_trajectory(torch.arange(20.0, dtype=torch.float64).reshape(10, 2), torch.zeros(9, 1), 0.25)


def test_the_library_is_of_the_kind_that_is_wanted():
    assert with_time(LIBRARY, None).step is None and with_time(LIBRARY, "continuous").step is None
    discrete = with_time(LIBRARY, "discrete")
    assert discrete.step == UNTOLD and LIBRARY.step is None
    known = discrete.with_step(0.5)
    assert with_time(known, None).step == with_time(known, "discrete").step == 0.5
    assert with_time(known, "continuous").step is None
    with pytest.raises(ValueError, match="world_model"):
        with_time(LIBRARY, "diskrete")


def test_the_step_is_the_sampling_time():
    library, rows = step_rows(with_time(LIBRARY, "discrete"), DATA)
    assert library.step == 0.25 and rows is DATA
    assert step_rows(library, DATA)[0] is library


def test_rows_with_a_lost_sample_are_left_out():
    x, x_next = DATA.x.clone(), DATA.x_next.clone()
    x[4, 1] = x_next[3, 1] = math.nan
    _, rows = step_rows(with_time(LIBRARY, "discrete"), replace(DATA, x=x, x_next=x_next))
    assert rows.x[:, 0].tolist() == [0.0, 2.0, 4.0, 10.0, 12.0, 14.0, 16.0]
    assert rows.segment.tolist() == [0, 0, 0, 1, 1, 1, 1]


def test_samples_within_a_control_period_are_left_out():
    library, rows = step_rows(with_time(LIBRARY, "discrete"), replace(DATA, substeps=3))
    assert library.step == rows.dt == 0.75 and rows.substeps == 1
    assert rows.x[:, 0].tolist() == [0.0, 6.0, 12.0] and rows.x_next[:, 0].tolist() == [6.0, 12.0, 18.0]


def test_what_no_difference_equation_is_fitted_to_is_refused():
    discrete = with_time(LIBRARY, "discrete")
    with pytest.raises(ValueError, match="whole"):
        step_rows(discrete, replace(DATA, substeps=2))
    with pytest.raises(ValueError, match="sampled"):
        step_rows(discrete.with_step(0.1), DATA)
    blind = replace(DATA, x=DATA.x * torch.tensor([1.0, math.nan]))
    with pytest.raises(ValueError, match="needs"):
        step_rows(discrete, blind)
