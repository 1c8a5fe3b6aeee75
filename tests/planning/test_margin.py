"""Inputs that are weaker or stronger: around the rest of a pendulum in closed form, and what a policy makes of them."""

import math

import pytest
import torch

from dynasindy.planning.randomization import GainMargin
from dynasindy.planning.rollout import Rows, imagine


def params(*targets):
    """Task parameters of steps to the targets."""
    return torch.tensor([[[target, 0.0, 0.0, 0.0, 0.0]] for target in targets])


def test_inputs_at_rest_hold_the_target_whatever_their_strength(inverted):
    env, rests = inverted()
    strength = GainMargin.of(env, rests, 0.2).draw(params(-0.3, 0.0, 0.25), torch.Generator().manual_seed(0))
    # theta'' = 4 sin(theta) + 6 u
    wanted = [-4.0 / 6.0 * math.sin(target) for target in (-0.3, 0.0, 0.25)]
    assert strength.rest.flatten().tolist() == pytest.approx(wanted, abs=1e-3)
    assert torch.equal(strength.acting(strength.rest), strength.rest)


def test_what_holds_a_reference_that_jumps_holds_it_after_the_jump_too(inverted):
    """A square wave of 0.2 rad that jumps down after 0.2 s, four periods, and a target that stays, in turn."""
    env, rests = inverted()
    moving = params(*[0.1] * 6)
    moving[::2, :, 1:] = torch.tensor([0.2, 2.5, 0.0, 1.0])
    strength = GainMargin.of(env, rests, 0.3).ends(moving)

    def hold(observation):
        """Return what holds the reference of this moment."""
        return -4.0 / 6.0 * torch.sin(env.task.seen(observation)[1])

    rows = Rows(torch.zeros(6, 2), torch.zeros(6, 1), moving, torch.zeros(6, 1), strength=strength)
    flown = imagine(env, env.system, hold, rows, 8)
    targets = torch.tensor([0.3, 0.1] * 3).expand(8, 6).clone()
    targets[4:, ::2] = -0.1
    wanted = -4.0 / 6.0 * torch.sin(targets)
    torch.testing.assert_close(flown.applied[..., 0], wanted, atol=1e-3, rtol=0)
    assert GainMargin.of(env, rests, 0.3).ends(params(0.1, 0.2)).along is None


def test_strengths_fill_the_share_evenly_and_go_no_further(inverted):
    env, rests = inverted()
    many = GainMargin.of(env, rests, 0.2).draw(params(*[0.1] * 4000), torch.Generator().manual_seed(1)).factor
    assert 0.8 <= many.min() < 0.801 and 1.199 < many.max() <= 1.2
    # Of a uniform distribution of half width w: mean 1, deviation w / sqrt(3).
    assert many.mean().item() == pytest.approx(1.0, abs=0.006)
    assert many.std().item() == pytest.approx(0.2 / math.sqrt(3), rel=0.03)


def test_a_policy_is_tested_with_the_weakest_the_model_s_and_the_strongest_inputs(inverted):
    env, rests = inverted()
    ends = GainMargin.of(env, rests, 0.2).ends(params(*[0.1] * 6)).factor.flatten().tolist()
    assert ends == pytest.approx([0.8, 1.0, 1.2, 0.8, 1.0, 1.2])


def test_there_is_no_margin_where_none_is_asked_for_and_where_nothing_is_regulated(inverted):
    env, rests = inverted()
    assert GainMargin.of(env, rests, 0.0) is None and GainMargin.of(env, None, 0.1) is None
    dead, none = inverted(pull=0.0)
    assert GainMargin.of(dead, none, 0.1) is None


def test_a_one_sided_input_stays_one_sided_whatever_its_strength(inverted):
    """A pump of 0 to 12 V holds by a tenth of it: 20 % stronger it would draw 0.24 V where it is off."""
    env, rests = inverted()
    whole = GainMargin.of(env, rests, 0.2).ends(params(*[-0.15] * 3))
    assert whole.limits is None
    assert float(whole.acting(torch.zeros(3, 1)).min()) == pytest.approx(-0.2 * 4 / 6 * math.sin(0.15), abs=1e-4)
    env.task = env.task.with_input_limits([[0.0], [1.0]])
    pump = GainMargin.of(env, rests, 0.2).ends(params(*[-0.15] * 3))
    assert float(pump.rest[0]) == pytest.approx(4 / 6 * math.sin(0.15), abs=1e-3)
    assert float(pump.acting(torch.zeros(3, 1)).min()) == 0.0
    # A plant that is more sensitive to the whole of its input is as likely as before.
    stronger = float(pump.rest[0]) + 1.2 * (1 - float(pump.rest[0]))
    assert float(pump.acting(torch.ones(3, 1)).max()) == pytest.approx(stronger)
