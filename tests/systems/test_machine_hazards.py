"""Machine code reads no memory but its own, leaves nothing behind, and keeps what is not finite."""

import ctypes
import math
import os
import subprocess
import sys
import tempfile
import threading

import pytest
import torch

from dynasindy.systems import machine as module
from dynasindy.systems.compiler import build, compiler, forget
from dynasindy.systems.machine import Machine, Program
from dynasindy.systems.stops import Stops

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
PUSHED = Program(2, 1, (), ("x[1]", "5 * u[0]"))
X, U = torch.tensor([[0.9, 1.0]]), torch.ones(1, 1)


def of(formula):
    """Return machine code of a' = 0, b' = f(a)."""
    return Machine(Program(2, 1, (("v0", formula),), ("0", "v0")))


def gained(code, values):
    """Return what b gains in one second, f(a)."""
    x = torch.stack([torch.tensor(values), torch.zeros(len(values))], -1)
    return code.integrate(x, torch.zeros(len(values), 1), 1.0, 1)[0][:, 0, 1]


def test_other_numbers_of_states_and_inputs_do_not_fit():
    code = Machine(PUSHED)
    assert code.fits(X, U) and code.fits(X[0], U[0])
    assert not code.fits(X[:, :1], U) and not code.fits(X, torch.ones(1, 2)) and not code.fits(X, torch.ones(1, 0))
    assert not code.fits(X.double(), U) and not code.fits(X.double(), U.double())


def test_stops_may_be_counted_from_the_last_state():
    code = Machine(PUSHED)
    samples, touched = code.integrate(X, U, 0.4, 4, Stops((-2,), (-1,), (-1.0,), (1.0,)))
    assert samples.tolist() == [[[1.0, 0.0]] * 4] and touched.tolist() == [True]
    for place in ((2, 1), (0, -3)):
        with pytest.raises(IndexError):
            code.integrate(X, U, 0.4, 4, Stops(place[:1], place[1:], (-1.0,), (1.0,)))


def test_what_nothing_changes_has_derivatives():
    a, b = Machine(Program(2, 1, (), ("0", "1"))).sensitivities(X, U, 0.1, 2)
    assert a.tolist() == [[[1.0, 0.0], [0.0, 1.0]]] and b.tolist() == [[[0.0], [0.0]]]


def test_threads_that_need_the_same_code_at_once_all_get_it_and_no_file_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    forget()
    made, together = [], threading.Barrier(3)

    def make():
        together.wait()
        made.append(Machine(PUSHED).integrate(X, U, 0.1, 1)[0])

    threads = [threading.Thread(target=make) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 3 and all(torch.equal(one, made[0]) for one in made)
    assert not list(tmp_path.iterdir())


def test_a_library_that_shows_nothing_is_refused(monkeypatch):
    monkeypatch.setattr(module, "_source", lambda *_: "static int hidden; int other(void) { return hidden; }\n")
    with pytest.raises(OSError, match="shows"):
        Machine(PUSHED)


@pytest.mark.parametrize("formula", ["exp(x[0])", "tanh(x[0])", "sin(x[0])", "cos(x[0])", "larger(x[0] - 1, 0.0)"])
def test_what_is_no_number_stays_none(formula):
    assert gained(of(formula), [math.nan] * 40).isnan().all()


def test_an_exponential_out_of_range_is_infinite():
    found = gained(of("0.001 * exp(x[0])"), [86.0, 90.0, 200.0, math.inf])
    assert found[0].item() == pytest.approx(1e-3 * math.exp(86.0), rel=1e-5) and found[1:].isinf().all()


@pytest.mark.parametrize(("formula", "wanted"), [("sin(x[0])", torch.sin), ("cos(x[0])", torch.cos)])
def test_circular_functions_hold_over_many_turns(formula, wanted):
    values = [1e2, -1e3, 12345.678, -5e4, 9.9e4]
    exact = wanted(torch.tensor(values).double()).float()
    torch.testing.assert_close(gained(of(formula), values), exact, rtol=0.0, atol=5e-6)
    assert (gained(of(formula), [1e7, -1e9, 1e20, 1e30]).abs() <= 1 + 1e-6).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n", [80, 800])
def test_many_states_need_no_more_stack_than_a_thread_has(n, dtype):
    """A ring of states, each of which falls by the next one: at ones, all fall as e^-t."""
    code, found = Machine(Program(n, 1, (), tuple(f"u[0] - x[{(i + 1) % n}]" for i in range(n))), dtype), []
    x, u = torch.ones(2, n, dtype=dtype), torch.zeros(2, 1, dtype=dtype)

    def work():
        found.extend((code.integrate(x, u, 0.2, 2)[0], code.sensitivities(x, u, 0.2, 2)[0]))

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
    gains = (code.integrate(x, u, 0.1, 1)[0][:, 0, 1] - x[:, 1]) / 0.1
    expected = sum(getattr(torch, "abs" if name == "fabs" else name)(x[0, 0]) for name in names)
    assert math.isclose(gains[0].item(), expected.item(), rel_tol=1e-4), (gains, expected)
    assert not gains[-1].isfinite()
"""


def test_no_number_leads_to_what_c_leaves_undefined(tmp_path):
    sanitizer = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    probe = tmp_path / "probe.c"
    probe.write_text("int probe(void);\nint probe(void) { return 1; }\n")
    try:
        ctypes.CDLL(str(build([probe], tmp_path / "probe.so", sanitizer)))
    except (ValueError, OSError):
        pytest.skip("the compiler has no sanitizer of undefined behaviour")
    wrapper = tmp_path / "cc"
    wrapper.write_text(f'#!/bin/sh\nexec "{compiler()}" {" ".join(sanitizer)} "$@"\n')
    wrapper.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", SANITIZED], env={**os.environ, "CC": str(wrapper)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
