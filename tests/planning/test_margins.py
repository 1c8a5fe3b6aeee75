"""Margins that a policy lacks at rest in the model."""

import pytest
import torch
from torch import nn

from dynasindy.planning.margins import MarginCost


@pytest.mark.parametrize(("times", "lacking"), [(0.9, True), (1.7, True), (3.0, False)])
def test_a_law_near_the_least_that_holds_a_pendulum_lacks_margin_and_is_made_stronger(inverted, times, lacking):
    """Where theta'' = 4 sin(theta) + 6 u, u = -k theta holds it from k = 2/3 on; half of it is to do so, too."""
    env, rests = inverted()
    law = nn.Linear(env.task.n_o, 1, bias=False)
    scale = torch.tensor(env.task.signature.x_scale)
    with torch.no_grad():
        law.weight[:] = torch.cat([-torch.tensor([times * 2 / 3, 0.5]) * scale, torch.zeros(1)])
    law.weight.grad = torch.tensor([[0.0, 0.0, 1.0]])
    cost = MarginCost(env, rests)
    cost.select(law)
    cost.add_gradient(law)
    (of_angle, _, of_error), lacks = law.weight.grad[0].tolist(), len(cost.followed) > 0
    assert lacks == lacking and (of_angle > 0) == lacking
    # The episodes' own direction stays the larger part.
    assert (law.weight.grad[0] - torch.tensor([0.0, 0.0, 1.0])).norm() < 0.51 and of_error > 0.5
