"""What a coefficient must be worth is the extended Bayesian criterion, times how long errors last if that is asked."""

import math
from dataclasses import replace

import pytest
import torch

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.refinement.descent import Descent, Limits, price
from dynasindy.world_models.refinement.windows import Windows


def test_the_price_is_that_of_chen_and_chen():
    """log n of the Bayesian criterion, and twice log p for a choice among p functions."""
    free = torch.tensor([[True, False], [True, True], [True, False]])
    assert price(1000, free) == pytest.approx(math.log(1000) + 2 * math.log(3))
    assert price(1, torch.zeros(3, 2, dtype=torch.bool)) == pytest.approx(math.log(2))


def test_errors_that_last_make_a_coefficient_dearer_if_that_is_asked():
    data = Transitions.from_trajectory(torch.zeros(401, 1).double(), torch.zeros(400, 1).double(), 0.1)
    windows = Windows.of(data, 20, False, 1)
    slow = torch.sin(torch.arange(400).double() / 10).reshape(windows.mask.shape)
    assert Limits(7.0, 3).at(slow, windows) == 7.0
    assert Limits(7.0, 3, correlated=True).at(slow, windows) > 14.0


def test_windows_join_unless_they_are_told_not_to_or_pushes_are_estimated():
    descent = Descent(20)
    assert descent.joins and replace(descent, joined=True).joins
    assert not replace(descent, joined=False).joins and not replace(descent, pushed=True).joins
