"""A step that repeats does the same, captured or not."""

import pytest
import torch

from dynasindy.together.captured import captured


@pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"))]
)
def test_a_step_goes_on_from_what_the_last_one_left(device):
    number = torch.zeros((), device=device)

    def _step():
        number.mul_(2.0).add_(1.0)

    again = captured(_step, torch.device(device), number.zero_)
    number.zero_()
    for _ in range(5):
        again()
    assert number.item() == 2**5 - 1
