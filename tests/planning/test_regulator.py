"""The regulator of the linearisation against its Riccati equation, and what a policy makes of it."""

import math

import numpy as np
import pytest
import torch
from scipy.linalg import expm, solve_discrete_are
from torch import nn

from dynasindy.agents.networks import MLP
from dynasindy.envs import ControlEnv
from dynasindy.planning.pace import rests_of
from dynasindy.planning.regulator import Regulator, Weights, hold, imitate
from dynasindy.systems import Signature, System
from dynasindy.tasks import RandomStep, Tracking, TrackingReward


class Inverted(System):
    """A pendulum measured from the top, a = 4 sin(theta) + 6 u, whose targets lie to both sides."""

    def __init__(self, pull=6.0):
        super().__init__(Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.0, 3.0)))
        self.pull = pull

    def forward(self, x, u):
        theta, rate = x.unbind(-1)
        return torch.stack((rate, 4.0 * torch.sin(theta) + self.pull * u[..., 0]), -1)


def setting(pull=6.0):
    plant, box = Inverted(pull), {"low": [-0.4], "high": [0.4]}
    reward = TrackingReward((4.0,), error_shape="linear")
    task = Tracking(plant.signature, RandomStep(**box), ("theta",), ("Omega",), reward, max_steps=60, **box)
    env = ControlEnv(plant, task, 0.05, 1)
    return env, rests_of(env)


def test_the_gain_and_the_slowest_mode_are_those_of_the_riccati_equation():
    env, rests = setting()
    law = Regulator.of(env, rests, Weights(outputs=50.0, states=0.2, inputs=2.0))
    middle = float(rests.targets[rests.middle()])
    block = np.zeros((3, 3))
    block[0, 1], block[1, 0], block[1, 2] = 1.0, 4.0 * math.cos(middle), 6.0
    sampled = expm(block * 0.05)
    a, b, r = sampled[:2, :2], sampled[:2, 2:], np.array([[2.0]])
    p = solve_discrete_are(a, b, np.diag([50.0 / 0.8**2, 0.2 / 9.0]), r)
    k = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    torch.testing.assert_close(law.gain, torch.as_tensor(k).float(), atol=1e-4, rtol=1e-4)
    radius = np.abs(np.linalg.eigvals(a - b @ k)).max()
    assert math.exp(-1 / law.slowest) == pytest.approx(radius, rel=1e-4)


def test_at_rest_the_law_gives_the_input_that_holds_the_target():
    env, rests = setting()
    law = Regulator.of(env, rests, Weights())
    for target in (-0.35, 0.0, 0.2):
        x, params = torch.tensor([[target, 0.0]]), torch.tensor([[[target, 0.0, 0.0, 0.0, 0.0]]])
        u = law(env.task.observation(x, params, torch.zeros(1, 1)))
        assert u.item() == pytest.approx(-4.0 / 6.0 * math.sin(target), abs=1e-3)


def test_a_plant_that_no_input_moves_has_no_regulator():
    dead, rests = setting(pull=0.0)
    assert len(rests) == 0 or Regulator.of(dead, rests, Weights()) is None


def test_a_policy_that_imitates_the_law_holds_the_plant_and_keeps_to_it():
    env, rests = setting()
    torch.manual_seed(0)
    network, law = MLP(3, 1, (32, 32), squash=True), Regulator.of(env, rests, Weights())
    imitate(network, law, env, torch.Generator().manual_seed(0))
    x = torch.tensor([[0.3, 0.0], [-0.3, 0.1]])
    params = torch.zeros(2, 1, 5)
    params[:, 0, 0] = torch.tensor([-0.2, 0.4])
    with torch.no_grad():
        for k in range(100):
            x = env.advance(x, network(env.task.observation(x, params, torch.full((2, 1), 0.05 * k))))[0][..., -1, :]
    torch.testing.assert_close(x[:, 0], params[:, 0, 0], atol=0.02, rtol=0)


def test_a_policy_begins_as_the_law_only_if_that_earns_more():
    env, rests = setting()

    def held(score):
        torch.manual_seed(0)
        network = MLP(3, 1, (8,), squash=True)
        before = nn.utils.parameters_to_vector(network.parameters()).clone()
        earned = hold(network, env, rests, score(network), torch.Generator().manual_seed(0))
        return earned, bool((nn.utils.parameters_to_vector(network.parameters()) == before).all())

    assert held(lambda network: lambda policy: 1.0 if policy is network else 0.0) == (1.0, True)  # no law is better
    scores = iter([0.0, 5.0, 7.0, 6.0, 5.0, 6.5])  # the network, four laws, the network that imitates the best of them
    assert held(lambda network: lambda policy: next(scores)) == (6.5, False)
    scores = iter([0.0, 5.0, 7.0, 6.0, 5.0, -1.0])  # imitation fails
    assert held(lambda network: lambda policy: next(scores)) == (0.0, True)
