"""Plants that differ from the model as its margins say."""

import math

import pytest
import torch
from torch import nn

from dynasindy.planning.margins import MarginCost
from dynasindy.planning.rollout import InputStrength, Rows, imagine


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


def params(*targets):
    """Task parameters of steps to the targets."""
    return torch.tensor([[[target, 0.0, 0.0, 0.0, 0.0]] for target in targets])


def test_inputs_at_rest_hold_the_target_whatever_their_strength(inverted):
    env, rests = inverted()
    strength = InputStrength.of(env, rests, 0.2).draw(3, torch.Generator().manual_seed(0))
    # theta'' = 4 sin(theta) + 6 u
    wanted = [-4.0 / 6.0 * math.sin(target) for target in (-0.3, 0.0, 0.25)]
    (rest,) = strength.rest(params(-0.3, 0.0, 0.25), torch.rand(5, 3, 1))
    assert rest.flatten().tolist() == pytest.approx(wanted, abs=1e-3)
    assert torch.equal(strength.acting(rest, rest), rest) and 0.8 <= float(strength.factor.min()) < 1


def test_what_holds_a_reference_that_jumps_holds_it_after_the_jump_too(inverted):
    """A square wave of 0.2 rad that jumps down after 0.2 s, four periods, and a target that stays, in turn."""
    env, rests = inverted()
    moving = params(*[0.1] * 6)
    moving[::2, :, 1:] = torch.tensor([0.2, 2.5, 0.0, 1.0])
    strength = InputStrength.of(env, rests, 0.3).ends(6)

    def hold(observation):
        """Return what holds the reference of this moment."""
        return -4.0 / 6.0 * torch.sin(env.task.seen(observation)[1])

    rows = Rows(torch.zeros(6, 2), torch.zeros(6, 1), moving, torch.zeros(6, 1), strength=strength)
    flown = imagine(env, hold, rows, 8)
    targets = torch.tensor([0.3, 0.1] * 3).expand(8, 6).clone()
    targets[4:, ::2] = -0.1
    wanted = -4.0 / 6.0 * torch.sin(targets)
    torch.testing.assert_close(flown.applied[..., 0], wanted, atol=1e-3, rtol=0)


def test_a_one_sided_input_stays_one_sided_whatever_its_strength(inverted):
    """A pump of 0 to 12 V holds by a tenth of it: 20 % stronger it would draw 0.24 V where it is off."""
    env, rests = inverted()
    whole, down = InputStrength.of(env, rests, 0.2).ends(3), params(*[-0.15] * 3)
    (rest,) = whole.rest(down, torch.zeros(1, 3, 1))
    assert not whole.limits.isfinite().any()
    # The weakest, that of the model and the strongest, in turn.
    wanted = [part * 4 / 6 * math.sin(0.15) for part in (0.2, 0.0, -0.2)]
    assert whole.acting(torch.zeros(3, 1), rest).flatten().tolist() == pytest.approx(wanted, abs=1e-4)
    env.task = env.task.with_input_limits([[0.0], [1.0]])
    pump = InputStrength.of(env, rests, 0.2).ends(3)
    (rest,) = pump.rest(down, torch.zeros(1, 3, 1))
    assert float(rest[0]) == pytest.approx(4 / 6 * math.sin(0.15), abs=1e-3)
    assert float(pump.acting(torch.zeros(3, 1), rest).min()) == 0.0
    # A plant that is more sensitive to the whole of its input is as likely as before.
    stronger = float(rest[0]) + 1.2 * (1 - float(rest[0]))
    assert float(pump.acting(torch.ones(3, 1), rest).max()) == pytest.approx(stronger)


def test_no_strength_goes_beyond_an_actuator_that_ends():
    """A pump that cannot draw gives nothing where it would; by what it does not give nothing changes."""
    limits = torch.tensor([[0.0, -torch.inf], [torch.inf, 0.8]])
    rest = torch.full((3, 2), 0.4)
    strength = InputStrength(0.5, lambda *_: rest.unsqueeze(0), limits, torch.full((3, 2), 1.5))
    u = torch.tensor([[0.0, 0.0], [0.2, 0.9], [1.0, 0.6]], requires_grad=True)
    acting = strength.acting(u, rest)
    expected = torch.tensor([[0.0, -0.2], [0.1, 0.8], [1.3, 0.7]])
    torch.testing.assert_close(acting.detach(), expected)
    slopes = torch.autograd.grad(acting.sum(), u)[0]
    assert slopes.tolist() == strength.slope(acting).tolist() == [[0.0, 1.5], [1.5, 0.0], [1.5, 1.5]]
