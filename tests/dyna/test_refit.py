"""A refit is believed only where it predicts held-out data no worse."""

import math
from dataclasses import replace
from functools import cache, partial

import pytest
import torch
from recipes import make_recipe
from tensordict import TensorDict

from dynasindy.agents import DynaReplay
from dynasindy.dyna.excite import _interact
from dynasindy.dyna.experiment import LoopSettings
from dynasindy.dyna.refit import _acting, _fit, _held_out_windows, first_fit, refit
from dynasindy.envs import Tracking
from dynasindy.planning import ModelError, replay_error
from dynasindy.sindy import Oracle, SindyModel
from dynasindy.systems import Diverged, Xi
from dynasindy.systems.transitions import Transitions


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


def built(*factors, steps=80):
    replay, model = partial(DynaReplay, 200, 16), partial(Scaled, factors=factors)
    return make_recipe(Xi(), steps, world_model=model, replay=replay).build()


@cache
def flown():
    parts = built()
    return _interact(parts.env, parts.agent.explore, 80)


def setting(*factors):
    parts, rollout = built(*factors), flown().clone()
    parts.replay.extend_real(rollout)
    return parts, rollout


def test_a_worse_refit_is_rolled_back_and_a_better_one_stays():
    parts, rollout = setting(1.5, 1.2, 1.0)
    _fit(parts)
    better, best = refit(parts, LoopSettings(1), rollout), refit(parts, LoopSettings(1), rollout)
    assert better.kept and best.kept
    assert best.error.state_error == best.error_after and best.error.reward_error < better.error.reward_error
    assert best.error_after < 1e-4 < best.error_before == better.error_after < better.error_before

    parts, rollout = setting(1.0, 1.5)
    _fit(parts)
    worse = refit(parts, LoopSettings(1), rollout)
    assert not worse.kept and worse.error_after > worse.error_before
    assert worse.error.state_error == worse.error_before  # the gate judges the model that stays
    assert parts.world_model.factor == 1.0


class Learning(Tracking):
    """A task that pays more for everything after each fit."""

    own, learnt = True, 0

    def learn(self, *_):
        self.learnt += 1

    def earned(self, *given):
        return (1 + self.learnt) * super().earned(*given)


@pytest.mark.parametrize(("factor", "learnt", "kept"), [(1.5, 2, False), (1.0, 2, True), (math.nan, 1, False)])
def test_what_a_task_learns_stays_and_the_gate_judges_the_model_that_stays_by_it(factor, learnt, kept):
    parts, rollout = setting(1.0, factor)
    parts.plant.task.__class__ = Learning
    _fit(parts)
    result = refit(parts, LoopSettings(1), rollout)
    assert (result.kept, parts.plant.task.learnt, parts.world_model.factor) == (kept, learnt, 1.0)
    starts = _held_out_windows(rollout.numel(), 20, 4)
    assert result.error.reward_error == replay_error(parts.model_env, rollout, starts, 20).reward_error


def test_without_a_test_every_refit_stays():
    parts, rollout = setting(1.0, 9.0)
    _fit(parts)
    unseen = replay_error(parts.model_env, rollout)
    result = refit(parts, LoopSettings(1, held_out=0), rollout)
    assert result.error.reward_error == unseen.reward_error  # the whole episode, before the fit has read it
    assert result.kept and math.isnan(result.error_before)
    assert parts.world_model.factor == 9.0 and len(parts.world_model.seen[1]) == 80 * 5


@pytest.mark.parametrize(("periods", "at_stop", "judged"), [(1, False, 1), (1, True, 0), (9, True, 8), (9, False, 9)])
def test_a_period_in_which_a_short_episode_ends_at_a_stop_tells_nothing_of_the_model(periods, at_stop, judged):
    parts, rollout = setting(1.0, 1.0)
    _fit(parts)
    rollout = rollout[:periods].clone()
    rollout["next", "at_stop"][-1] = at_stop
    expected = replay_error(parts.model_env, rollout[:judged]).reward_error if judged else math.nan
    assert refit(parts, LoopSettings(1), rollout).error.reward_error == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("factor", [math.nan, math.inf])
