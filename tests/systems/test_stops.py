import torch

from dynasindy.systems import Stops


def test_gradient_passes_where_the_beam_is_free_and_vanishes_at_a_stop():
    x = torch.tensor([[0.5, 2.0], [1.5, 2.0]], requires_grad=True)
    held, _ = Stops((0,), (1,), (-1.0,), (1.0,)).apply(x)
    held.sum().backward()
    assert x.grad.tolist() == [[1.0, 1.0], [0.0, 0.0]]


def test_states_without_stops_pass_unchanged():
    x = torch.tensor([[0.1, 50.0, -7.0]])
    held, touched = Stops((0,), (2,), (-1.0,), (1.0,)).apply(x)
    assert torch.equal(held, x) and not touched.any()
