"""How strong inputs are, against the definition u_e + k (u - u_e) by hand."""

import torch

from dynasindy.planning.strength import Strength


def test_what_acts_is_the_distance_from_rest_times_the_factor():
    strength = Strength(torch.tensor([[0.5, 1.0], [1.1, 0.9]]), torch.tensor([[0.2, 0.2], [0.0, -0.5]]))
    u = torch.tensor([[1.0, -0.6], [-1.0, 0.5]])
    assert torch.allclose(strength.acting(u), torch.tensor([[0.6, -0.6], [-1.1, 0.4]]))
    # What holds the plant at rest does so whatever the factor.
    assert torch.equal(strength.acting(strength.rest), strength.rest)


def test_rows_that_are_new_take_the_strength_of_others():
    old = Strength(torch.ones(3, 2), torch.zeros(3, 2))
    fresh = Strength(torch.full((3, 2), 0.9), torch.full((3, 2), 0.3))
    mixed = old.where(torch.tensor([False, True, False]), fresh)
    assert mixed.factor.tolist() == Strength(torch.tensor([[1.0] * 2, [0.9] * 2, [1.0] * 2]), old.rest).factor.tolist()
    assert torch.equal(mixed.rest[1], fresh.rest[1]) and not mixed.rest[[0, 2]].any()
