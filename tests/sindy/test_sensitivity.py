"""Derivatives of predictions by coefficients and start states are those of autograd and of closed forms."""

import math

import numpy as np
import torch
from scipy.linalg import expm

from dynasindy.sindy import sensitivity
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.named_libraries import paper_table
from dynasindy.sindy.sensitivity import Parameters, Propagator
from dynasindy.systems import Xi, rk4
from dynasindy.systems.base import Signature

ONE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = paper_table(Xi().signature)


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return 2 * torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1


def model() -> tuple[torch.Tensor, Parameters]:
    xi = torch.where(draw(27, 6, seed=1) > 0.5, draw(27, 6, seed=2), 0.0)
    others = torch.zeros(27, 6, dtype=torch.bool)
    others[[0, 14, 26], [2, 3, 5]] = True  # coefficients outside the model are differentiated by too
    return xi, Parameters.where((xi != 0) | others)


def test_sensitivities_are_those_of_autograd_through_the_integrator():
    xi, parameters = model()
    x, u, h = draw(5, 6, seed=3), draw(5, 2, seed=4), 0.1
    propagator = Propagator(LIBRARY, xi, parameters)
    ours, s = propagator.advance(x, propagator.start(5), u, h, 3)

    def predict(x, values, u):
        changed = torch.zeros_like(xi).index_put((parameters.features, parameters.states), values)
        rest = parameters.write(xi, torch.zeros(len(parameters), dtype=xi.dtype))
        for _ in range(3):
            x = rk4(lambda x, u: LIBRARY(x, u) @ (changed + rest), x, u, h / 3)
        return x

    values = parameters.read(xi)
    assert torch.allclose(ours, torch.stack([predict(a, values, b) for a, b in zip(x, u)]), rtol=1e-12)
    by_x, by_xi = torch.func.vmap(torch.func.jacrev(predict, (0, 1)), (0, None, 0))(x, values, u)
    assert torch.allclose(s[:, :, :6], by_x, rtol=1e-9, atol=1e-12)
    assert torch.allclose(s[:, :, 6:], by_xi, rtol=1e-9, atol=1e-12)


def test_a_linear_equation_has_the_sensitivities_of_its_solution():
    # y' = a y + b: y = e^(a t) y0 + b (e^(a t) - 1) / a.
    a, b, y, t = -1.3, 0.7, 0.4, 0.5
    library = Library(ONE, [variable("y"), CONSTANT])
    propagator = Propagator(
        library, torch.tensor([[a], [b]], dtype=torch.float64), Parameters.where(torch.ones(2, 1).bool())
    )
    state, s = propagator.advance(
        torch.tensor([[y]], dtype=torch.float64), propagator.start(1), torch.zeros(1, 1), t, 50
    )
    e = math.exp(a * t)
    by_a = t * e * y + b * (t * e * a - e + 1) / a**2
    expected = [e, by_a, (e - 1) / a]
    assert abs(state.item() - (e * y + b * (e - 1) / a)) < 1e-10
    assert np.allclose(s.flatten(), expected, atol=1e-9)


def test_start_states_move_with_the_matrix_exponential_and_chain_over_intervals():
    signature = Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0))
    matrix = np.array([[0.0, 1.0], [-4.0, -0.4]])
    library = Library(signature, [variable("a"), variable("b"), variable("u")])
    xi = torch.from_numpy(np.vstack([matrix.T, [[0.0, 3.0]]]))
    propagator = Propagator(library, xi, Parameters.where(torch.zeros(3, 2).bool()))
    x, s = draw(4, 2), propagator.start(4)
    assert torch.equal(s, torch.eye(2).double().expand(4, 2, 2))
    for k in range(3):
        x, s = propagator.advance(x, s, draw(4, 1, seed=k), 0.1, 10)
    assert np.allclose(s, expm(0.3 * matrix), atol=1e-8)


def test_parameters_name_coefficients_state_by_state():
    support = torch.tensor([[True, False], [False, True], [True, True]])
    parameters = Parameters.where(support)
    xi = torch.arange(6.0).reshape(3, 2)
    assert parameters.read(xi).tolist() == [0.0, 4.0, 3.0, 5.0] and len(parameters) == 4
    assert torch.equal(parameters.support(support.shape), support)
    written = parameters.write(xi, torch.tensor([10.0, 11, 12, 13]))
    assert written.tolist() == [[10.0, 1.0], [2.0, 12.0], [11.0, 13.0]] and xi[0, 0] == 0.0
    both = parameters + Parameters.where(~support)
    assert both.read(xi).tolist() == [0.0, 4.0, 3.0, 5.0, 2.0, 1.0]


def test_many_states_are_moved_in_parts_as_they_are_at_once(monkeypatch):
    xi, parameters = model()
    propagator, x, u = Propagator(LIBRARY, xi, parameters), draw(7, 6, seed=3), draw(7, 2, seed=4)
    at_once = propagator.transfer(x, u, 0.1, 2)
    monkeypatch.setattr(sensitivity, "MOST", 3 * 8 * (len(propagator.xi) + len(propagator.jacobian) + 6))
    for whole, parts in zip(at_once, propagator.transfer(x, u, 0.1, 2), strict=True):
        assert torch.allclose(whole, parts, rtol=1e-12, atol=1e-14)
    assert propagator.transfer(x[:0], u[:0], 0.1, 2)[1].shape == (0, 6, 6 + len(parameters))


def test_steps_of_a_difference_equation_have_the_slopes_of_their_formula():
    """x+ = x + h (c x^2 + d u): by x 1 + 2 h c x, by c h x^2, by d h u; two steps by the chain rule."""
    signature = Signature(("x",), ("-",), ("u",), (1.0,))
    library = Library(signature, [variable("x") * variable("x"), variable("u")], step=0.5)
    xi = torch.tensor([[-0.8], [1.5]], dtype=torch.float64)
    x, u = draw(5, 1, seed=1), draw(5, 1, seed=2)
    first = x - 0.4 * x**2 + 0.75 * u
    end, slopes = Propagator(library, xi, Parameters.where(xi != 0)).transfer(x, u, 1.0, 7)
    torch.testing.assert_close(end, first - 0.4 * first**2 + 0.75 * u)
    before, after = 1 - 0.8 * x, 1 - 0.8 * first
    wanted = [after * before, after * 0.5 * x**2 + 0.5 * first**2, after * 0.5 * u + 0.5 * u]
    torch.testing.assert_close(slopes, torch.cat(wanted, -1).unsqueeze(1))
