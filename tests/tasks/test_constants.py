"""Constants are made once per kind of number, and are what was given."""

import torch

from dynasindy.tasks.base import constants


def test_where_they_were_first_made_leaves_no_trace():
    with torch.inference_mode():
        constants((3.25, 1.5), torch.float32, torch.device("cpu"))
    torch.func.jacrev(lambda x: x * constants((4.25, 1.5), torch.float32, torch.device("cpu")))(torch.ones(2))
    for numbers in ((3.25, 1.5), (4.25, 1.5)):
        x = torch.ones(2, requires_grad=True)
        (x * constants(numbers, torch.float32, torch.device("cpu"))).sum().backward()
        assert x.grad.tolist() == list(numbers)


def test_what_is_compiled_holds_the_numbers_themselves():
    graphs = []

    def _backend(graph, inputs):
        graphs.append(graph)
        return graph.forward

    def _scaled(x):
        return x * constants((5.25, 1.5), x.dtype, x.device)

    found = torch.compile(_scaled, backend=_backend, fullgraph=True)(torch.ones(2, dtype=torch.float64))
    assert found.tolist() == [5.25, 1.5] and found.dtype == torch.float64
    (graph,) = graphs
    assert not list(graph.buffers()), "a tensor in the CPU's memory would be copied to a GPU at each call"
