"""LQI: its gain against a Riccati recursion, its tracking against known figures, its integral."""

import numpy as np
import pytest
import torch
from alternating import Alternating
from scipy.linalg import solve_discrete_are
from tensordict import TensorDict

from dynasindy.agents.classical import LQI, jacobians, zero_order_hold
from dynasindy.envs import ControlEnv
from dynasindy.systems import Tras, Xi
from dynasindy.tasks import Step, Tracking


def step_env(system, targets=((0.4, 0.25),)):
    return ControlEnv(system, Tracking(system.signature, Step([list(row) for row in targets])))


class Pushed(Tras):
    """The plant under a constant wind."""

    def forward(self, x, u):
        return super().forward(x, u) + torch.tensor([0, 0, 0.1, 0.3, 0, 0], dtype=x.dtype)


def rmse(rollout):
    return (rollout["state"][..., :2] - rollout["reference"]).square().mean(-2).sqrt()


def test_gain_solves_the_riccati_recursion():
    system = Xi()
    controller = LQI(system, state_weights=(9, 4, 1, 1, 0.1, 0.1), integral_weights=(2, 3), input_weights=(1, 2))
    home = controller.equilibria.state_and_input(torch.zeros(2), controller.equilibria.home)
    a, b = zero_order_hold(*jacobians(system, *home), 0.05)
    f = torch.zeros(8, 8, dtype=torch.float64)
    f[:6, :6], f[6, 0], f[7, 1], f[6:, 6:] = a, -0.05, -0.05, torch.eye(2)
    g = torch.cat((b, torch.zeros(2, 2)))
    scale = torch.tensor([*system.signature.x_scale, 1, 1], dtype=torch.float64)
    q = torch.diag(torch.tensor([9, 4, 1, 1, 0.1, 0.1, 2, 3]) / scale**2)
    p, r = q.clone(), torch.diag(torch.tensor([1.0, 2.0], dtype=torch.float64))
    for _ in range(20_000):
        gain = torch.linalg.solve(r + g.T @ p @ g, g.T @ p @ f)
        p = q + f.T @ p @ (f - g @ gain)
    torch.testing.assert_close(controller.gain, gain, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("dt", "a", "b"), [(0.5, -0.6, 1.0), (1.0, 0.36, 0.4)])
def test_the_gain_of_a_difference_equation_is_that_of_its_map(dt, a, b):
    """x[k+1] = -0.6 x[k] + u[k], every step of 0.5 s, and two of its steps."""
    controller = LQI(Alternating(), ("x",), dt, state_weights=(3.0,), integral_weights=(2.0,), input_weights=(1.5,))
    f, g = np.array([[a, 0.0], [-dt, 1.0]]), np.array([[b], [0.0]])
    p = solve_discrete_are(f, g, np.diag([3.0, 2.0]), [[1.5]])
    np.testing.assert_allclose(controller.gain, np.linalg.solve(1.5 + g.T @ p @ g, g.T @ p @ f), rtol=1e-8)


def test_the_defaults_weigh_angles_most_their_rates_little_and_rotors_not_at_all():
    weights = {"state_weights": (30, 30, 1, 1, 0, 0), "integral_weights": (50, 50), "input_weights": (1, 1)}
    given = LQI(Xi(), ("alpha_a", "alpha_p"), 0.05, **weights)
    torch.testing.assert_close(LQI(Xi()).gain, given.gain, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("system", "worst"), [(Tras(), (0.076, 0.084)), (Xi(), (0.074, 0.062))], ids=["tras", "xi"])
def test_step_is_tracked_as_well_as_known_for_such_a_controller(system, worst):
    rollout = step_env(system).rollout(400, LQI(system))
    error = rmse(rollout)
    assert (error < torch.tensor(worst)).all()
    assert (error > 0.03).all()  # the way from the origin cannot be shorter
    last = (rollout["state"][-100:, :2] - rollout["reference"][-100:]).abs().mean(0)
    assert (last < 1e-3).all()


def test_integral_removes_the_error_of_a_wrong_model():
    rollout = step_env(Pushed()).rollout(400, LQI(Tras()))  # its feed-forward knows nothing of the push
    assert ((rollout["state"][-20:, :2] - rollout["reference"][-20:]).abs() < 0.005).all()
    u_known = LQI(Tras()).equilibria
    _, u = u_known.state_and_input(torch.tensor([0.4, 0.25]), u_known(torch.tensor([0.4, 0.25])))
    assert (rollout["action"][-1] - u).abs().max() > 0.03  # the integral moved the input that far


def test_rows_of_a_batch_do_not_influence_each_other():
    system, targets = Tras(), [[0.4, 0.25], [-0.3, -0.4], [0.1, 0.3]]
    env = step_env(system, targets)
    start = env.start_from(torch.zeros(3, 6))
    batch = env.rollout(40, LQI(system), auto_reset=False, tensordict=start)
    for row, target in zip(batch, targets, strict=True):
        alone = step_env(system, [target]).rollout(40, LQI(system))
        torch.testing.assert_close(row["action"], alone["action"], atol=1e-5, rtol=1e-4)


def observed(step, error=0.2, rows=2):
    return TensorDict(
        {
            "state": torch.zeros(rows, 6),
            "reference": torch.full((rows, 2), error),
            "step_count": torch.tensor(step).reshape(rows, 1),
        },
        [rows],
    )


def test_integral_starts_anew_in_the_rows_that_begin_an_episode():
    controller = LQI(Tras(), state_weights=(0.01, 0.01, 0, 0, 0, 0), integral_weights=(1e-4, 1e-4))
    controller(observed([0, 0]))
    controller(observed([1, 1]))
    torch.testing.assert_close(controller.integral, torch.full((2, 2), 2 * 0.05 * 0.2).double())
    controller(observed([0, 2]))
    torch.testing.assert_close(controller.integral[:, 0], torch.tensor([1.0, 3.0]).double() * 0.01)


def test_integral_holds_still_while_an_input_is_at_its_limit():
    controller = LQI(Tras(), state_weights=(1e4, 1e4, 0, 0, 0, 0))
    action = controller(observed([0, 0], error=0.4))["action"]
    assert (action.abs() == 1).any()
    assert (controller.integral == 0).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"state_weights": (1.0, 1.0)}, "state_weights are .*; give 6 numbers >= 0"),
        ({"integral_weights": (1.0, -1.0)}, "integral_weights are .*; give 2 numbers >= 0"),
        ({"input_weights": (0.0, 1.0)}, "input_weights are .*; give positive numbers"),
        ({"integral_weights": (0.0, 0.0)}, "give no stabilising LQI gain .*; give every output an integral"),
        ({"dt": 0.0}, "control period dt=0.0; give a time > 0 s"),
        ({"outputs": ("alpha_a", "beta")}, "state 'beta' does not exist"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        LQI(Tras(), **wrong)
