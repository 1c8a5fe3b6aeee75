import torch

from dynasindy.sensing.observer import _Kinematic
from dynasindy.systems import Signature


def test_states_move_at_their_rates_and_otherwise_stay_whatever_the_input():
    system = _Kinematic(Signature(("a", "b", "va", "vb"), ("-",) * 4, ("u",), (1.0,) * 4), {0: 2, 1: 3})
    dx = system(torch.tensor([[1.0, 2.0, 3.0, 4.0]]), torch.tensor([[9.0]]))
    assert dx.tolist() == [[3.0, 4.0, 0.0, 0.0]]
