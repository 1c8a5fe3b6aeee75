"""What every world model is, and the one that is the plant itself."""

import pytest
import torch
from alternating import Alternating

from dynasindy.sindy import Oracle, SindyModel
from dynasindy.systems import Tras, integrate


@pytest.mark.parametrize("make", [lambda p: Oracle(p.signature, p), lambda p: SindyModel(p.signature)])
def test_every_model_is_a_system_with_the_plants_signature(make, tmp_path):
    plant = Tras()
    model = make(plant)
    assert model.signature == plant.signature
    assert model(torch.zeros(4, 6), torch.zeros(4, 2)).shape == (4, 6)
    assert len(model.equations()) == 6
    model.save(tmp_path / "model.json")
    assert (tmp_path / "model.json").read_text().startswith("{")


def test_it_is_the_plant():
    plant, x, u = Tras(), torch.randn(3, 6), torch.rand(3, 2)
    assert torch.equal(Oracle(plant.signature, plant)(x, u), plant(x, u))


def test_of_a_difference_equation_it_moves_by_its_steps():
    """Two steps of -0.6 x + u: 0.36 x + 0.4 u."""
    x, u = torch.tensor([[1.0], [-2.0]]), torch.tensor([[0.5], [0.0]])
    plant = Alternating()
    found = integrate(Oracle(plant.signature, plant), x, u, 1.0, 1)[0]
    assert found.flatten().tolist() == pytest.approx([0.56, -0.72])
