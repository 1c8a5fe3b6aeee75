"""Networks side by side compute what each of them computes, whatever their widths are rounded up by."""

import pytest
import torch

from dynasindy.agents import MLP
from dynasindy.together.stacks import LANES, Stack, through

CPU = torch.device("cpu")


def networks(count, **given):
    """Return networks whose weights are drawn, biases and norms among them."""
    rng = torch.Generator().manual_seed(3)
    found = [MLP(5, 2, (12, 9), squash=True, **given) for _ in range(count)]
    with torch.no_grad():
        for network in found:
            for weight in network.parameters():
                weight.copy_(torch.randn(weight.shape, generator=rng))
    return found


def filled(stack, mlps):
    for k, mlp in enumerate(mlps):
        theirs = [part.detach() for layer in mlp.layers() for part in layer if part is not None]
        for mine, their in zip(stack.of(k, k + 1), theirs, strict=True):
            mine.copy_(their.unsqueeze(0))
    return stack


@pytest.mark.parametrize("norm", [False, True])
def test_each_network_of_a_stack_says_what_it_says_alone(norm):
    mlps = networks(3, layer_norm=norm)
    stack = filled(Stack(mlps[0].layers(), 3, CPU), mlps)
    x = torch.randn(3, 7, 5, generator=torch.Generator().manual_seed(1))
    found = through(stack.layers(), x, squash=True)
    wanted = torch.stack([mlp(rows) for mlp, rows in zip(mlps, x, strict=True)])
    torch.testing.assert_close(found, wanted.detach(), rtol=0, atol=1e-6)


def test_widths_are_rounded_up_to_whole_lanes_that_learn_nothing():
    mlps = networks(2)
    stack = filled(Stack(mlps[0].layers(), 2, CPU), mlps)
    first, second, last = stack.layers()
    assert (first.weight.shape, second.weight.shape) == ((2, 16, LANES), (2, 16, 16))
    assert (last.weight.shape, last.bias.shape) == ((2, 2, 16), (2, 2))
    flat = stack.flat.clone().requires_grad_()
    x = torch.randn(2, 7, 5, generator=torch.Generator().manual_seed(1))
    through(stack.layers(flat), x, squash=True).sum().backward()
    kept = stack.twin()
    kept.flat.copy_(flat.grad)
    assert sum((part != 0).sum() for part in kept.of(0, 2)) == (kept.flat != 0).sum()
    wanted = torch.autograd.grad(mlps[1](x[1]).sum(), list(mlps[1].parameters()))
    for found, each in zip(kept.of(1, 2), wanted, strict=True):
        torch.testing.assert_close(found[0], each, rtol=1e-5, atol=1e-6)


def test_hidden_layers_of_lower_precision_have_rounded_factors():
    mlps = networks(1)
    stack = filled(Stack(mlps[0].layers(), 1, CPU), mlps)
    x = torch.randn(1, 7, 5, generator=torch.Generator().manual_seed(1))
    found = through(stack.layers(), x, squash=False, factors=torch.bfloat16)
    (one, two, last), kind = mlps[0].layers(), torch.bfloat16

    def _hidden(y, layer):
        rounded = (y.to(kind).double() @ layer.weight.detach().to(kind).double().mT).to(kind).float()
        return torch.nn.functional.leaky_relu(rounded + layer.bias.detach())

    wanted = _hidden(_hidden(x[0], one), two) @ last.weight.detach().mT + last.bias.detach()
    torch.testing.assert_close(found[0], wanted, rtol=1e-2, atol=1e-2)
    exact = through(stack.layers(), x, squash=False)
    assert (found - exact).abs().max() > 1e-2


def test_a_run_with_a_weight_that_is_no_number_is_told_from_the_others():
    stack = Stack(networks(1)[0].layers(), 6, CPU)
    assert stack.sound(3).tolist() == [True, True, True]
    stack.of(3, 4)[-1][0, 1] = torch.inf
    assert stack.sound(3).tolist() == [True, False, True]
    assert stack.sound(6).tolist() == [True, True, True, False, True, True]


def test_a_twin_has_room_of_its_own():
    stack = Stack(networks(1)[0].layers(), 2, CPU)
    twin = stack.twin()
    twin.flat.fill_(1.0)
    assert not stack.flat.any() and [a.shape for a in twin.of(0, 1)] == [a.shape for a in stack.of(0, 1)]
