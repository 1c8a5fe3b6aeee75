"""The Cramer-Rao bound against that of a straight line, which is in every textbook."""

import numpy as np
import pytest
import torch
from benchmarks.bound import cramer_rao

from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def test_the_slope_of_a_line_is_known_as_well_as_least_squares_can():
    # y' = 3: a line through 121 samples whose start is unknown; the error of its slope is sigma / |t - mean of t|.
    library = Library(Signature(("y",), ("-",), ("u",), (1.0,)), [CONSTANT, variable("y")])
    time = 0.1 * np.arange(121)
    y = torch.from_numpy(1 + 3 * time)[:, None]
    data = Transitions.from_trajectory(y, torch.zeros(120, 1).double(), 0.1)
    bound = cramer_rao(library, torch.tensor([[3.0], [0.0]]).double(), data, torch.tensor([0.2]).double())
    assert bound.tolist() == pytest.approx([0.2 / np.linalg.norm(time - time.mean())], rel=1e-6)
