"""A plant of which only names and units are known has a signature, and refuses to move."""

import pytest
import torch

from dynasindy.rig.simulated import rehearsal
from dynasindy.systems import BlackBox


def test_names_units_and_ends_are_those_that_were_given_in_their_order():
    plant = BlackBox({"h1": "cm", "h2": "cm"}, {"pump": [0, 12], "valve": [-1, 1]})
    signature = plant.signature
    assert signature.state_names == ("h1", "h2") and signature.state_units == ("cm", "cm")
    assert signature.x_scale == (1.0, 1.0)  # as nobody knows how far they go
    assert signature.input_names == ("pump", "valve") and signature.input_units == ()
    assert signature.in_own_units([[0, 0], [1, 1]]).tolist() == [[0, 0], [12, 1]]  # zero is 0 V, as in a log
    assert signature.input_limits == ((0.0, 1.0), (-1.0, 1.0))
    assert BlackBox({"angle": "rad"}, ["motor"]).signature.input_ends == ()


def test_nobody_knows_how_it_moves():
    plant = BlackBox({"angle": "rad"}, ["motor"])
    assert not plant.known
    with pytest.raises(RuntimeError, match="knows"):
        plant(torch.zeros(1), torch.zeros(1))
    with pytest.raises(ValueError, match="udp"), rehearsal(plant, 0.05):
        pass
