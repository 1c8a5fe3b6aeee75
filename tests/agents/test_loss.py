"""The loss against numpy by hand and against TorchRL's own TD3Loss."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate, ValueEstimators
from torchrl.objectives import TD3Loss as TorchRLTD3Loss

from dynasindy.agents.loss import SoftUpdate as OurSoftUpdate
from dynasindy.agents.loss import TD3Loss
from dynasindy.agents.networks import actor, critic

pytestmark = pytest.mark.filterwarnings("error")


def batch(n=32, n_obs=5, n_u=2, terminated=None, truncated=None):
    flags = {"terminated": torch.rand(n, 1) < 0.2, "truncated": torch.rand(n, 1) < 0.2}
    if terminated is not None:
        flags = {"terminated": torch.full((n, 1), terminated), "truncated": torch.full((n, 1), truncated)}
    following = {"observation": torch.randn(n, n_obs), "reward": torch.randn(n, 1), **flags}
    following["done"] = flags["terminated"] | flags["truncated"]
    return TensorDict(
        {"observation": torch.randn(n, n_obs), "action": torch.rand(n, n_u) * 2 - 1, "next": following}, [n]
    )


def ours(policy_noise=0.2, hidden=(16, 12), n_critics=2):
    loss = TD3Loss(
        actor(5, 2, hidden),
        [critic(5, 2, hidden) for _ in range(n_critics)],
        gamma=0.9,
        policy_noise=policy_noise,
        noise_clip=0.3,
        generator=torch.Generator().manual_seed(7),
    )
    SoftUpdate(loss, tau=0.5)
    for layer in [*loss.target_actor_layers, *loss.target_critic_layers]:
        layer.weight.data.add_(0.1 * torch.randn_like(layer.weight))  # targets that differ from the sources
    return loss


def theirs(loss, hidden=(16, 12)):
    """TorchRL's plain loss with the same parameters."""
    plain = TorchRLTD3Loss(
        actor(5, 2, hidden),
        [critic(5, 2, hidden) for _ in range(loss.num_qvalue_nets)],
        bounds=(-1.0, 1.0),
        num_qvalue_nets=loss.num_qvalue_nets,
        policy_noise=loss.policy_noise,
        noise_clip=loss.noise_clip,
        loss_function="l2",
        deactivate_vmap=True,
    )
    plain.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    SoftUpdate(plain, tau=0.5)
    plain.load_state_dict(loss.state_dict())
    return plain


def numpy_mlp(layers, x, squash=False):
    for layer in layers[:-1]:
        x = x @ layer.weight.detach().numpy().T + layer.bias.detach().numpy()
        x = np.where(x > 0, x, 0.01 * x)
    x = x @ layers[-1].weight.detach().numpy().T + layers[-1].bias.detach().numpy()
    return np.tanh(x) if squash else x


def nets(layers):
    """Split a stack of networks into single ones."""
    return [[type(layer)(layer.weight[i], layer.bias[i]) for layer in layers] for i in range(len(layers[0].bias))]


def test_target_equals_the_formula_by_hand():
    loss, td = ours(), batch()
    noise = torch.randn(32, 2, generator=torch.Generator().manual_seed(7)).numpy()
    x = td["next", "observation"].numpy()
    u = numpy_mlp(loss.target_actor_layers, x, squash=True) + np.clip(0.2 * noise, -0.3, 0.3)
    inputs = np.concatenate([x, np.clip(u, -1, 1)], -1)
    q = np.minimum(*[numpy_mlp(net, inputs)[:, 0] for net in nets(loss.target_critic_layers)])
    going_on = 1.0 - td["next", "terminated"][:, 0].numpy()
    expected = td["next", "reward"][:, 0].numpy() + 0.9 * going_on * q
    np.testing.assert_allclose(loss.target_value(td["next"]).numpy(), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("n_critics", [2, 3])
def test_values_and_gradients_equal_torchrl(n_critics):
    loss, td = ours(n_critics=n_critics), batch()
    plain = theirs(loss)
    for method, parameters in (
        ("value_loss", "qvalue_network_params"),
        ("actor_loss", "actor_network_params"),
    ):
        torch.manual_seed(7)  # TorchRL draws the smoothing noise from the global generator
        expected, _ = getattr(plain, method)(td)
        value, _ = getattr(loss, method)(td)
        torch.testing.assert_close(value, expected, rtol=1e-5, atol=1e-6)
        expected.backward()
        value.backward()
        a = dict(getattr(loss, parameters).named_parameters())
        b = dict(getattr(plain, parameters).named_parameters())
        assert a.keys() == b.keys()
        assert a
        for name in a:
            assert b[name].grad.abs().max() > 0
            torch.testing.assert_close(a[name].grad, b[name].grad, rtol=1e-4, atol=1e-6)
        loss.zero_grad()
        plain.zero_grad()


def test_actor_loss_leaves_the_critics_without_gradients():
    loss = ours()
    loss.actor_loss(batch())[0].backward()
    assert all(p.grad is None for p in loss.qvalue_network_params.parameters())
    assert all(p.grad is not None for p in loss.actor_network_params.parameters())


@pytest.mark.parametrize(("terminated", "truncated", "bootstraps"), [(0, 0, True), (0, 1, True), (1, 0, False)])
def test_only_termination_stops_the_bootstrap(terminated, truncated, bootstraps):
    loss, td = ours(), batch(terminated=bool(terminated), truncated=bool(truncated))
    difference = loss.target_value(td["next"]) - td["next", "reward"].squeeze(-1)
    assert bool((difference != 0).all()) is bootstraps
    assert bool((difference == 0).all()) is not bootstraps


def test_soft_update_equals_torchrl():
    loss = ours()
    plain = theirs(loss)
    SoftUpdate(loss, tau=0.3)  # copies the sources into the targets
    ours_updater, theirs_updater = OurSoftUpdate(loss, tau=0.3), SoftUpdate(plain, tau=0.3)
    for module in (loss, plain):
        torch.manual_seed(5)
        for p in [*module.actor_network_params.parameters(), *module.qvalue_network_params.parameters()]:
            p.data.add_(torch.randn_like(p))
    before = loss.target_actor_layers[0].weight.clone()
    ours_updater.step()
    theirs_updater.step()
    assert not torch.equal(before, loss.target_actor_layers[0].weight)
    for name, value in plain.state_dict().items():
        torch.testing.assert_close(loss.state_dict()[name], value)
