"""PID: its law by hand, its tuning by what it is for."""

import pytest
import torch

from dynasindy.agents.classical import PID, Gains, Tuning
from dynasindy.envs import ControlEnv
from dynasindy.systems import Tras, Xi
from dynasindy.tasks import Step, Tracking

GAINS = Gains((0.5, 0.6), (0.1, 0.2), (0.3, 0.4), (-0.1, 0.2))
QUICK = Tuning(population=16, elites=4, draws=3, seconds=8.0)


def test_law_equals_the_formula_by_hand():
    controller = PID(Tras().signature, GAINS)
    x = torch.tensor([[0.1, -0.2, 0.3, -0.4, 100.0, 200.0]]).double()
    reference = torch.tensor([[0.4, 0.2]]).double()
    first = controller.act(x, reference, torch.tensor([[True]]))
    u_a = -0.1 + 0.5 * 0.3 - 0.3 * 0.3
    u_p = 0.2 + 0.6 * 0.4 - 0.4 * -0.4
    torch.testing.assert_close(first, torch.tensor([[u_a, u_p]]).double(), atol=1e-6, rtol=0)
    second = controller.act(x, reference, torch.tensor([[False]]))
    integrated = torch.tensor([[0.1 * 0.05 * 0.3, 0.2 * 0.05 * 0.4]]).double()
    torch.testing.assert_close(second - first, integrated, atol=1e-6, rtol=0)


def test_each_loop_holds_its_own_integral():
    controller = PID(Tras().signature, Gains((10.0, 0.1), (1.0, 1.0), (0.0, 0.0), (0.0, 0.0)))
    controller.act(torch.zeros(1, 6).double(), torch.full((1, 2), 0.5).double(), torch.tensor([[True]]))
    torch.testing.assert_close(controller.integral, torch.tensor([[0.0, 0.025]]).double())


def test_gains_that_differ_between_rows_run_side_by_side():
    k_p = torch.tensor([[0.1, 0.2], [0.3, 0.4]])
    zero = torch.zeros(2)
    controller = PID(Tras().signature, Gains(k_p, zero, zero, zero))
    u = controller.act(torch.zeros(2, 6).double(), torch.ones(2, 2).double(), torch.tensor([[True]]))
    torch.testing.assert_close(u, k_p.double())


def test_tuned_gains_settle_on_steps_they_were_not_tuned_on():
    system = Xi()
    gains = QUICK.run(system, torch.tensor([[0.4, 0.25], [-0.3, -0.3]]))
    env = ControlEnv(system, Tracking(system.signature, Step([[-0.2, 0.3]])))
    rollout = env.rollout(400, PID(system.signature, gains))
    last = (rollout["state"][-100:, :2] - rollout["reference"][-100:]).abs().mean(0)
    assert (last < 0.02).all()


def test_tuning_is_repeatable_and_depends_on_its_seed():
    quick = Tuning(population=6, elites=2, draws=1, seconds=1.0)
    references = torch.tensor([[0.3, 0.2]])
    runs = [quick.run(Xi(), references, seed=seed) for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_numbers_of_gains_must_fit():
    with pytest.raises(ValueError, match="give one of each per input"):
        PID(Tras().signature, Gains((1.0,), (1.0,), (1.0,), (1.0,)))
