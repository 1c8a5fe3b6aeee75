"""What a call is said to cost is what the compiler makes of it, and what a number that counts has seen."""

import ctypes
import re
import shutil
import subprocess

import pytest

from dynasindy.control.files import network
from dynasindy.export import controller_sources
from dynasindy.export.cost import Sizes, cost
from dynasindy.systems.compiler import STRICT, build, compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


@needs_compiler
@pytest.mark.parametrize("settings", [{}, {"observer": False}, {"integral": {}, "disturbance": False, "delay": 0.0}])
def test_the_header_tells_the_size_of_the_state_and_the_places_of_names(pendulum, settings, tmp_path):
    sources = controller_sources(pendulum(**settings), "ctl")
    text = '#include "ctl.h"\nint size(void) { return (int)sizeof(ctl_state); }\n'
    text += "int place(void) { return 100 * ctl_x_Omega + 10 * ctl_u_u + ctl_r_theta; }\n"
    for name, content in {**sources.files(), "shim.c": text}.items():
        (tmp_path / name).write_text(content)
    options = ["-Wno-missing-prototypes", *STRICT]
    library = ctypes.CDLL(str(build([tmp_path / "shim.c", tmp_path / "ctl.c"], tmp_path / "shim.so", options)))
    assert library.size() == sources.cost.state and library.place() == 100
    assert f"Bytes: {sources.cost.state} of state, {sources.cost.constants} of constants" in sources.header
    assert "theta [rad]" in sources.header and "Period: 0.04 s" in " ".join(sources.header.split())


@needs_compiler
@pytest.mark.parametrize(
    "settings",
    [
        {"integral": {}},
        {"stops": False},
        {"observer": False},
        {"disturbance": False},
        {"step": 0.02, "delay": 0.06},
    ],
    ids=str,
)
def test_the_constants_and_the_stack_are_as_large_as_the_compiler_makes_them(pendulum, settings, tmp_path):
    sources = controller_sources(pendulum(**settings))
    for name, content in sources.files().items():
        (tmp_path / name).write_text(content)
    build([tmp_path / "controller.c"], tmp_path / "c.so", ("-O0", "-fno-inline", "-fstack-usage"))
    usage = {
        name: int(size)
        for file in tmp_path.glob("*.su")
        for name, size in re.findall(r":(\w+)\t(\d+)", file.read_text())
    }
    if "advance" in usage:
        chain = ("controller_act", "advance", "period", "flow", "rates", "field")
        assert sum(usage[name] for name in chain) == pytest.approx(sources.cost.stack, rel=0.5)
    symbols = shutil.which("nm")
    if symbols:
        listed = subprocess.run([symbols, "-S", str(tmp_path / "c.so")], capture_output=True, text=True).stdout
        sizes = [int(size, 16) for size, name in re.findall(r"^\w+ (\w+) r (\w+)$", listed, re.M) if name[0] != "_"]
        assert sum(sizes) == sources.cost.constants


@pytest.mark.parametrize(
    ("changed", "stack"),
    [
        # The prediction: f and p, three vectors; in `flow` three more; four values in the model.
        ({}, 8 * (2 * 9 + 3 * 3) + 2 * 96 + 8 * 3 * 3 + 2 * 96 + 8 * 4 + 96),
        # The prediction by a difference equation has one vector in `flow`.
        ({"difference": True}, 8 * (2 * 9 + 3 * 3) + 2 * 96 + 8 * 3 + 2 * 96 + 8 * 4 + 96),
        # The correction of 20 measured states: three matrices and two vectors.
        ({"n_x": 20, "n": 20, "m": 20}, 8 * (3 * 400 + 2 * 20) + 2 * 96),
        # Against a push by 20 inputs: slopes (2, 22), normal (22, 22), missing and z, three vectors of states.
        ({"n_u": 20}, 8 * (2 * 22 + 22 * 22 + 2 * 22 + 3 * 2) + 96 + 8 * 4 + 96),
        # Two vectors of float between wide layers.
        ({"layers": ((5, 4000), (4000, 1))}, 2 * 4 * 4000 + 2 * 96),
    ],
)
def test_the_stack_is_that_of_the_deepest_call(changed, stack):
    """The arrays of the functions in `dynasindy/export/c`, and 96 bytes for each of their calls."""
    sizes = {"n_x": 2, "n_u": 1, "n_r": 1, "n": 3, "m": 1, "memory": 3, "steps": 2, "ahead": 2} | changed
    made = Sizes(**({"layers": ((5, 4), (4, 1))} | sizes), integral=False, flops=7, values=4, n_stops=0, observe_rate=0)
    assert cost(made).stack == 8 * (max(made.n, made.n_x) + made.n_r + made.n_u) + 96 + stack


