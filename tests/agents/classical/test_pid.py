"""PID: its law by hand."""

import pytest
import torch

from dynasindy.agents.classical import PID, Gains
from dynasindy.systems import Tras

GAINS = Gains((0.5, 0.6), (0.1, 0.2), (0.3, 0.4), (-0.1, 0.2))
REST = torch.zeros(2, dtype=torch.float64)


def test_law_equals_the_formula_by_hand():
    controller = PID(Tras().signature, GAINS)
    x = torch.tensor([[0.1, -0.2, 0.3, -0.4, 100.0, 200.0]]).double()
    reference = torch.tensor([[0.4, 0.2]]).double()
    rate = torch.tensor([[0.05, -0.1]]).double()
    first = controller.act(x, reference, rate, torch.tensor([[True]]))
    u_a = -0.1 + 0.5 * 0.3 + 0.3 * (0.05 - 0.3)
    u_p = 0.2 + 0.6 * 0.4 + 0.4 * (-0.1 - -0.4)
    torch.testing.assert_close(first, torch.tensor([[u_a, u_p]]).double(), atol=1e-6, rtol=0)
    second = controller.act(x, reference, rate, torch.tensor([[False]]))
    integrated = torch.tensor([[0.1 * 0.05 * 0.3, 0.2 * 0.05 * 0.4]]).double()
    torch.testing.assert_close(second - first, integrated, atol=1e-6, rtol=0)


def test_each_loop_holds_its_own_integral():
    controller = PID(Tras().signature, Gains((10.0, 0.1), (1.0, 1.0), (0.0, 0.0), (0.0, 0.0)))
    controller.act(torch.zeros(1, 6).double(), torch.full((1, 2), 0.5).double(), REST, torch.tensor([[True]]))
    torch.testing.assert_close(controller.integral, torch.tensor([[0.0, 0.025]]).double())


def test_gains_that_differ_between_rows_run_side_by_side():
    k_p = torch.tensor([[0.1, 0.2], [0.3, 0.4]])
    zero = torch.zeros(2)
    controller = PID(Tras().signature, Gains(k_p, zero, zero, zero))
    u = controller.act(torch.zeros(2, 6).double(), torch.ones(2, 2).double(), REST, torch.tensor([[True]]))
    torch.testing.assert_close(u, k_p.double())


def test_numbers_of_gains_must_fit():
    with pytest.raises(ValueError, match="give one of each per input"):
        PID(Tras().signature, Gains((1.0,), (1.0,), (1.0,), (1.0,)))
