"""Machine code reads no memory but its own, leaves nothing behind, and keeps what is not finite."""

import math
import tempfile
import threading

import pytest
import torch

from dynasindy.systems import machine as module
from dynasindy.systems.compiler import compiler, forget
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


def test_many_states_fit_the_stack_of_a_thread():
    n = 80
    code, found = Machine(Program(n, 1, (), tuple(f"-x[{(i + 1) % n}]" for i in range(n)))), []
    before = threading.stack_size(512 * 1024)
    try:
        thread = threading.Thread(
            target=lambda: found.append(code.sensitivities(torch.ones(3, n), torch.ones(3, 1), 0.1, 1))
        )
        thread.start()
        thread.join()
    finally:
        threading.stack_size(before)
    assert found[0][0].sum(-1) == pytest.approx(math.exp(-0.1), rel=1e-5)


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
