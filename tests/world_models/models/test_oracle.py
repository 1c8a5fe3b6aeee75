import pytest
import torch

from dynasindy.systems import Pendulum, Tras
from dynasindy.world_models import Oracle


def test_it_is_the_plant():
    plant, x, u = Tras(), torch.randn(3, 6), torch.rand(3, 2)
    assert torch.equal(Oracle(plant.signature, plant)(x, u), plant(x, u))


def test_another_plant_is_refused():
    with pytest.raises(ValueError, match="give it the plant of the experiment"):
        Oracle(Tras().signature, Pendulum())
