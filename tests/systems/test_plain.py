"""Tensors are plain where nothing but their numbers is asked for."""

import torch
from torch.autograd import forward_ad

from dynasindy.systems.integrators import plain

X = torch.ones(3)


def test_a_gradient_is_asked_of_what_carries_one_where_graphs_are_made():
    followed = torch.ones(3, requires_grad=True)
    assert plain(X) and plain(X, X) and plain()
    assert not plain(X, followed) and not plain(followed, X)
    with torch.no_grad():
        assert plain(followed)


def test_a_derivative_is_asked_of_dual_numbers():
    with forward_ad.dual_level():
        assert plain(X) and not plain(X, forward_ad.make_dual(X, X))


def test_nothing_is_plain_under_a_transform():
    seen = []
    torch.func.vmap(lambda x: seen.append(plain(x)) or x)(X)
    torch.func.jacfwd(lambda x: seen.append(plain(X)) or x)(X)
    torch.func.grad(lambda x: seen.append(plain(x)) or x.sum())(X)
    assert seen == [False, False, False]
