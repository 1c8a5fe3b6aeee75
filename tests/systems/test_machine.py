"""A program in formulas is compiled as it stands, in both precisions, and once."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compiler
from dynasindy.systems.machine import Machine, Program
from dynasindy.systems.stops import Stops

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
DECAY = Program(1, 1, (("v0", "k[0] * x[0]"),), ("u[0] - v0",), (2.0,))
SPRING = Program(2, 1, (), ("x[1]", "k[0] * u[0] - 4.0 * x[0]"), (3.0,))


@pytest.mark.parametrize(("dtype", "close"), [(torch.float32, 2e-6), (torch.float64, 1e-9)])
def test_known_solutions(dtype, close):
    x, u = torch.tensor([[1.0], [0.0], [-3.0]], dtype=dtype), torch.tensor([[0.0], [1.0], [0.5]], dtype=dtype)
    decay = Machine(DECAY, dtype)
    samples, touched = decay.integrate(x, u, 0.5, 100)
    wanted = 0.5 * u + (x - 0.5 * u) * torch.exp(torch.tensor(-1.0, dtype=dtype))
    torch.testing.assert_close(samples[:, -1], wanted, rtol=close, atol=close)
    assert samples.shape == (3, 100, 1) and not touched.any()
    a, b = decay.sensitivities(x, u, 0.5, 100)
    torch.testing.assert_close(a, torch.full_like(a, 0.36787944117144233), rtol=close, atol=close)
    torch.testing.assert_close(b, torch.full_like(b, 0.5 * (1 - 0.36787944117144233)), rtol=close, atol=close)
    angle = torch.tensor(2 * 0.3, dtype=dtype)  # of a spring of frequency 2 rad/s
    a, b = Machine(SPRING, dtype).sensitivities(torch.zeros(1, 2, dtype=dtype), torch.zeros(1, 1, dtype=dtype), 0.3, 50)
    c, s = angle.cos(), angle.sin()
    torch.testing.assert_close(
        a[0], torch.stack([torch.stack([c, s / 2]), torch.stack([-2 * s, c])]), rtol=0, atol=close
    )
    torch.testing.assert_close(b[0, :, 0], torch.stack([0.75 * (1 - c), 1.5 * s]), rtol=0, atol=close)


def test_double_precision_rounds_after_every_operation():
    """The square of x is rounded before it is compared with itself; fused with the sum it would leave a remainder."""
    x = torch.tensor([[1 / 3, 0.0], [0.1, 0.0], [1.7, 0.0]], dtype=torch.float64)
    code = Machine(Program(2, 1, (), ("0.0", "x[0] * x[0] - u[0]")), torch.float64)
    samples, _ = code.integrate(x, x[:, :1] * x[:, :1], 1.0, 1)
    assert samples[:, 0, 1].tolist() == [0.0, 0.0, 0.0]


def test_it_fits_one_kind_of_numbers_in_one_shape():
    decay = Machine(DECAY, torch.float64)
    x, u = torch.zeros(3, 1, dtype=torch.float64), torch.zeros(3, 1, dtype=torch.float64)
    assert decay.fits(x, u) and not decay.fits(x.float(), u.float()) and not decay.fits(x, u.float())
    assert not decay.fits(x, u[0]) and not decay.fits(x.to("meta"), u.to("meta"))


def test_batches_of_any_shape_are_moved_row_by_row():
    wall, code = Stops((0,), (1,), (-1.0,), (1.0,)), Machine(SPRING, torch.float64)
    x = torch.linspace(-1.2, 1.2, 12, dtype=torch.float64).reshape(2, 3, 2)
    samples, touched = code.integrate(x, torch.ones(2, 3, 1, dtype=torch.float64), 0.1, 4, wall)
    assert samples.shape == (2, 3, 4, 2) and touched.shape == (2, 3) and 0 < int(touched.sum()) < 6
    for i in range(2):
        for j in range(3):
            alone, hit = code.integrate(x[i, j], torch.ones(1, dtype=torch.float64), 0.1, 4, wall)
            assert alone.shape == (4, 2) and hit.shape == () and hit == touched[i, j]
            assert torch.equal(alone, samples[i, j])


def test_stops_may_change_from_call_to_call():
    code, x = Machine(SPRING, torch.float64), torch.tensor([2.0, 0.0], dtype=torch.float64)
    u, places = torch.zeros(1, dtype=torch.float64), []
    for end in (1.0, 0.5, None, 1.0):
        stops = None if end is None else Stops((0,), (1,), (-end,), (end,))
        samples, touched = code.integrate(x, u, 0.01, 1, stops)
        places.append(samples[0, 0].item())
        assert bool(touched) is (end is not None)
    assert places[0] == places[3] == 1.0 and places[1] == 0.5 and places[2] > 1.9


def test_no_rows_are_no_rows():
    for dtype in (torch.float32, torch.float64):
        samples, touched = Machine(DECAY, dtype).integrate(
            torch.zeros(0, 1, dtype=dtype), torch.zeros(0, 1, dtype=dtype), 1, 2
        )
        assert samples.shape == (0, 2, 1) and touched.shape == (0,)


def test_a_stop_holds_what_moves_outwards_and_lets_go_what_moves_inwards():
    wall = Stops((0,), (1,), (-1.0,), (1.0,))
    x = torch.tensor([[0.99, 5.0], [-0.99, -5.0], [1.0, -2.0]], dtype=torch.float64)
    samples, touched = Machine(SPRING, torch.float64).integrate(
        x, torch.zeros(3, 1, dtype=torch.float64), 0.01, 1, wall
    )
    assert samples[0, 0].tolist() == [1.0, 0.0] and samples[1, 0].tolist() == [-1.0, 0.0]
    assert samples[2, 0, 0] < 1.0 and samples[2, 0, 1] < -2.0
    assert touched.tolist() == [True, True, False]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("rows", [(), (1,), (37,), (2, 3)])
@pytest.mark.parametrize("step", [None, 0.05])
def test_a_flight_is_its_periods_one_by_one(dtype, rows, step):
    wall, code = Stops((0,), (-1,), (-0.3,), (0.3,)), Machine(replace(SPRING, step=step), dtype)
    rng = torch.Generator().manual_seed(1)
    x = torch.rand(*rows, 2, generator=rng).to(dtype) - 0.5
    u = torch.rand(60, *rows, 1, generator=rng).to(dtype) * 8 - 4
    samples, touched = code.flight(x, u, 0.1, 2, wall)
    assert samples.shape == (60, *rows, 2, 2) and touched.shape == (60, *rows)
    for k in range(60):
        wanted, hit = code.integrate(x, u[k], 0.1, 2, wall)
        assert torch.equal(samples[k], wanted) and torch.equal(touched[k], hit)
        x = wanted[..., -1, :]
    assert touched.any() and not touched.all()


def test_a_flight_of_a_falling_row_is_the_parabola_that_it_falls_along():
    fall = Machine(Program(2, 1, (), ("x[1]", "u[0]")), torch.float64)
    u = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64).reshape(3, 1, 1)
    samples, _ = fall.flight(torch.tensor([[0.25, 1.0]], dtype=torch.float64), u, 1.0, 1)
    assert samples[:, 0, 0].tolist() == [[1.75, 2.0], [2.75, 0.0], [3.0, 0.5]]


def test_a_program_is_compiled_once_whatever_its_constants(monkeypatch):
    Machine(DECAY, torch.float64)
    monkeypatch.setattr(compiling, "build", lambda *_: pytest.fail("compiled again"))
    other = Machine(Program(1, 1, DECAY.lines, DECAY.results, (0.0,)), torch.float64)
    one = torch.ones(1, 1, dtype=torch.float64)
    assert other.integrate(one, one, 0.5, 1)[0].item() == 1.5


def test_a_formula_that_is_none_is_not_compiled():
    with pytest.raises(ValueError, match="formula"):
        Machine(Program(1, 1, (("v0", "system(x[0])"),), ("v0",)), torch.float64)


def test_nothing_is_left_behind(tmp_path):
    code = (
        "import torch; from dynasindy.systems.machine import *\n"
        "Machine(Program(1, 1, (), ('u[0] - x[0]',)), torch.float64)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "TMPDIR": str(tmp_path)})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_difference_equation_has_the_derivatives_of_its_steps(dtype):
    """x[k+1] = (a + 0.5 (a b - 2 a + u), b + 0.5 (-b + 2 a)): two steps, their Jacobians multiplied by hand."""
    lines = (("v0", "x[0] * x[1]"),)
    code = Machine(Program(2, 1, lines, ("v0 - 2.0 * x[0] + u[0]", "2.0 * x[0] - x[1]"), step=0.5), dtype)
    rng = torch.Generator().manual_seed(3)
    x, u = torch.randn(40, 2, generator=rng).to(dtype), torch.randn(40, 1, generator=rng).to(dtype)

    def once(z):
        a, b = z.unbind(-1)
        end = torch.stack([0.5 * a * b + 0.5 * u[:, 0], a + 0.5 * b], -1)
        slopes = torch.stack([torch.stack([0.5 * b, 0.5 * a], -1), torch.tensor([1.0, 0.5]).to(z).expand_as(z)], -2)
        return end, slopes

    first, a1 = once(x)
    second, a2 = once(first)
    by_u = torch.tensor([[0.5], [0.0]], dtype=dtype)
    samples, _ = code.integrate(x, u, 1.0, 9)
    torch.testing.assert_close(samples, torch.stack([first, second], -2))
    a, b = code.sensitivities(x, u, 1.0, 9)
    torch.testing.assert_close(a, a2 @ a1)
    torch.testing.assert_close(b, a2 @ by_u + by_u)
    with pytest.raises(ValueError, match=r"cannot move by 0.7 s"):
        code.integrate(x, u, 0.7, 1)
    with pytest.raises(ValueError, match=r"cannot move by 0.7 s"):
        code.sensitivities(x, u, 0.7, 1)
