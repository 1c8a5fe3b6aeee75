"""What tracking controllers share."""

import pytest
import torch
from tensordict import TensorDict

from dynasindy.agents.classical.base import TrackingController
from dynasindy.systems import Tras
from dynasindy.tasks import Wave


class Constant(TrackingController):
    """Ask for 2 on the first input and for the integral on the second."""

    def unlimited(self, x, reference, rate, integral):
        return torch.stack((torch.full_like(x[..., 0], 2.0), integral[..., 1]), -1)

    def held(self, saturated):
        return saturated


def test_inputs_are_limited_and_only_their_integrals_held():
    controller = Constant(Tras().signature, ("alpha_a", "alpha_p"), dt=0.1)
    for step in range(4):
        td = TensorDict(
            {
                "state": torch.zeros(1, 6),
                "reference": torch.tensor([[0.5, 0.3]]),
                "step_count": torch.tensor([[step]]),
            },
            [1],
        )
        action = controller(td)["action"]
    assert action.dtype == torch.float32
    torch.testing.assert_close(action, torch.tensor([[1.0, 3 * 0.1 * 0.3]]))
    torch.testing.assert_close(controller.integral, torch.tensor([[0.0, 4 * 0.1 * 0.3]]).double())


@pytest.mark.parametrize("dt", [0.0, -0.05, float("nan")])
def test_control_period_must_be_positive(dt):
    with pytest.raises(ValueError, match="give a time > 0 s"):
        Constant(Tras().signature, ("alpha_a", "alpha_p"), dt=dt)


class Rates(Constant):
    """Ask for the rate of the reference."""

    def unlimited(self, x, reference, rate, integral):
        return rate


@pytest.mark.parametrize(("shape", "moves"), [("sine", True), ("square", False)])
def test_the_rate_of_the_reference_is_its_slope_and_zero_across_jumps(shape, moves):
    params = Wave([0.4, 0.2], [0.1, 0.05], shape).sample(torch.Size((1,)), torch.Generator())
    seen = {"state": torch.zeros(1, 6), "reference": torch.zeros(1, 2), "step_count": torch.tensor([[20]])}
    action = Rates(Tras().signature, ("alpha_a", "alpha_p"), dt=0.1)(TensorDict({**seen, "task_params": params}, [1]))
    turns = 2 * torch.pi * torch.tensor([[0.1, 0.05]])
    slope = torch.tensor([[0.4, 0.2]]) * turns * torch.cos(turns * 2.0)
    torch.testing.assert_close(action["action"], slope * moves)
    bare = Rates(Tras().signature, ("alpha_a", "alpha_p"), dt=0.1)(TensorDict(seen, [1]))
    assert not bare["action"].any()
