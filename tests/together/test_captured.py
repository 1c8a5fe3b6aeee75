"""A step that repeats does the same, captured or not, compiled or not."""

from functools import partial

import pytest
import torch

from dynasindy.together.captured import captured, compiled


@pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"))]
)
def test_a_step_goes_on_from_what_the_last_one_left(device):
    number = torch.zeros((), device=device)

    def _step():
        number.mul_(2.0).add_(1.0)

    again = captured(_step, torch.device(device), number.zero_)
    number.zero_()
    for _ in range(5):
        again()
    assert number.item() == 2**5 - 1


def square(x):
    return x.square().sum()


def test_what_is_compiled_for_a_gpu_computes_the_same_with_its_derivatives(monkeypatch):
    asked = []

    def _backend(graph, inputs):
        asked.append(graph)
        return graph.forward

    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend=_backend))
    x = torch.tensor([1.0, 2.0], requires_grad=True)
    again = compiled(square, torch.device("cuda"))
    (slope,) = torch.autograd.grad(again(x), x)
    assert slope.tolist() == [2.0, 4.0] and len(asked) == 1
    again(x)
    assert len(asked) == 1


def test_what_torch_cannot_compile_stays_as_it_is(monkeypatch):
    def _backend(graph, inputs):
        raise RuntimeError("no Triton")

    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend=_backend))
    again = compiled(square, torch.device("cuda"))
    assert again(torch.tensor([1.0, 2.0])).item() == 5.0


def test_on_the_cpu_nothing_is_compiled():
    assert compiled(square, torch.device("cpu")) is square
