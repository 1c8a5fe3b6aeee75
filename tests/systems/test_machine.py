"""A program in formulas is compiled as it stands, in both precisions, and once."""

import ctypes
import math
import os
import subprocess
import sys
import tempfile
import threading

import pytest
import torch
from one_period import one_period

from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compile_library, compiler, load_library
from dynasindy.systems.machine import Machine, Program
from dynasindy.systems.steps import Stops

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
DECAY = Program(1, 1, (("v0", "k[0] * x[0]"),), ("u[0] - v0",), (2.0,))


def test_a_program_is_compiled_once_whatever_its_constants(monkeypatch):
    Machine(DECAY, torch.float64)
    monkeypatch.setattr(compiling, "compile_library", lambda *_: pytest.fail("compiled again"))
    other = Machine(Program(1, 1, DECAY.lines, DECAY.results, (0.0,)), torch.float64)
    one = torch.ones(1, 1, dtype=torch.float64)
    assert one_period(other, one, one, 0.5, 1)[0].item() == 1.5


def test_a_formula_that_is_none_is_not_compiled():
    with pytest.raises(ValueError, match="formula"):
        Machine(Program(1, 1, (("v0", "system(x[0])"),), ("v0",)), torch.float64)


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
    samples, _ = one_period(code, x, u, 1.0, 9)
    torch.testing.assert_close(samples, torch.stack([first, second], -2))
    a, b = code.sensitivities(x, u, 1.0, 9)
    torch.testing.assert_close(a, a2 @ a1)
    torch.testing.assert_close(b, a2 @ by_u + by_u)
    with pytest.raises(ValueError, match=r"0.7"):
        one_period(code, x, u, 0.7, 1)
    with pytest.raises(ValueError, match=r"0.7"):
        code.sensitivities(x, u, 0.7, 1)


PUSHED = Program(2, 1, (), ("x[1]", "5 * u[0]"))
X, U = torch.tensor([[0.9, 1.0]]), torch.ones(1, 1)


def test_stops_may_be_counted_from_the_last_state():
    code = Machine(PUSHED)
    samples, touched = one_period(code, X, U, 0.4, 4, Stops((-2,), (-1,), (-1.0,), (1.0,)))
    assert samples.tolist() == [[[1.0, 0.0]] * 4] and touched.tolist() == [True]
    for place in ((2, 1), (0, -3)):
        with pytest.raises(IndexError):
            one_period(code, X, U, 0.4, 4, Stops(place[:1], place[1:], (-1.0,), (1.0,)))


def test_threads_that_need_the_same_code_at_once_all_get_it_and_no_file_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    load_library.cache_clear()
    made, together = [], threading.Barrier(3)

    def make():
        together.wait()
        made.append(one_period(Machine(PUSHED), X, U, 0.1, 1)[0])

    threads = [threading.Thread(target=make) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 3 and all(torch.equal(one, made[0]) for one in made)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n", [300])
def test_many_states_need_no_more_stack_than_a_thread_has(n, dtype):
    """A ring of states, each of which falls by the next one: at ones, all fall as e^-t."""
    code, found = Machine(Program(n, 1, (), tuple(f"u[0] - x[{(i + 1) % n}]" for i in range(n))), dtype), []
    x, u = torch.ones(2, n, dtype=dtype), torch.zeros(2, 1, dtype=dtype)

    def work():
        found.extend((one_period(code, x, u, 0.2, 2)[0], code.sensitivities(x, u, 0.2, 2)[0]))

    before = threading.stack_size(512 * 1024)
    try:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    finally:
        threading.stack_size(before)
    assert found[0][:, -1].flatten().tolist() == pytest.approx([math.exp(-0.2)] * 2 * n, rel=1e-5)
    assert found[1].sum(-1).flatten().tolist() == pytest.approx([math.exp(-0.2)] * 2 * n, rel=1e-5)


SANITIZED = """
import math, torch
from dynasindy.systems.machine import Machine, Program

names = ("sin", "cos", "exp", "tanh", "sqrt", "fabs")
values = [0.7, -2.0, 1e12, -1e12, 1e300, -1e300, math.inf, -math.inf, math.nan]
for dtype in (torch.float32, torch.float64):
    code = Machine(Program(2, 1, (), ("0.0", " + ".join(f"{name}(x[0] * u[0])" for name in names))), dtype)
    x, u = torch.tensor(values, dtype=dtype).unsqueeze(-1).repeat(1, 2), torch.ones(len(values), 1, dtype=dtype)
    code.sensitivities(x, u, 0.1, 2)
    samples, touched = x.new_empty(1, len(values), 1, 2), torch.empty(1, len(values), dtype=torch.bool)
    code.bind(x, u.unsqueeze(0), samples, touched, 0.1, 1, None)()
    gains = (samples[0, :, 0, 1] - x[:, 1]) / 0.1
    expected = sum(getattr(torch, "abs" if name == "fabs" else name)(x[0, 0]) for name in names)
    assert math.isclose(gains[0].item(), expected.item(), rel_tol=1e-4), (gains, expected)
    assert not gains[-1].isfinite()
"""


def test_no_number_leads_to_what_c_leaves_undefined(tmp_path):
    sanitizer = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    probe = tmp_path / "probe.c"
    probe.write_text("int probe(void);\nint probe(void) { return 1; }\n")
    try:
        ctypes.CDLL(str(compile_library([probe], tmp_path / "probe.so", sanitizer)))
    except (ValueError, OSError):
        pytest.skip("the compiler has no sanitizer of undefined behaviour")
    wrapper = tmp_path / "cc"
    wrapper.write_text(f'#!/bin/sh\nexec "{compiler()}" {" ".join(sanitizer)} "$@"\n')
    wrapper.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", SANITIZED], env={**os.environ, "CC": str(wrapper)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
