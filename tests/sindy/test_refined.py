"""What a refinement says of itself, and of what it set aside."""

import pytest
import torch

from dynasindy.sindy.fit_report import Refined
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems.base import Signature

LIBRARY = build_library(["y", "u"], Signature(("y",), ("m",), ("u",), (1.0,)))


@pytest.mark.parametrize(("delay", "at_end"), [(0.0, False), (0.94, False), (0.96, True), (1.0, True)])
def test_a_delay_within_half_a_sample_of_the_longest_is_at_its_end(delay, at_end):
    found = Refined(LIBRARY, torch.zeros(2, 1), delay, ("own",)).with_notes(("chosen",), longest=1.0, dt=0.1)
    assert found.delay_at_end == at_end and found.notes[:2] == ("chosen", "own")
    assert ("longest_delay=2," in found.notes[-1]) == at_end and len(found.notes) == 2 + at_end


def test_what_was_set_aside_is_told_of_by_its_own_delay():
    aside = Refined(LIBRARY, torch.ones(2, 1), 1.0, ("whole",))
    found = Refined(LIBRARY, torch.zeros(2, 1), 0.2, ("pieces",), aside=aside).with_notes(("chosen",), 1.0, 0.1)
    assert found.notes == ("chosen", "pieces") and not found.delay_at_end
    assert found.aside.notes[:2] == ("chosen", "whole") and found.aside.delay_at_end
