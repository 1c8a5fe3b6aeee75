"""The adjoint gradient equals automatic differentiation through the rollout."""

import math

import pytest
import torch
from torch import nn

from dynasindy.agents.networks import MLP
from dynasindy.envs import ControlEnv, Tracking, TrackingReward, Wave
from dynasindy.planning.rollout import InputStrength, Rows, backward, imagine, sensitivities
from dynasindy.systems import rk4
from dynasindy.systems.compiler import compiler
from dynasindy.systems.xi import Xi

STEPS = 25
SHARES = torch.linspace(0.0, 1.0, 8).unsqueeze(-1)
"""Delays of eight rows [control periods], from none to a whole period."""


def setting(perceptron=False):
    """Eight rows under references that move, each at its own time and phase, in two sub-steps."""
    plant = Xi()
    reward = TrackingReward(error_shape="linear", width=0.02, bonus=0.0)
    task = Tracking(plant.signature, Wave([0.3, 0.2], [0.5, 0.4]), reward=reward)
    env = ControlEnv(plant, task, substeps=2)
    network = nn.Sequential(nn.Linear(task.n_o, 16), nn.Tanh(), nn.Linear(16, 2), nn.Tanh())
    if perceptron:  # which machine code moves
        torch.manual_seed(0)
        network = MLP(task.n_o, 2, (16, 8), squash=True)
    rng = torch.Generator().manual_seed(3)
    x, held = 0.1 * torch.randn(8, 6, generator=rng), 0.2 * torch.randn(8, 2, generator=rng)
    params, t = task.sample(torch.Size((8,)), rng), 0.05 * torch.arange(8.0).unsqueeze(-1)
    params[..., 3] = torch.rand(8, 2, generator=rng)
    return env, network, Rows(x, held, params, t), rng


def unrolled(env, network, rows, late=0.0, factor=1.0, rest=0.0, limits=(-math.inf, math.inf)):
    """Back-propagate through time, step by step, with nothing but autograd."""
    x, held, total = rows.x, rows.held, 0.0
    for k in range(STEPS):
        t = rows.t + k * env.dt
        u = network(env.task.observation(x, rows.params, t))
        entering, held = (1 - late) * u + late * held, u
        pushed = (rest + factor * (entering - rest)).clamp(*limits)
        x_next = rk4(env.system, rk4(env.system, x, pushed, env.dt / 2), pushed, env.dt / 2)
        stopped = torch.zeros(8, dtype=torch.bool)
        total = total + env.task.earned(x, u, x_next, rows.params, t + env.dt, stopped).mean() / STEPS
        x = x_next
    (-total).backward()
    return total.detach()


@pytest.mark.parametrize("perceptron", [False, True])
@pytest.mark.parametrize(("strong", "limits"), [(False, None), (True, None), (True, (-0.4, -0.1))])
@pytest.mark.parametrize("late", [None, SHARES], ids=["at once", "late"])
def test_gradient_equals_back_propagation_through_time(late, strong, limits, perceptron):
    env, network, rows, rng = setting(perceptron)
    rows.kept = True
    factor, rest = (0.7 + 0.6 * torch.rand(8, 2, generator=rng), torch.rand(8, 2, generator=rng)) if strong else (1, 0)
    rows.late = late
    expected = unrolled(
        env, network, rows, 0.0 if late is None else late, factor, rest, limits or (-math.inf, math.inf)
    )
    ends = torch.tensor(limits or (-math.inf, math.inf)).unsqueeze(-1).expand(2, 2)
    rows.strength = InputStrength(0.3, lambda *_: rest.unsqueeze(0), ends, factor) if strong else None
    wanted = [p.grad.clone() for p in network.parameters()]
    network.zero_grad()
    window = imagine(env, network, rows, STEPS)
    assert (window.machine is not None) == (perceptron and compiler() is not None)
    if limits is not None:
        clamped = (window.applied == ends[0]) | (window.applied == ends[1])
        assert 0.1 < clamped.float().mean() < 0.9
    reward = backward(env, network, rows, window)
    torch.testing.assert_close(reward, expected, rtol=1e-5, atol=1e-6)
    for parameter, gradient in zip(network.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=2e-3, atol=1e-5 * float(gradient.abs().max()))