def test_a_fit_that_is_not_finite_is_told_with_the_model(factor):
    parts, _ = setting(1.0, factor)
    assert _fit(parts) == "report"
    with pytest.raises(Diverged, match="learning"):
        _fit(parts)


def samples_of(rollout, steps):
    """Ends of all logged samples of the given control periods, and the inputs held in them."""
    rows = rollout[torch.tensor(steps)]
    return rows["next", "samples"].flatten(0, 1).double(), rows["action"].repeat_interleave(5, 0).double()


@pytest.mark.parametrize(
    ("held_out", "used"),
    [
        (0, [*range(80)]),
        (2, [*range(20), *range(40, 60)]),
        (3, [*range(40), *range(60, 80)]),
        (4, [*range(60)]),  # the last second, periods 60 to 79, is held out
    ],
)
def test_a_refit_reads_all_periods_but_the_held_out_ones(held_out, used):
    parts, rollout = setting(1.0)
    refit(parts, LoopSettings(1, held_out=held_out), rollout)
    (seen,) = parts.world_model.seen
    ends, inputs = samples_of(rollout, used)
    assert torch.equal(seen.x_next, ends) and torch.equal(seen.u, inputs)
    assert seen.dt == 0.01  # five samples per period of 0.05 s


@pytest.mark.parametrize(
    ("before", "after", "kept"),
    [(1.0, 1.09, True), (1.0, 1.11, False), (1.0, 0.5, True), (0.0, 0.9e-5, True), (0.0, 1.1e-5, False)],
)
def test_a_refit_may_be_a_tenth_worse_or_off_by_what_no_plan_feels(monkeypatch, before, after, kept):
    parts, rollout = setting(2.0, 3.0)
    _fit(parts)
    errors = iter([ModelError(0.1, before, torch.zeros(0)), ModelError(0.2, after, torch.zeros(0))])
    monkeypatch.setattr("dynasindy.dyna.refit.replay_error", lambda *_: next(errors))
    result = refit(parts, LoopSettings(1), rollout)
    assert result.kept == kept and parts.world_model.factor == (3.0 if kept else 2.0)
    assert result.error.reward_error == (0.2 if kept else 0.1)


@pytest.mark.parametrize(
    ("later", "expected"),
    [
        (0.0, [1, 2, 3, 4]),
        (1.0, [0, 1, 2, 3]),
        (1.5, [0, 0.5, 1.5, 2.5]),
        (-1.0, [2, 3, 4, 4]),
        (0.25, [0.75, 1.75, 2.75, 3.75]),
    ],
)
def test_inputs_act_as_much_later_as_a_model_says(later, expected):
    """An input that arrives within a period acts by its mean there; before the episode inputs were zero."""
    rollout = TensorDict({"action": torch.tensor([[1.0], [2.0], [3.0], [4.0]])}, [4])
    assert _acting(rollout, later)["action"].flatten().tolist() == expected


def test_a_refit_that_is_taken_back_leaves_its_data_to_the_next(monkeypatch):
    parts = built()
    model = SindyModel(Xi().signature)
    parts = replace(parts, world_model=model, model_env=parts.plant.with_system(model, torch.float32))
    excited = _interact(parts.env, parts.agent.explore, 80)
    parts.replay.extend_real(excited)
    first_fit(parts, excited)
    kept, before = model.coefficients.clone(), model.samples
    errors = iter([ModelError(0.0, 1e-3, torch.zeros(1, 6)), ModelError(0.0, 1.0, torch.zeros(1, 6))])
    monkeypatch.setattr("dynasindy.dyna.refit.replay_error", lambda *given: next(errors))
    rollout = _interact(parts.env, parts.agent.explore, 80)
    parts.replay.extend_real(rollout)
    assert not refit(parts, LoopSettings(1), rollout).kept
    assert torch.equal(model.coefficients, kept)
    first_fit(parts, rollout)
    assert model.samples == before + len(Transitions.from_periods(rollout, parts.model_env.log_dt))
