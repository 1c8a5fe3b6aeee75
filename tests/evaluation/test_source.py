"""Data of a simulated plant are no log unless it is said."""

import torch

from dynasindy.evaluation.source import Source
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def test_a_source_is_simulated_and_without_notes_unless_it_is_said():
    data = Transitions.from_trajectory(torch.zeros(3, 1), torch.zeros(2, 1), 0.1)
    source = Source(Signature(("x",), ("m",), ("u",), (1.0,)), data, data)
    assert not source.logged and source.notes == ()
