"""How strong inputs are, against the definition u_e + k (u - u_e) by hand."""

import torch

from dynasindy.planning.randomization import InputStrength


def test_what_acts_is_the_distance_from_rest_times_the_factor():
    strength = InputStrength(torch.tensor([[0.5, 1.0], [1.1, 0.9]]), torch.tensor([[0.2, 0.2], [0.0, -0.5]]))
    u = torch.tensor([[1.0, -0.6], [-1.0, 0.5]])
    assert torch.allclose(strength.acting(u), torch.tensor([[0.6, -0.6], [-1.1, 0.4]]))
    # What holds the plant at rest does so whatever the factor.
    assert torch.equal(strength.acting(strength.rest), strength.rest)


def test_no_strength_goes_beyond_an_actuator_that_ends():
    """A pump that cannot draw gives nothing where it would; by what it does not give nothing changes."""
    limits = torch.tensor([[0.0, -torch.inf], [torch.inf, 0.8]])
    strength = InputStrength(torch.full((3, 2), 1.5), torch.full((3, 2), 0.4), limits)
    u = torch.tensor([[0.0, 0.0], [0.2, 0.9], [1.0, 0.6]], requires_grad=True)
    acting = strength.acting(u)
    expected = torch.tensor([[0.0, -0.2], [0.1, 0.8], [1.3, 0.7]])
    torch.testing.assert_close(acting.detach(), expected)
    slopes = torch.autograd.grad(acting.sum(), u)[0]
    assert slopes.tolist() == strength.slope(acting).tolist() == [[0.0, 1.5], [1.5, 0.0], [1.5, 1.5]]
    assert torch.equal(strength.where(torch.tensor([True, False, False]), strength).acting(u), acting)


def test_rows_that_are_new_take_the_strength_of_others():
    old = InputStrength(torch.ones(3, 2), torch.zeros(3, 2))
    fresh = InputStrength(torch.full((3, 2), 0.9), torch.full((3, 2), 0.3))
    mixed = old.where(torch.tensor([False, True, False]), fresh)
    assert (
        mixed.factor.tolist()
        == InputStrength(torch.tensor([[1.0] * 2, [0.9] * 2, [1.0] * 2]), old.rest).factor.tolist()
    )
    assert torch.equal(mixed.rest[1], fresh.rest[1]) and not mixed.rest[[0, 2]].any()
