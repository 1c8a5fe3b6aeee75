"""The linear model that catches a falling plant is the plant's own slope at its start, seen whole or by an encoder."""

from types import SimpleNamespace

import pytest
import torch
from torchrl.envs import TransformedEnv

from dynasindy.control import Observer
from dynasindy.control.sensing import Sensing
from dynasindy.dyna.excite import _fit_local_model, _interact
from dynasindy.envs import ControlEnv, RandomStep, Sensors, Tracking, TrackingReward
from dynasindy.systems import Signature, System

ENDS = torch.tensor([-0.5, -torch.inf]), torch.tensor([0.5, torch.inf])


class Inverted(System):
    """A pendulum measured from the top under a constant pull to one side: a = 40 sin(theta) - Omega + 60 u + 3."""

    def __init__(self):
        super().__init__(Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (0.5, 3.0)))

    def forward(self, x, u):
        theta, rate = x.unbind(-1)
        return torch.stack((rate, 40.0 * torch.sin(theta) - rate + 60.0 * u[..., 0] + 3.0), -1)


def parts(measured):
    plant = Inverted()
    task = Tracking(plant.signature, RandomStep([-0.2], [0.2]), ["theta"], [], TrackingReward((1.0,)))
    env = ControlEnv(plant, task, dtype=torch.float64)
    made = SimpleNamespace(plant=env, env=env, sensing=None)
    if measured:
        sensors = Sensors({"theta": {"resolution": 1.5e-3}}, rates={"theta": "Omega"})
        made.sensing = Sensing(env, Observer(Inverted(), sensors, env), torch.Generator().manual_seed(0))
        made.env = TransformedEnv(env, made.sensing.on(env, made.sensing.rng))
    return made


def tries(made, number):
    """Falls under random inputs."""
    generator = torch.Generator().manual_seed(3)

    def shaken(tensordict):
        return tensordict.set("action", 0.3 * torch.randn(1, generator=generator))

    return torch.cat([_interact(made.env, shaken, 40, ENDS) for _ in range(number)])


@pytest.mark.parametrize(("measured", "within"), [(False, 0.06), (True, 0.06)])
def test_slopes_are_those_of_the_plant_at_its_start(measured, within):
    made = parts(measured)
    found = _fit_local_model(tries(made, 6), made)
    assert found.home.tolist() == [0.0, 0.0]
    torch.testing.assert_close(found.a[0], torch.tensor([0.0, 1.0]).double(), atol=0.02, rtol=0.0)
    assert found.a[1, 0].item() == pytest.approx(40.0, rel=within)
    assert found.a[1, 1].item() == pytest.approx(-1.0, abs=1.0)
    assert found.b.flatten().tolist() == pytest.approx([0.0, 60.0], rel=within, abs=0.02)
    assert found.c.tolist() == pytest.approx([0.0, 3.0], abs=0.3)
    assert (found.model is None) != measured
    if measured:
        x, u = torch.tensor([[0.1, -0.4]]).double(), torch.tensor([[0.2]]).double()
        linear = x @ found.a.mT + u @ found.b.mT + found.c
        torch.testing.assert_close(found.model(x, u), linear)


@pytest.mark.parametrize("measured", [False, True])
def test_of_too_little_no_model_is_made(measured):
    made = parts(measured)
    assert _fit_local_model(tries(made, 1)[:1], made) is None  # five samples for four numbers an equation


def test_true_states_are_not_read_behind_an_encoder():
    made = parts(True)
    rows = tries(made, 4)
    blind = rows.clone()
    blind["true_state"].fill_(torch.nan)
    blind["next", "true_state"].fill_(torch.nan)
    assert torch.equal(_fit_local_model(rows, made).a, _fit_local_model(blind, made).a)
