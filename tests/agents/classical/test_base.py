"""What tracking controllers share."""

import pytest
import torch
from tensordict import TensorDict

from dynasindy.agents.classical.base import TrackingController
from dynasindy.systems import Tras


class Constant(TrackingController):
    """Ask for 2 on the first input and for the integral on the second."""

    def unlimited(self, x, reference, integral):
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
