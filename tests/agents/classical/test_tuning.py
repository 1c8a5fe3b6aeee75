"""The search: it finds a known optimum, and what it tunes tracks references that it was not tuned on."""

import numpy as np
import pytest
import torch

from dynasindy.agents.classical import LQI, PID, Gains, Trial, Tuning, tuned_lqi, tuned_pid
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.metrics import tracking_metrics
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking, Wave

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
    system, tuning = Xi(), Tuning(seconds=20.0, substeps=5, variation=0.0)
    gains = [torch.tensor(row, dtype=torch.float64) for row in ((5.0, 1.0), (0.2, 0.5), (1.0, 1.5), (-0.12, 0.21))]
    env = ControlEnv(system, Tracking(system.signature, Step([[0.4, 0.25]])), dtype=torch.float64)
    flown = env.rollout(400, PID(system.signature, Gains(*gains)))
    time = torch.arange(400) * 0.05
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


def test_weights_without_a_stabilising_gain_lose(monkeypatch):
    """Every second candidate of six has none: it costs infinitely much, and the search goes on among the others."""
    riccati, cost, costs, calls = LQI.riccati, Tuning.cost, [], []

    def every_second(self, *weights):
        calls.append(weights)
        if len(calls) in (3, 5, 7):  # the first is that of the controller that begins the search
            raise ValueError("no gain")
        return riccati(self, *weights)

    monkeypatch.setattr(LQI, "riccati", every_second)
    monkeypatch.setattr(Tuning, "cost", lambda *given: costs.append(cost(*given)) or costs[-1])
    controller = tuned_lqi(Trial(Xi(), WANTED), Tuning(population=6, elites=2, draws=1, seconds=1.0))
    assert controller.gain.isfinite().all()
    assert costs[0].isinf().tolist() == [False, True] * 3


def test_the_cost_of_each_candidate_is_that_of_a_loop_over_its_flights():
    """Two candidates on a step, a sine and a square that jumps 3 s before the end: only the step has settled."""
    system, tuning = Xi(), Tuning(seconds=12.0, substeps=2, variation=0.7)
    waves = [Step([[0.3, 0.2]]), Wave([0.1, 0.1], [0.1, 0.05]), Wave([0.1, 0.1], [1 / 18, 1 / 18], "square")]
    wanted = torch.cat([wave.sample(torch.Size((1,)), torch.Generator()) for wave in waves])
    rows = [[(5.0, 1.0), (0.2, 0.5), (1.0, 1.5)], [(3.0, 2.0), (0.1, 0.3), (0.5, 1.0)]]
    bias = torch.tensor([-0.12, 0.21], dtype=torch.float64)
    expected = []
    for row in rows:
        costs, changes = [], []
        for wave in waves:
            task = Tracking(system.signature, wave)
            env = ControlEnv(system, task, substeps=2, dtype=torch.float64)
            flown = env.rollout(240, PID(system.signature, Gains(*row, bias)))
            error = (flown["reference"] - flown["state"][:, :2]).abs()
            cost = error.square().mean(0).sqrt() + error.mean(0)
            if wave is waves[0]:
                cost = cost + error[-100:].mean(0)
            costs.append(cost.sum())
            changes.append(flown["action"].double().diff(dim=0).square().sum(-1).mean())
        expected.append(sum(costs) / 3 + 0.7 * sum(changes) / 3)
    gains = [torch.tensor([row[i] for row in rows], dtype=torch.float64).unsqueeze(1) for i in range(3)]
    cost = tuning.cost(Trial(system, wanted), PID(system.signature, Gains(*gains, bias)))
    torch.testing.assert_close(cost, torch.stack(expected), rtol=1e-4, atol=0)


def test_the_search_is_the_cross_entropy_method_by_a_loop(monkeypatch):
    monkeypatch.setattr(Tuning, "cost", lambda self, trial, numbers: (numbers.log() - 1).square().sum((1, 2)))
    tuning, ends = Tuning(population=7, elites=3, draws=4), ([0.1, 0.5], [10.0, 2.0])
    best = tuning.search(Trial(Xi(), WANTED), lambda numbers: numbers, ends, seed=5)
    rng = torch.Generator().manual_seed(5)
    low, high = np.log(ends[0]), np.log(ends[1])
    centre, spread = (low + high) / 2, (high - low) / 4  # the ends are two standard deviations away
    for _ in range(4):
        drawn = centre + spread * torch.randn(7, 2, generator=rng, dtype=torch.float64).numpy()
        elite = drawn[np.argsort(((drawn - 1) ** 2).sum(1))[:3]]
        centre, spread = elite.mean(0), elite.std(0, ddof=1) + 0.02
    np.testing.assert_allclose(best.numpy(), np.exp(centre), rtol=1e-9)


def test_what_is_searched_for_pid_are_three_gains_per_output_about_the_input_at_rest(monkeypatch):
    seen = []

    def search(self, trial, build, ends, seed):
        seen.append((ends, seed))
        return torch.tensor([1.0, 2.0, 0.1, 0.2, 3.0, 4.0], dtype=torch.float64)

    monkeypatch.setattr(Tuning, "search", search)
    controller = tuned_pid(Trial(Xi(), WANTED, dt=0.1), seed=3)
    k_p, k_i, k_d, bias = (gain.flatten().tolist() for gain in controller.gains)
    assert (k_p, k_i, k_d, controller.dt) == ([1, 2], [0.1, 0.2], [3, 4], 0.1)
    assert bias == pytest.approx([-0.122, 0.210], abs=1e-3)  # xi at pitch 0
    assert seen == [(([0.1, 0.1, 0.01, 0.01, 0.1, 0.1], [10.0, 10.0, 3.0, 3.0, 10.0, 10.0]), 3)]


def test_what_is_searched_for_lqi_are_weights_of_outputs_rates_and_integrals(monkeypatch):
    seen = []

    def search(self, trial, build, ends, seed):
        seen.append((ends, seed))
        side_by_side = build(torch.tensor([[[9.0, 8.0, 0.5, 0.4, 7.0, 6.0]], [[1.0] * 6]], dtype=torch.float64)).gain
        assert side_by_side.shape == (2, 1, 2, 8) and not torch.equal(side_by_side[0], side_by_side[1])
        return torch.tensor([9.0, 8.0, 0.5, 0.4, 7.0, 6.0], dtype=torch.float64)

    monkeypatch.setattr(Tuning, "search", search)
    controller = tuned_lqi(Trial(Xi(), WANTED), seed=4)
    # The angles' and rates' ranges are 1, so the weights of LQI's constructor are the same numbers.
    expected = LQI(Xi(), state_weights=(9.0, 8.0, 0.5, 0.4, 0.0, 0.0), integral_weights=(7.0, 6.0))
    torch.testing.assert_close(controller.gain, expected.gain)
    assert seen == [(([1.0, 1.0, 0.01, 0.01, 1.0, 1.0], [3000.0] * 2 + [100.0] * 2 + [3000.0] * 2), 4)]
