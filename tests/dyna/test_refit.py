"""A refit is believed only where it predicts held-out data no worse."""

import math
from functools import partial

import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.loop import interact
from dynasindy.dyna.parts import Settings
from dynasindy.dyna.refit import fit, held_out_windows, refit
from dynasindy.envs import ControlEnv
from dynasindy.excitation import Chirp
from dynasindy.planning import Gate, NoPlanning, replay_error
from dynasindy.systems import Diverged, Xi
from dynasindy.tasks import RandomStep, Tracking
from dynasindy.world_models import Oracle


class Scaled(Oracle):
    """The plant with all rates times a buffer, which each fit sets to the next of given numbers."""

    def __init__(self, signature, factors):
        super().__init__(signature, Xi())
        self.register_buffer("factor", torch.tensor(1.0))
        self.factors, self.seen = list(factors), []

    def forward(self, x, u):
        return self.factor.to(x) * self.system(x, u)

    def fit(self, transitions):
        self.seen.append(transitions)
        self.factor = torch.tensor(self.factors.pop(0))
        return "report"


def setting(*factors, steps=80):
    parts = Recipe(
        system=Xi(),
        task=partial(Tracking, reference=RandomStep([-0.5, -0.5], [0.5, 0.4]), max_steps=steps),
        env=ControlEnv,
        excitation=partial(Chirp, duration=1.0),
        world_model=partial(Scaled, factors=factors),
        agent=partial(TD3, hidden=(8,)),
        replay=partial(DynaReplay, 200, 16),
        planning=NoPlanning,
        gate=Gate(),
        train=Settings(1),
    ).build()
    rollout = interact(parts.env, parts.agent.explore, steps)
    parts.replay.extend_real(rollout)
    return parts, rollout


def test_a_worse_refit_is_rolled_back_and_a_better_one_stays():
    parts, rollout = setting(1.5, 1.2, 1.0)
    fit(parts, Settings(1))
    better, best = refit(parts, Settings(1), rollout), refit(parts, Settings(1), rollout)
    assert better.kept and best.kept
    assert best.error.state_error == best.error_after and best.error.reward_error < better.error.reward_error
    assert best.error_after < 1e-4 < best.error_before == better.error_after < better.error_before

    parts, rollout = setting(1.0, 1.5)
    fit(parts, Settings(1))
    worse = refit(parts, Settings(1), rollout)
    assert not worse.kept and worse.error_after > worse.error_before
    assert worse.error.state_error == worse.error_before  # the gate judges the model that stays
    assert parts.world_model.factor == 1.0


def test_a_refit_that_diverges_is_rolled_back():
    parts, rollout = setting(1.2, math.nan)
    fit(parts, Settings(1))
    result = refit(parts, Settings(1), rollout)
    assert not result.kept and result.error_after == math.inf
    assert parts.world_model.factor == pytest.approx(1.2)


def test_the_held_out_windows_are_in_no_fit_before_the_next():
    parts, rollout = setting(1.0, 1.0)
    refit(parts, Settings(1), rollout)
    (seen,) = parts.world_model.seen
    assert len(seen) == 60 * 5  # the last of four seconds is held out
    held = rollout["next", "state"][60:].to(seen.x_next)
    assert not (seen.x_next.unsqueeze(1) == held).all(-1).any()
    fit(parts, Settings(1))
    assert len(parts.world_model.seen[1]) == 80 * 5


def test_without_a_test_every_refit_stays():
    parts, rollout = setting(1.0, 9.0)
    fit(parts, Settings(1))
    unseen = replay_error(parts.model_env, rollout)
    result = refit(parts, Settings(1, held_out=0), rollout)
    assert result.error.reward_error == unseen.reward_error  # the whole episode, before the fit has read it
    assert result.kept and math.isnan(result.error_before)
    assert parts.world_model.factor == 9.0 and len(parts.world_model.seen[1]) == 80 * 5


def test_recent_steps_and_held_out_windows_go_together():
    parts, rollout = setting(1.0)
    refit(parts, Settings(1, recent_steps=30), rollout)
    assert len(parts.world_model.seen[0]) == 10 * 5


def test_every_fourth_window_is_held_out():
    assert held_out_windows(400, 20, 4).tolist() == [60, 140, 220, 300, 380]
    assert held_out_windows(79, 20, 4).tolist() == []
    assert held_out_windows(400, 20, 0).tolist() == []


@pytest.mark.parametrize("factor", [math.nan, math.inf])
def test_a_fit_that_is_not_finite_is_told_with_the_model(factor):
    parts, _ = setting(1.0, factor)
    assert fit(parts, Settings(1)) == "report"
    with pytest.raises(Diverged, match=r"model learning: the fit to 80 real steps left factor .* in Scaled"):
        fit(parts, Settings(1))


def test_without_a_test_a_refit_that_is_not_finite_ends_the_phase():
    parts, rollout = setting(1.0, math.nan)
    fit(parts, Settings(1))
    with pytest.raises(Diverged, match="model learning"):
        refit(parts, Settings(1, held_out=0), rollout)