def test_machine_code_writes_within_the_room_that_it_has(monkeypatch):
    plain, guarded = torch.empty, []

    def _empty(*size, **settings):
        made = plain(*size, **settings)
        if made.dtype != torch.float32:
            return made
        room = torch.full((made.numel() + 4096,), 1234.5)
        guarded.append(room[made.numel() + 1 :])
        return room[1 : made.numel() + 1].reshape(made.shape)  # where no line of the cache begins

    env, network, rows, _ = setting(perceptron=True)
    rows.kept = True
    monkeypatch.setattr("dynasindy.planning.rollout.torch.empty", _empty)
    window = imagine(env, network, rows, STEPS)
    backward(env, network, rows, window)
    assert (window.machine is not None) == (compiler() is not None)
    assert len(guarded) > 1 or window.machine is None
    assert all(bool((beyond == 1234.5).all()) for beyond in guarded)


@pytest.mark.parametrize("late", [None, SHARES], ids=["at once", "late"])
@pytest.mark.parametrize("kept", [False, True])
def test_gradient_of_what_inputs_cost_is_that_of_back_propagation_through_time(settle, late, kept):
    env, network, rows, _ = setting()
    env.task = settle(env.system.signature, price=3.0)
    network[0] = nn.Linear(env.task.n_o, 16)
    if kept:
        network = MLP(env.task.n_o, 2, (16, 8), squash=True)
    rows.params, rows.kept, rows.late = torch.zeros(8, 0), kept, late
    unrolled(env, network, rows, 0.0 if late is None else late)
    wanted = [p.grad.clone() for p in network.parameters()]
    network.zero_grad()
    backward(env, network, rows, imagine(env, network, rows, STEPS))
    for parameter, gradient in zip(network.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=2e-3, atol=1e-5 * float(gradient.abs().max()))


def test_gradient_at_a_stop_leads_away_from_it():
    env, *_ = setting()
    x = torch.zeros(8, 6)
    x[:, 1] = torch.pi / 2
    a, _ = sensitivities(env, x, torch.ones(8, 2))
    assert bool((a[:, 1, 3] > 0).all())


class Explosion(Xi):
    """Rows whose main rotor starts above 900 rpm explode within a few periods; the others are those of the plant."""

    def forward(self, x, u):
        dx = super().forward(x, u)
        return torch.cat([dx[..., :5], dx[..., 5:] + 1e-3 * (x[..., 5:] - 900).clamp_min(0) ** 3], -1)


def test_what_diverged_holds_the_first_state_and_no_input_from_there_on():
    env, network, rows, _ = setting()
    rows.reach = torch.full((6,), torch.inf)
    free = imagine(env, network, rows, STEPS)
    rows.reach[0] = free.states[:, :, 0].abs().amax().item() / 2
    bound = imagine(env, network, rows, STEPS)
    for i in range(8):
        out = [k for k in range(STEPS + 1) if free.states[k, i, 0].abs() > rows.reach[0]]
        first = min(out, default=STEPS + 1)  # the first state that is out of reach
        assert bound.alive[:, i].tolist() == [k < first for k in range(STEPS + 1)]
        for k in range(STEPS + 1):
            assert torch.equal(bound.states[k, i], free.states[k, i] if k < first else rows.x[i])
        for k in range(STEPS):  # a period lives if it ends in reach, a measurement if it begins there
            kept = k + 1 < first
            assert torch.equal(bound.applied[k, i], free.applied[k, i] if kept else torch.zeros(2))
            assert torch.equal(bound.actions[k, i], free.actions[k, i] if kept else torch.zeros(2))
    assert not bound.alive.all()


def test_a_row_that_diverged_does_not_count():
    """The reward is a mean over eight rows, of which three earn nothing."""
    env, network, rows, _ = setting()
    rows.x[:3, 5], rows.x[3:, 5] = 1500.0, -500.0
    rows.reach = torch.tensor([6.0, 6.0, 50.0, 50.0, 1e5, 1e5])
    five = Rows(*(getattr(rows, name)[3:] for name in ("x", "held", "params", "t")), reach=rows.reach)
    sick, rewards, gradients = env.with_system(Explosion()), [], []
    for some in (rows, five):
        network.zero_grad()
        window = imagine(sick, network, some, STEPS)
        assert int((~window.alive[-1]).sum()) == (3 if some is rows else 0)
        rewards.append(backward(sick, network, some, window))
        gradients.append(torch.cat([p.grad.flatten() for p in network.parameters()]))
    torch.testing.assert_close(rewards[0], 5 / 8 * rewards[1])
    torch.testing.assert_close(gradients[0], 5 / 8 * gradients[1])