COUNTED = """#include <cmath>
extern "C" { long counted_operations = 0; }
struct counted {
    double v;
    counted() : v(0) {}
    counted(double a) : v(a) {}
    explicit operator float() const { return (float)v; }
    counted operator-() const { return counted(-v); }
    counted &operator+=(counted o) { counted_operations++; v += o.v; return *this; }
    counted &operator-=(counted o) { counted_operations++; v -= o.v; return *this; }
    counted &operator/=(counted o) { counted_operations++; v /= o.v; return *this; }
};
#define OPERATOR(o) static inline counted operator o(counted a, counted b) \\
    { counted_operations++; return counted(a.v o b.v); }
OPERATOR(+) OPERATOR(-) OPERATOR(*) OPERATOR(/)
#define ORDER(o) static inline bool operator o(counted a, counted b) { return a.v o b.v; }
ORDER(<) ORDER(>) ORDER(<=) ORDER(>=)
#define CALL(f) static inline counted f(counted a) { counted_operations++; return counted(std::f(a.v)); }
CALL(sin) CALL(cos) CALL(exp) CALL(tanh) CALL(sqrt) CALL(fabs)
static inline int isfinite(counted a) { return std::isfinite(a.v); }
#define double counted
"""


@needs_compiler
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler, which counts operations")
@pytest.mark.parametrize(
    ("plant", "settings"),
    [
        ("pendulum", {"integral": {"band": 9.0}}),
        ("pendulum", {"observer": False}),
        ("pendulum", {"delay": 0.0, "disturbance": False}),
        ("pendulum", {"delay": 0.06, "step": 0.02}),
        ("pendulum", {"delay": 0.0, "disturbance": False, "step": 0.04}),
        ("rotors", {"integral": {"band": 9.0}}),
    ],
    ids=str,
)
def test_the_operations_are_those_that_a_counting_number_sees(request, plant, settings, tmp_path):
    controller = request.getfixturevalue(plant)(**settings)
    for layer in network(controller).layers()[:-1]:
        layer.bias.fill_(-100.0)  # all hidden units are negative, and multiplied
    sources = controller_sources(controller)
    for name, content in {**sources.files(), "counted.h": COUNTED}.items():
        (tmp_path / name).write_text(content.replace("#include <math.h>", ""))
    command = ["g++", "-include", "counted.h", "-I.", "-x", "c++", "-shared", "-fPIC", "controller.c", "-o", "c.so"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    library, state = ctypes.CDLL(str(tmp_path / "c.so")), ctypes.create_string_buffer(sources.cost.state)
    counter = ctypes.c_long.in_dll(library, "counted_operations")
    n_x, n_u, n_r = sources.shape
    y, u = (ctypes.c_double * n_x)(*[0.1 * (i + 1) for i in range(n_x)]), (ctypes.c_double * n_u)()
    r = (ctypes.c_double * n_r)(*[0.3] * n_r)
    for _ in range(2):
        counter.value = 0
        assert library.controller_act(state, y, r, r, u) == 0
    # What the search for a pivot compares is not counted: n^2 values for n equations.
    observer = controller.observer
    compared = 0 if observer is None else len(sources.measured) ** 2
    compared += 2 * (n_x + n_u) ** 2 if observer is not None and observer.pushed else 0
    assert counter.value - compared == sources.cost.flops
