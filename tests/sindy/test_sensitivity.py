"""Derivatives of functions and predictions are those of autograd, of differences and of closed forms."""

import pytest
import torch

from dynasindy.sindy import functions, sensitivity
from dynasindy.sindy.codegen import simulate
from dynasindy.sindy.library import Library, of, parse, variable
from dynasindy.sindy.sensitivity import Parameters, slopes_by_state, trajectory_sensitivities
from dynasindy.systems.base import Signature
from dynasindy.systems.interpreter import MeasurementUpdate


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return 2 * torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1


@pytest.fixture(params=["code", "torch"])
def path(request, monkeypatch):
    """Both ways to the same numbers; there is nothing else than torch where no compiler is."""
    if request.param == "torch":

        def _none(*_):
            raise FileNotFoundError

        monkeypatch.setattr(sensitivity, "simulate_program", _none)
    return request.param


def integrated(field, x, u, u_end, h, count):
    """Runge-Kutta steps under inputs that move in a straight line from u to u_end."""
    for k in range(count):
        a, b, c = (u + (k + share) / count * (u_end - u) for share in (0, 0.5, 1))
        k1 = field(x, a)
        k2 = field(x + h / 2 * k1, b)
        k3 = field(x + h / 2 * k2, b)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(x + h * k3, c))
    return x


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("linear", [False, True])
def test_trajectories_move_with_numbers_inside_functions_as_autograd_says(path, linear, observed):
    """More rows than are handled at once, and windows of three intervals of two steps each."""
    words = ["tanh(~2 a)", "u^2 tanh(~2 a)^3 b", "max(0, b - .25)", "a", "slack(a, b; ~0.5)", "sin(2 a)", "u"]
    library, rows = Library(TWO, map(parse, words)), 70
    assert len(library.shapes) == 2
    numbers, xi = torch.tensor([2.0, 0.5]).double(), draw(len(words), 2, seed=1)
    x, u, u_end = draw(rows, 2), draw(rows, 3, 1, seed=2), draw(rows, 3, 1, seed=3)
    u_end = u_end if linear else u
    measured, gain = draw(rows, 3, 2, seed=4), torch.tensor([[0.5, 0.1], [-0.3, 0.2]]).double()
    measured[::3, 1, 0] = torch.nan  # a sample that was lost corrects nothing

    def field(x, u, xi, numbers):
        (a, b), v = x.unbind(-1), u[..., 0]
        t = torch.tanh(numbers[0] * a)
        slack = (a - b - numbers[1]).clamp_min(0) - (b - a - numbers[1]).clamp_min(0)
        functions = t, v**2 * t**3 * b, (b - 0.25).clamp_min(0), a, slack, torch.sin(2 * a), v
        return torch.stack(functions, -1) @ xi

    def predict(x, gain, numbers, xi, u, u_end, measured):
        ends = []
        for begin, end, y in zip(u, u_end, measured):
            x = integrated(lambda x, u: field(x, u, xi, numbers), x, begin, end, 0.1, 2)
            ends.append(x)
            x = x + observed * gain @ torch.where(y.isnan(), 0.0, y.nan_to_num() - x)
        return torch.stack(ends)

    fitted = torch.tensor([[0, 1, 1], [0, 0, 1]])
    observer, ends = MeasurementUpdate(measured, gain, fitted) if observed else None, u_end if linear else None
    ours, s = trajectory_sensitivities(library, xi, Parameters.where(xi != 0), x, u, 0.2, 2, ends, observer)
    rest, each = (x, gain, numbers, xi, u, u_end, measured), (0, None, None, None, 0, 0, 0)
    torch.testing.assert_close(ours, torch.func.vmap(predict, each)(*rest), rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(simulate(library, xi, x, u, 0.2, 2, ends, observer), ours, rtol=1e-12, atol=1e-14)
    by_x, by_gain, by_number, by_xi = torch.func.vmap(torch.func.jacrev(predict, (0, 1, 2, 3)), each)(*rest)
    by_gain = by_gain[..., fitted[0], fitted[1]] if observed else by_gain[..., 0, :0]
    wanted = torch.cat([by_x, by_gain, by_number, by_xi.mT.flatten(-2)], -1)
    torch.testing.assert_close(s, wanted, rtol=1e-11, atol=1e-13)


def test_steps_of_a_difference_equation_have_the_slopes_of_their_formula(path):
    """x+ = x + h (c x^2 + d u): by x 1 + 2 h c x, by c h x^2, by d h u; two steps by the chain rule."""
    signature = Signature(("x",), ("-",), ("u",), (1.0,))
    library = Library(signature, [variable("x") * variable("x"), variable("u")], step=0.5)
    xi = torch.tensor([[-0.8], [1.5]], dtype=torch.float64)
    x, u = draw(5, 1, seed=1), draw(5, 1, seed=2)
    first = x - 0.4 * x**2 + 0.75 * u
    found = trajectory_sensitivities(library, xi, Parameters.where(xi != 0), x, u.unsqueeze(1), 1.0, 7)
    end, slopes = (each[:, 0] for each in found)
    torch.testing.assert_close(end, first - 0.4 * first**2 + 0.75 * u)
    before, after = 1 - 0.8 * x, 1 - 0.8 * first
    wanted = [after * before, after * 0.5 * x**2 + 0.5 * first**2, after * 0.5 * u + 0.5 * u]
    torch.testing.assert_close(slopes, torch.cat(wanted, -1).unsqueeze(1))


TWO = Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0))


def points(n: int = 9, n_x: int = 2, n_u: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    return tuple(3 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1.2 for k in (n_x, n_u))


@pytest.mark.parametrize("name", sorted({*functions._REGISTRY, "sin_sum", "cos_gap", "per_cos2_sum", "per_cos2_gap"}))
def test_slopes_of_every_function_are_differences_of_its_values(path, name):
    """By each state, and by the number inside it or the factor of its argument."""
    pair, known = name in ("ahead", "slack") or name.endswith(("_sum", "_gap")), functions.function(name)
    number = {"frequency": 0.3 if known.parametric else -2.5, "fitted": True} if known.parametric or not pair else {}
    library = Library(TWO, [of(name, *("a", "b")[not pair :], **number)])
    x, u = points()
    xi = torch.tensor([[1.5, -0.5]], dtype=torch.float64)
    by_state = slopes_by_state(library, xi, x, u)
    for j, step in enumerate(1e-6 * torch.eye(2).double()):
        wanted = (library(x + step, u) - library(x - step, u)) @ xi / 2e-6
        torch.testing.assert_close(by_state[..., j], wanted, rtol=1e-6, atol=1e-8)
    if library.shapes:
        up, down = (library.with_shapes([number["frequency"] + step])(x, u) for step in (1e-6, -1e-6))
        number = torch.tensor(number["frequency"], dtype=torch.float64)
        found = torch.func.jacfwd(lambda p: library(x, u, {library.shapes[0]: p}))(number)
        torch.testing.assert_close(found, (up - down) / 2e-6, rtol=1e-6, atol=1e-8)
