import torch

from dynasindy.systems import Stops


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
