"""Kept constants are the numbers that were asked for, and good for every later use."""

import torch

from dynasindy.tasks.constants import constants

CPU = torch.device("cpu")


def test_numbers_are_kept_by_value_and_kind():
    found = constants((1.5, -2.0), torch.float64, CPU)
    assert torch.equal(found, torch.tensor([1.5, -2.0], dtype=torch.float64))
    assert constants((1.5, -2.0), torch.float64, CPU) is found
    assert constants((1.5, -2.0), torch.float32, CPU).dtype == torch.float32
    assert constants((1.5, 2.0), torch.float64, CPU)[1] == 2.0


def test_where_they_were_first_made_leaves_no_trace():
    with torch.inference_mode():
        constants((3.25, 1.5), torch.float32, CPU)
    torch.func.jacrev(lambda x: x * constants((4.25, 1.5), torch.float32, CPU))(torch.ones(2))
    for numbers in ((3.25, 1.5), (4.25, 1.5)):
        x = torch.ones(2, requires_grad=True)
        (x * constants(numbers, torch.float32, CPU)).sum().backward()
        assert x.grad.tolist() == list(numbers)
