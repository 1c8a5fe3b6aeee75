"""The controller in C flies plants behind sensors as the one in Python does, and costs what it says."""

import ctypes
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.export import controller_sources
from dynasindy.export.compiler import STRICT, Native, build, compiler
from dynasindy.systems import Pendulum, Tras, integrate

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def flown(act, plant, controller, r, rate, periods=100):
    """Fly a plant behind noisy encoders that lose samples; every state that has no sensor is NaN."""
    rng = np.random.default_rng(4)
    names = controller.signature.state_names
    seen = [controller.observer is None or n in controller.observer.sensors.channels for n in names]
    scale = np.array(controller.signature.x_scale)
    x, inputs = torch.zeros(len(names), dtype=torch.float64), []
    for k in range(periods):
        y = x.numpy() + 0.002 * scale * rng.standard_normal(len(names)) * (controller.observer is not None)
        if controller.observer is not None:
            y = np.where(seen, np.round(y / scale / 0.0015) * 0.0015 * scale, math.nan)
            y = np.full_like(y, math.nan) if k % 9 == 4 else np.where(rng.random(len(y)) < 0.1, math.nan, y)
        inputs.append(act(y, r(k), rate(k)))
        # What arrives is late, as the model says, and pushed by half of the input.
        u = inputs[-2] if controller.observer is not None and k else inputs[-1]
        x = integrate(plant, x, torch.as_tensor(0.8 * u + 0.05), controller.dt, 4, plant.stops)[0][-1]
    return np.array(inputs)


def difference(controller, plant, n_r):
    native = Native(controller_sources(controller))
    amplitude, omega = 0.3, 2.0

    def r(k):
        return [amplitude * math.sin(omega * k * controller.dt)] * n_r

    def rate(k):
        return [amplitude * omega * math.cos(omega * k * controller.dt)] * n_r

    controller.reset()
    expected = flown(controller.act, plant, controller, r, rate)
    assert expected.std() > 0.005
    return np.abs(flown(native.act, plant, controller, r, rate) - expected).max()


@needs_compiler
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"integral": {"gain": 3.0, "band": 0.9, "rate": 0.4, "limit": 0.05}},
        {"delay": 0.0, "disturbance": False},
        {"delay": 0.04, "stops": False},
        {"observer": False},
        {"observer": False, "integral": {"band": 0.9}},
    ],
    ids=str,
)
def test_it_flies_a_pendulum_as_python_does(pendulum, settings):
    assert difference(pendulum(**settings), Pendulum(), 1) < 1e-6


@needs_compiler
@pytest.mark.parametrize("integral", [None, {"band": 0.5, "gain": 2.0}])
def test_it_flies_two_rotors_as_python_does(rotors, integral):
    assert difference(rotors(integral), Tras(), 2) < 1e-6


@needs_compiler
def test_a_reset_forgets_everything_and_what_is_no_number_changes_nothing(pendulum):
    native = Native(controller_sources(pendulum(integral={})))
    first = [native.act([0.1 * k, math.nan], [0.3])[0] for k in range(5)]
    with pytest.raises(ValueError, match="not finite"):
        native.act([0.1, math.nan], [math.nan])
    with pytest.raises(ValueError, match="not finite"):
        native.act([0.1, math.nan], [0.3], [math.inf])
    later = native.act([0.5, math.nan], [0.3])[0]
    native.reset()
    again = [native.act([0.1 * k, math.inf], [0.3], [0.0])[0] for k in range(5)]
    assert again == first and native.act([0.5, math.nan], [0.3])[0] == later


@needs_compiler
def test_without_an_observer_every_state_has_to_be_a_number(pendulum):
    native = Native(controller_sources(pendulum(observer=False)))
    with pytest.raises(ValueError, match="not finite"):
        native.act([0.1, math.nan], [0.3])


@needs_compiler
def test_a_model_that_explodes_leaves_a_finite_input(pendulum):
    controller = pendulum(delay=0.07)
    controller.observer.model.set_coefficients(controller.observer.model.coefficients * -400.0)
    native = Native(controller_sources(controller))
    expected = [controller.act([0.4 * math.sin(k), math.nan], [0.3])[0] for k in range(30)]
    found = [native.act([0.4 * math.sin(k), math.nan], [0.3])[0] for k in range(30)]
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:3], expected[:3], atol=1e-6)


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


def test_a_policy_or_a_model_of_another_kind_is_refused(pendulum):
    controller = pendulum()
    controller.policy = lambda tensordict: tensordict
    with pytest.raises(ValueError, match="allowed is the actor"):
        controller_sources(controller)
    with pytest.raises(ValueError, match="name is '1 a'; allowed are a letter"):
        controller_sources(pendulum(), "1 a")


@pytest.mark.parametrize("positions", [(7,), (-1,), ("0",)])
def test_stops_at_states_that_do_not_exist_are_refused(pendulum, positions):
    controller = pendulum()
    controller.observer.stops = replace(controller.observer.stops, positions=positions)
    with pytest.raises(ValueError, match="allowed are whole numbers from 0 to 1"):
        controller_sources(controller)


@needs_compiler
def test_names_of_a_file_become_no_code(pendulum, hostile):
    sources = controller_sources(pendulum(signature=hostile))
    for text in (sources.header, sources.source):
        bare = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        assert "int f()" not in bare and "°" not in text and "*/" not in bare
    assert "controller_x_int = 0" in sources.header and "controller_x_x_y_z__ = 1" in sources.header
    Native(sources)
