"""MPC against the Riccati equation, its limits, and what it is for: tracking without offset."""

import numpy as np
import pytest
import torch
from alternating import Alternating
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete
from tensordict import TensorDict

from dynasindy.agents.classical import MPC, Cost, Horizon
from dynasindy.envs import ControlEnv
from dynasindy.systems import Pendulum, Signature, System, Tras, Xi
from dynasindy.tasks import Step, Tracking, TrackingReward, Wave

pytest.importorskip("casadi")

A = np.array([[0.0, 1.0], [-2.0, -0.3]])
B = np.array([[0.0], [4.0]])
REST = torch.zeros(1, 1, dtype=torch.float64)
FIRST, LATER = torch.tensor([[True]]), torch.tensor([[False]])


class Linear(System):
    """A mass on a spring; x'' = 4 u - 2 x - 0.3 x'."""

    def __init__(self):
        super().__init__(Signature(("y", "v"), ("m", "m/s"), ("u",), (1.0, 2.0)))

    def forward(self, x, u):
        y, v = x.unbind(-1)
        return torch.stack((v, 4 * u[..., 0] - 2 * y - 0.3 * v), -1)


def linear_mpc(**settings):
    return MPC(Linear(), ("y",), **settings)


def row(*values):
    return torch.tensor([values], dtype=torch.float64)


@pytest.mark.parametrize("change", [0.0, 0.5])
@pytest.mark.parametrize("periods", [1, 7])
def test_without_limits_the_gain_is_that_of_the_riccati_equation(periods, change):
    controller = linear_mpc(cost=Cost(2.0, 0.3, change), horizon=Horizon((1,) * periods), correction=0.0)
    a, b = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), 0.05)[:2]
    # The state and the last input; the cost of a change joins the two.
    f, g = np.block([[a, np.zeros((2, 1))], [np.zeros((1, 3))]]), np.vstack((b, 1.0))
    q, r, s = np.diag([2.0, 0.0, change]), np.array([[0.3 + change]]), np.array([[0.0], [0.0], [-change]])
    p = solve_discrete_are(f, g, q, r, s=s)
    gain = np.linalg.solve(r + g.T @ p @ g, g.T @ p @ f + s.T)
    x = row(0.02, -0.05)
    first = controller.act(x, REST, REST, FIRST).item()
    assert first == pytest.approx(-(gain @ [0.02, -0.05, 0.0]).item(), rel=1e-4)
    second = controller.act(x, REST, REST, LATER).item()
    assert second == pytest.approx(-(gain @ [0.02, -0.05, first]).item(), rel=1e-4)


@pytest.mark.parametrize("periods", [1, 5])
@pytest.mark.parametrize(("dt", "a", "b"), [(0.5, -0.6, 1.0), (1.0, 0.36, 0.4)])
def test_the_gain_of_a_difference_equation_is_that_of_its_map(dt, a, b, periods):
    """x[k+1] = -0.6 x[k] + u[k], every step of 0.5 s, and two of its steps: what a horizon leaves is in its cost."""
    cost, horizon = Cost(2.0, 3.0, 0.0), Horizon((1,) * periods)
    controller = MPC(Alternating(), ("x",), dt, cost, horizon, correction=0.0)
    p = float(solve_discrete_are([[a]], [[b]], [[2.0]], [[3.0]]).item())
    first = controller.act(row(0.1), REST, REST, FIRST).item()
    assert first == pytest.approx(-0.1 * a * b * p / (3.0 + b**2 * p), rel=1e-4)


def flown(system, model, targets, steps=300, **settings):
    signature = system.signature
    outputs = ("theta",) if isinstance(system, Pendulum) else ("alpha_a", "alpha_p")
    rates = ("Omega",) if isinstance(system, Pendulum) else ("Omega_a", "Omega_p")
    reward = TrackingReward(error_weights=(1.0,) * len(outputs))
    task = Tracking(signature, Step(targets), outputs, rates, reward=reward)
    env = ControlEnv(system, task, dtype=torch.float64)
    start = env.start_from(torch.zeros(len(targets), signature.n_x))
    return env.rollout(steps, MPC(model, outputs, **settings), auto_reset=False, tensordict=start)


def final_error(rollout):
    outputs = list(range(rollout["reference"].shape[-1]))
    return (rollout["state"][:, -40:, outputs] - rollout["reference"][:, -40:]).abs().amax()


@pytest.mark.parametrize(
    ("system", "targets"),
    [(Pendulum(), [[0.6], [-0.4]]), (Xi(), [[0.4, 0.25], [-0.3, -0.4]]), (Tras(), [[0.4, 0.25], [-0.3, -0.4]])],
    ids=["pendulum", "xi", "tras"],
)
def test_steps_are_reached_exactly_within_the_limits(system, targets):
    rollout = flown(system, system, targets)
    assert final_error(rollout) < 1e-4
    assert (rollout["action"].abs() <= 1).all()
    assert (rollout["action"].abs() == 1).any()


class Pushed(Tras):
    """The plant under a constant wind."""

    def forward(self, x, u):
        return super().forward(x, u) + torch.tensor([0, 0, 0.1, 0.3, 0, 0], dtype=x.dtype)


@pytest.mark.slow
def test_the_estimated_model_error_removes_the_offset_of_a_wrong_model():
    assert final_error(flown(Pushed(), Tras(), [[0.4, 0.25]], correction=0.0)) > 5e-3
    assert final_error(flown(Pushed(), Tras(), [[0.4, 0.25]])) < 1e-3


def test_a_moving_reference_is_followed_without_lag():
    system = Tras()
    task = Tracking(system.signature, Wave([0.35, 0.25], [0.015, 0.015]))
    rollout = ControlEnv(system, task, dtype=torch.float64).rollout(300, MPC(system))
    error = (rollout["state"][100:, :2] - rollout["reference"][100:]).abs().amax()
    assert error < 2e-3  # a lag of one period alone would make 0.35 * 2 pi 0.015 * 0.05 = 1.6e-3


def test_rows_of_a_batch_do_not_influence_each_other():
    targets = [[0.4, 0.25], [-0.3, -0.4], [0.1, 0.3]]
    batch = flown(Tras(), Tras(), targets, steps=20)
    for one, target in zip(batch, targets, strict=True):
        alone = flown(Tras(), Tras(), [target], steps=20)[0]
        torch.testing.assert_close(one["action"], alone["action"], atol=1e-5, rtol=0)


def test_nothing_of_an_episode_is_left_in_the_next():
    controller, seen = MPC(Xi()), {"state": torch.rand(1, 6), "reference": torch.rand(1, 2) / 3}
    fresh = TensorDict({**seen, "step_count": torch.tensor([[0]])}, [1])
    first = controller(fresh.clone())["action"]
    controller(TensorDict({**seen, "step_count": torch.tensor([[1]])}, [1]))
    torch.testing.assert_close(controller(fresh)["action"], first, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cost": Cost(error=(1.0, 2.0))}, "weights of error are .*; give one number, or 1 numbers, > 0"),
        ({"cost": Cost(input=0.0)}, "weights of input are 0.0; give one number, or 1 numbers, > 0"),
        ({"cost": Cost(change=-1.0)}, "weights of change are -1.0; give one number, or 1 numbers, >= 0"),
        ({"horizon": Horizon(())}, "must have blocks, iterations and substeps of 1 or more"),
        ({"horizon": Horizon(iterations=0)}, "must have blocks, iterations and substeps of 1 or more"),
        ({"correction": 1.5}, "correction=1.5; give a share between 0"),
        ({"dt": 0.0}, "control period dt=0.0; give a time > 0 s"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        linear_mpc(**wrong)
