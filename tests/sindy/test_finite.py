"""Coefficients that ran away are named."""

import math

import pytest
import torch

from dynasindy.sindy.equations import require_finite_coefficients
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems import Diverged, Signature


def test_the_first_that_is_not_finite_is_named():
    library = build_library(["a", "sin(b)"], Signature(("a", "b"), ("-", "-"), (), (1.0, 1.0)))
    sound = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    assert require_finite_coefficients(sound, library, "regression", 9) is sound
    sound[1, 0] = sound[1, 1] = -math.inf
    with pytest.raises(Diverged, match="regression"):
        require_finite_coefficients(sound, library, "regression", 9)
