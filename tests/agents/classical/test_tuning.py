"""The search: it finds a known optimum, and what it tunes tracks references that it was not tuned on."""

import pytest
import torch

from dynasindy.agents.classical import LQI, PID, Gains, Trial, Tuning, tuned_lqi, tuned_pid
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.metrics import tracking_metrics
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking

QUICK = Tuning(population=16, elites=4, draws=3, seconds=8.0)
WANTED = Step([[0.4, 0.25], [-0.3, -0.3]]).sample(torch.Size((2,)), torch.Generator())


def test_the_least_cost_is_found(monkeypatch):
    monkeypatch.setattr(Tuning, "cost", lambda self, trial, numbers: (numbers.log() - 1).square().sum((1, 2)))
    best = Tuning(population=40, draws=12).search(Trial(Xi(), WANTED), lambda numbers: numbers, ([0.1] * 3, [10.0] * 3))
    torch.testing.assert_close(best, torch.full((3,), torch.e, dtype=torch.float64), rtol=0.1, atol=0)


@pytest.mark.parametrize("tuned", [tuned_pid, tuned_lqi])
def test_tuned_controllers_settle_on_a_step_they_were_not_tuned_on(tuned):
    system = Xi()
    env = ControlEnv(system, Tracking(system.signature, Step([[-0.2, 0.3]])))
    rollout = env.rollout(400, tuned(Trial(system, WANTED), QUICK))
    last = (rollout["state"][-100:, :2] - rollout["reference"][-100:]).abs().mean(0)
    assert (last < 0.02).all()


def test_the_cost_is_that_of_the_flight():
    system, tuning = Xi(), Tuning(seconds=10.0, substeps=5, variation=0.0)
    gains = [torch.tensor(row, dtype=torch.float64) for row in ((5.0, 1.0), (0.2, 0.5), (1.0, 1.5), (-0.12, 0.21))]
    env = ControlEnv(system, Tracking(system.signature, Step([[0.4, 0.25]])), dtype=torch.float64)
    flown = env.rollout(200, PID(system.signature, Gains(*gains)))
    time = torch.arange(200) * 0.05
    metrics = tracking_metrics(time, flown["state"][:, :2], flown["reference"], flown["action"])
    many = Gains(*(row.expand(1, 1, 2) for row in gains))
    cost = tuning.cost(Trial(system, WANTED[:1]), PID(system.signature, many))
    torch.testing.assert_close(cost[0], sum(metrics[name].sum() for name in NAMES), rtol=1e-3, atol=0)


NAMES = ("rmse", "mean_abs_error", "steady_state_error")


def test_a_candidate_that_runs_away_costs_infinitely_much():
    zero = torch.zeros(1, 1, 2, dtype=torch.float64)

    class Runaway(Xi):
        def forward(self, x, u):
            return 1e3 * x * x + 1e3

    system = Runaway()
    system.stops = None
    assert torch.isinf(QUICK.cost(Trial(system, WANTED), PID(system.signature, Gains(zero, zero, zero, zero))))


def test_tuning_is_repeatable_and_depends_on_its_seed():
    quick = Tuning(population=6, elites=2, draws=1, seconds=1.0)
    gains = [tuned_pid(Trial(Xi(), WANTED), quick, seed).gains[0].tolist() for seed in (1, 1, 2)]
    assert gains[0] == gains[1]
    assert gains[0] != gains[2]


def test_tuned_weights_give_a_stabilising_gain():
    controller = tuned_lqi(Trial(Xi(), WANTED), Tuning(population=6, elites=2, draws=1, seconds=1.0))
    assert isinstance(controller, LQI) and controller.gain.shape == (2, 8)
