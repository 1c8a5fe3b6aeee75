"""Constants are made once per kind of number, and are what was given."""

import torch

from dynasindy.tasks.constants import constants


def test_the_same_numbers_are_kept_and_others_are_their_own():
    cpu = torch.device("cpu")
    one = constants((1.0, 0.25), torch.float64, cpu)
    assert one is constants((1.0, 0.25), torch.float64, cpu)
    assert one.tolist() == [1.0, 0.25] and one.dtype == torch.float64
    single = constants((1.0, 0.25), torch.float32, cpu)
    assert single.dtype == torch.float32 and single.tolist() == [1.0, 0.25]
    assert constants((0.25, 1.0), torch.float64, cpu).tolist() == [0.25, 1.0]
