import pytest
import torch

from dynasindy.sindy import Oracle, SindyModel, WorldModel
from dynasindy.sindy.world_model import all_or_nothing
from dynasindy.systems import Tras


def test_a_model_that_cannot_be_fitted_is_abstract():
    with pytest.raises(TypeError, match="abstract"):
        WorldModel(Tras().signature)


@pytest.mark.parametrize("make", [lambda p: Oracle(p.signature, p), lambda p: SindyModel(p.signature)])
def test_every_model_is_a_system_with_the_plants_signature(make, tmp_path):
    plant = Tras()
    model = make(plant)
    assert model.signature == plant.signature
    assert model(torch.zeros(4, 6), torch.zeros(4, 2)).shape == (4, 6)
    assert len(model.equations()) == 6
    model.save(tmp_path / "model.json")
    assert (tmp_path / "model.json").read_text().startswith("{")


def test_a_method_that_raises_leaves_what_is_named_as_it_was():
    class Sum:
        total, calls = 0, 0

        @all_or_nothing("total")
        def add(self, *numbers):
            self.calls += 1
            for number in numbers:
                self.total += number
            return self.total

    one = Sum()
    assert one.add(1, 2) == one.total == 3
    with pytest.raises(TypeError):
        one.add(4, "five")
    assert (one.total, one.calls) == (3, 2)
