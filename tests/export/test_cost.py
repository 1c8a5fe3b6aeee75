"""What a call is said to cost is what the compiler makes of it, and what a number that counts has seen."""

import ctypes
import re
import shutil
import subprocess

import pytest

from dynasindy.export import controller_sources
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
def test_the_constants_and_the_stack_are_as_large_as_the_compiler_makes_them(pendulum, tmp_path):
    sources = controller_sources(pendulum(integral={}))
    for name, content in sources.files().items():
        (tmp_path / name).write_text(content)
    build([tmp_path / "controller.c"], tmp_path / "c.so", ("-O0", "-fno-inline", "-fstack-usage"))
    usage = {
        name: int(size)
        for file in tmp_path.glob("*.su")
        for name, size in re.findall(r":(\w+)\t(\d+)", file.read_text())
    }
    chain = ("controller_act", "advance", "period", "flow", "rates", "field")
    assert sum(usage[name] for name in chain) == pytest.approx(sources.cost.stack, rel=0.5)
    symbols = shutil.which("nm")
    if symbols:
        listed = subprocess.run([symbols, "-S", str(tmp_path / "c.so")], capture_output=True, text=True).stdout
        sizes = [int(size, 16) for size, name in re.findall(r"^\w+ (\w+) r (\w+)$", listed, re.M) if name[0] != "_"]
        assert sum(sizes) == pytest.approx(sources.cost.constants, abs=8 + sources.cost.state)


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
CALL(sin) CALL(cos) CALL(exp) CALL(tanh) CALL(sqrt)
static inline counted fabs(counted a) { return counted(std::fabs(a.v)); }
static inline int isfinite(counted a) { return std::isfinite(a.v); }
#define double counted
"""


@needs_compiler
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler, which counts operations")
@pytest.mark.parametrize("settings", [{"integral": {"band": 9.0}}, {"observer": False}, {"delay": 0.0}], ids=str)
def test_the_operations_are_those_that_a_counting_number_sees(pendulum, settings, tmp_path):
    controller = pendulum(**settings)
    sources = controller_sources(controller)
    for name, content in {**sources.files(), "counted.h": COUNTED}.items():
        (tmp_path / name).write_text(content.replace("#include <math.h>", ""))
    command = ["g++", "-include", "counted.h", "-I.", "-x", "c++", "-shared", "-fPIC", "controller.c", "-o", "c.so"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    library, state = ctypes.CDLL(str(tmp_path / "c.so")), ctypes.create_string_buffer(sources.cost.state)
    counter = ctypes.c_long.in_dll(library, "counted_operations")
    y, r, u = (ctypes.c_double * 2)(0.1, 0.2), (ctypes.c_double * 1)(0.3), (ctypes.c_double * 1)()
    for _ in range(2):
        counter.value = 0
        assert library.controller_act(state, y, r, r, u) == 0
    # Half of the hidden units are not negative, and are not multiplied; all are counted. fabs is free here.
    assert counter.value == pytest.approx(sources.cost.flops, rel=0.06)
