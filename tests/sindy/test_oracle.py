import pytest
import torch
from alternating import Alternating

from dynasindy.sindy import Oracle
from dynasindy.systems import Pendulum, Tras, integrate


def test_it_is_the_plant():
    plant, x, u = Tras(), torch.randn(3, 6), torch.rand(3, 2)
    assert torch.equal(Oracle(plant.signature, plant)(x, u), plant(x, u))


def test_of_a_difference_equation_it_moves_by_its_steps():
    """Two steps of -0.6 x + u: 0.36 x + 0.4 u."""
    x, u = torch.tensor([[1.0], [-2.0]]), torch.tensor([[0.5], [0.0]])
    plant = Alternating()
    found = integrate(Oracle(plant.signature, plant), x, u, 1.0, 1)[0]
    assert found.flatten().tolist() == pytest.approx([0.56, -0.72])


def test_another_plant_is_refused():
    with pytest.raises(ValueError, match="experiment"):
        Oracle(Tras().signature, Pendulum())
