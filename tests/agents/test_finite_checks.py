"""The first number on the plant that is not finite is the one that is told."""

import math

import pytest
import torch

from dynasindy.agents.replay import require_finite_rollout
from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward
from dynasindy.systems import Diverged, Signature, System

SIGNATURE = Signature(("angle", "rate"), ("rad", "rad/s"), ("torque",), (1.0, 1.0))


class Mass(System):
    """A mass whose rate grows by one per second until the angle passes an edge, and that is then nowhere."""

    def __init__(self, edge=math.inf, beyond=math.nan):
        super().__init__(SIGNATURE)
        self.edge, self.beyond = edge, beyond

    def forward(self, x, u):
        angle, rate = x.unbind(-1)
        return torch.stack([rate, torch.where(angle > self.edge, self.beyond, 1.0 + 0 * u[..., 0])], -1)


def env_of(plant):
    task = Tracking(SIGNATURE, Step([[0.5]]), outputs=["angle"], rates=["rate"], reward=TrackingReward((4.0,)))
    task.initial_state = lambda batch, rng: torch.zeros(*batch, 2)
    return ControlEnv(plant, task, dt=0.1, substeps=2, dtype=torch.float64)


def flown(plant, spoil=None):
    rollout = env_of(plant).rollout(30, lambda td: td.set("action", torch.full((1,), 0.25)))
    if spoil:
        key, value = spoil
        rollout[key][7] = value
    return rollout


@pytest.mark.parametrize("beyond", [math.nan, math.inf])
def test_a_plant_that_leaves_all_bounds_is_told_with_the_state_that_it_left_from(beyond):
    # 0.5 t^2 passes 0.605 in the twelfth control period of 0.1 s, which begins at rate 1.1 rad/s.
    with pytest.raises(Diverged, match="moves"):
        require_finite_rollout(flown(Mass(0.61, beyond)))
    require_finite_rollout(flown(Mass()))


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("observation", "the observation is .* from state"),
        ("action", "the policy's action is .* from observation .* check the policy's weights"),
        (("next", "state"), "the plant ends at"),
        (("next", "reward"), r"the reward is \[nan\], from state"),
        (("next", "observation"), "the observation is"),
    ],
)
def test_each_cause_is_told_by_its_name(key, told):
    with pytest.raises(Diverged, match="period 8 "):
        require_finite_rollout(flown(Mass(), (key, math.nan)), "evaluation")


def test_an_action_that_is_nowhere_is_not_laid_on_the_plant():
    rollout = flown(Mass(), ("action", math.nan))
    rollout["next", "state"][7:] = math.nan
    with pytest.raises(Diverged, match="policy"):
        require_finite_rollout(rollout)


def test_sensors_may_miss_what_is_there_but_tell_nothing_infinite():
    """NaN is what was not measured; infinity is no measurement, and may be all that is wrong in a rollout."""
    rollout = flown(Mass())
    rollout["measurement"] = torch.full_like(rollout["state"], math.nan)
    rollout["next", "samples"][3, 1, 0] = math.nan
    require_finite_rollout(rollout)
    rollout["next", "samples"][7, 0, 1] = -math.inf
    with pytest.raises(Diverged, match="moves"):
        require_finite_rollout(rollout)
