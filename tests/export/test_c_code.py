"""The C of a controller and of a model act as they do in Python, and are compiled."""

import copy
import ctypes
import math
import os
import re
import subprocess

import jinja2
import numpy as np
import pytest
import torch
from controllers import HOSTILE, oven_controller, pendulum_controller, pendulum_model, rotor_controller

from dynasindy.agents import actor
from dynasindy.control import Controller, Observer, load, save
from dynasindy.control.c_code import fill
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.export import Native, controller_sources, model_sources
from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import comment, number
from dynasindy.systems import Pendulum, Signature, Stops, Tras, integrate
from dynasindy.systems.compiler import compile_library, compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def flown(act, plant, controller, r, rate, periods=60):
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


def by_torch(controller):
    """The same controller with a policy of which C knows nothing."""
    return Controller(
        lambda shown: controller.policy(shown), controller.setup, controller.observer, controller.integral
    )


def apart(controller, act, plant, n_r):
    """The largest difference of a controller's inputs from those of another form of it, along a moving reference."""
    amplitude, omega = 0.3, 2.0

    def r(k):
        return [amplitude * math.sin(omega * k * controller.dt)] * n_r

    def rate(k):
        return [amplitude * omega * math.cos(omega * k * controller.dt)] * n_r

    expected = flown(by_torch(controller).act, plant, controller, r, rate)
    assert expected.std() > 0.005
    return np.abs(flown(act, plant, controller, r, rate) - expected).max()


def difference(controller, plant, n_r):
    return apart(controller, Native(controller_sources(controller)).act, plant, n_r)


@needs_compiler
def test_a_controller_acts_by_its_own_code_where_it_can():
    """Its numbers are those of the exported C; with a policy that is not ours they are those of torch."""
    controller, native = pendulum_controller(integral={}), Native(controller_sources(pendulum_controller(integral={})))
    readings = [[0.1 * math.sin(0.3 * k), math.nan] for k in range(20)]
    ours = [controller.act(y, [0.3])[0] for y in readings]
    assert ours == [native.act(y, [0.3])[0] for y in readings]
    other = by_torch(controller)
    np.testing.assert_allclose([other.act(y, [0.3])[0] for y in readings], ours, atol=1e-6)
    np.testing.assert_allclose(other.estimate, controller.estimate, atol=1e-9)
    copied = copy.deepcopy(controller)
    assert controller.act([0.2, math.nan], [0.3]) == copied.act([0.2, math.nan], [0.3])


KINDS = [
    {},
    {"integral": {"gain": 3.0, "band": 0.9, "rate": 0.4, "limit": 0.05}},
    {"delay": 0.04, "stops": False},
    {"observer": False, "integral": {"band": 0.9}},
    {"ends": [[-0.02], [0.05]]},
    {"observer": False, "ends": [[0.185], [0.216]]},
    {"step": 0.02, "delay": 0.06},
    {"step": 0.04, "delay": 0.0, "stops": False, "disturbance": False},
]
"""Controllers that differ by all that an exported one may have."""


@needs_compiler
@pytest.mark.parametrize("settings", KINDS, ids=str)
def test_it_flies_a_pendulum_as_python_does(tmp_path, settings):
    assert difference(pendulum_controller(**settings), Pendulum(), 1) < 1e-6
    for name, text in controller_sources(pendulum_controller(**settings)).files().items():
        (tmp_path / name).write_text(text)
    compile_library([tmp_path / "controller.c"], tmp_path / "controller.so")  # without a warning of any kind


@needs_compiler
@pytest.mark.parametrize("integral", [None, {"band": 0.5, "gain": 2.0}])
def test_it_flies_two_rotors_as_python_does(integral):
    assert difference(rotor_controller(integral), Tras(), 2) < 1e-6


@needs_compiler
def test_an_output_without_a_rate_beside_one_with_a_rate_is_flown_as_in_python(tmp_path):
    """The integral of an output without a rate grows as if it stood still, so it is another one than with the rate."""
    integral = {"band": 0.5, "gain": 2.0, "rate": 0.02}
    mixed, whole = rotor_controller(integral, damped=["Omega_a", None]), rotor_controller(integral)
    save(mixed, tmp_path / "controller.json")
    read = load(tmp_path / "controller.json")
    assert read.setup.task.rate_names == ["Omega_a", None]
    assert difference(read, Tras(), 2) < 1e-6
    assert apart(whole, Native(controller_sources(mixed)).act, Tras(), 2) > 1e-4


def from_hot(act, controller, periods=60):
    """Inputs and measurements of a flight of the model itself, whose both stores are at 80 degC in the beginning."""
    rng, x, found = np.random.default_rng(6), torch.tensor([80.0, 80.0], dtype=torch.float64), []
    for k in range(periods):
        y = math.nan if k % 7 == 3 else round((float(x[0]) + 0.05 * rng.standard_normal()) / 0.1) * 0.1
        u = act([y, math.nan], [60.0 + 20 * (k > 30)], [0.0])
        found.append((float(np.asarray(u)[0]), y))
        x = integrate(controller.observer.model, x, torch.as_tensor(np.array(u)), controller.dt, 4)[0][-1]
    return np.array(found)


@needs_compiler
@pytest.mark.parametrize("pushed", [True, False])
def test_a_store_that_nobody_measures_begins_at_80_degrees_as_in_python(pushed):
    controller = oven_controller(pushed)
    other = by_torch(controller)
    expected = from_hot(other.act, controller)
    assert expected[:, 0].std() > 0.005
    estimate = other.estimate[1]  # of a store that is between what it was at first and the air, not near zero
    assert 60 < estimate < 85
    found = from_hot(Native(controller_sources(controller)).act, controller)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@needs_compiler
@pytest.mark.parametrize("observer", [True, False])
def test_a_one_sided_actuator_is_off_where_the_first_call_is_refused_and_never_set_below(observer):
    """A motor of 0 to 12 V gets 0 V, and not the half of its power."""
    signature = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 3.0), [[-12, 12]], [[0, 1]], ["V"])
    controller = pendulum_controller(observer=observer, signature=signature)
    controller.network.layers()[-1].bias.sub_(0.19)  # about zero
    native = Native(controller_sources(controller))
    with pytest.raises(ValueError, match="not finite"):
        native.act([0.1, 0.2], [math.nan])
    u = native._u
    assert signature.in_own_units(u).tolist() == [0.0]
    found = np.array([native.act([0.3 * math.sin(k), 0.1], [0.3], [0.0]) for k in range(60)])
    assert found.min() == 0.0 < found.max() <= 1.0


@needs_compiler
def test_a_reset_forgets_everything_and_what_is_no_number_changes_nothing():
    native = Native(controller_sources(pendulum_controller(integral={})))
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
def test_where_a_model_explodes_the_observer_begins_anew_in_c_and_python_alike():
    controller = pendulum_controller(delay=0.07)
    controller.observer.stops = Stops((0,), (1,), (-0.6,), (math.inf,))
    controller.observer.model.set_coefficients(controller.observer.model.coefficients * -400.0)
    other = by_torch(controller)
    acts = other.act, Native(controller_sources(controller)).act
    expected, found = (answers(act, [[0.4 * math.sin(k), math.nan] for k in range(30)], [0.3]) for act in acts)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert other.estimate == pytest.approx([0.4 * math.sin(29), 0.0], abs=1e-3)


@needs_compiler
def test_outputs_of_one_unit_have_each_their_own_box_after_save_and_load(tmp_path):
    signature = Signature(("a", "b"), ("m", "m"), ("u", "v"), (3.0, 0.5))
    task = Tracking(signature, Step([[0.0, 0.0]]), ("a", "b"), (), low=[0.0, 0.0], high=[0.0, 0.0])
    policy = actor(task.n_o, 2, (4,)).requires_grad_(False)
    for layer, weight in zip(policy.module.layers(), (torch.eye(4), torch.eye(4)[2:]), strict=True):
        layer.weight.copy_(weight)  # u = tanh(error / (0.5 box)) for errors > 0
        layer.bias.zero_()
    save(Controller(policy, ControlSetup(task, 0.1)), tmp_path / "controller.json")
    found = Native(controller_sources(load(tmp_path))).act([0.0, 0.0], [0.3, 0.2])
    np.testing.assert_allclose(found, [math.tanh(0.3 / 1.5), math.tanh(0.2 / 0.25)], atol=1e-6)


WATCHED = ("-O1", "-std=c99", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
"""Settings under which a program ends where it reads or writes beside an array, or does what C leaves undefined."""


@needs_compiler
@pytest.mark.parametrize("settings", KINDS[1:2] + KINDS[3:4], ids=str)
def test_no_array_is_read_or_written_beyond_its_ends(tmp_path, settings):
    sources = controller_sources(pendulum_controller(**settings))
    program = """#include <math.h>
#include <stdio.h>
#include "controller.h"
int main(void)
{
    static controller_state s;
    int k, status = 0;
    controller_reset(&s);
    for (k = 0; k < 60; k++) {
        double y[2] = {0.4 * sin(0.2 * k), 0.1}, r[1] = {0.3}, rate[1] = {0.05 * k}, u[1];
        status |= controller_act(&s, y, r, rate, u);
        printf("%.17g\\n", u[0]);
    }
    return status;
}
"""
    for name, text in {**sources.files(), "main.c": program, "empty.c": "int main(void) { return 0; }\n"}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")

    def built(*files):
        given = [compiler(), *WATCHED, *(str(tmp_path / file) for file in files), "-o", str(tmp_path / "main"), "-lm"]
        return subprocess.run(given, capture_output=True).returncode == 0

    if not built("empty.c"):
        pytest.skip("this computer's compiler cannot watch arrays")
    assert built("controller.c", "main.c")
    quiet = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}  # leaks are looked for by a debugger, which may be refused
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, env=quiet)
    assert not done.returncode, done.stderr[:2000]
    native = Native(sources)
    expected = [native.act([0.4 * math.sin(0.2 * k), 0.1], [0.3], [0.05 * k])[0] for k in range(60)]
    np.testing.assert_allclose([float(line) for line in done.stdout.split()], expected, atol=1e-9)


@needs_compiler
def test_names_of_a_file_become_no_code():
    sources = controller_sources(pendulum_controller(signature=HOSTILE))
    for text in (sources.header, sources.source):
        bare = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        assert "int f()" not in bare and "°" not in text and "*/" not in bare
    assert "controller_x_int = 0" in sources.header and "controller_x_x_y_z__ = 1" in sources.header
    Native(sources)


GLITCHES = (1e6, -1e38, 1e60, -1e150, 1e155, 1e160, 1e308, math.inf, -math.inf, math.nan)


def answers(act, readings, r):
    """What a controller answers to each reading; None where it refuses."""
    found = []
    for y in readings:
        try:
            found.append(act(y, r))
        except ValueError:
            found.append(None)
    return found


def glitched(controller, seed, periods=120):
    """Readings of a swing of which a tenth is broken in one sensor or in all, the first one, too."""
    rng, scale = np.random.default_rng(seed), np.array(controller.signature.x_scale)
    sensors = [k for k, name in enumerate(controller.signature.state_names) if name in controller.measured]
    readings = []
    for k in range(periods):
        y = np.full(len(scale), math.nan)
        y[sensors] = 0.2 * scale[sensors] * math.sin(0.11 * k)
        if rng.random() < 0.1 or k == 0:
            y[sensors if rng.random() < 0.3 else rng.choice(sensors)] = rng.choice(GLITCHES)
        readings.append(y)
    return readings


@needs_compiler
@pytest.mark.parametrize("kind", ["pendulum", "late", "oven", "rotors"])
def test_broken_samples_are_answered_as_in_python_call_by_call(kind):
    controller = {
        "pendulum": lambda: pendulum_controller(integral={"gain": 3.0}, delay=0.0, stops=False),
        "late": lambda: pendulum_controller(disturbance=False),
        "oven": oven_controller,
        "rotors": rotor_controller,
    }[kind]()
    readings = glitched(controller, 0, 40 if kind == "rotors" else 120)
    r = [70.0 if kind == "oven" else 0.1] * len(controller.outputs)
    expected = answers(by_torch(controller).act, readings, r)
    found = answers(Native(controller_sources(controller)).act, readings, r)
    refused = [bool(np.isinf(y).any()) for y in readings]
    assert [u is None for u in expected] == refused == [u is None for u in found]
    assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(expected, found, strict=True) if a is not None)


@needs_compiler
@pytest.mark.filterwarnings("ignore:the reference")
def test_a_refused_call_leaves_the_controller_as_it_was():
    """A reference beyond single precision leaves no finite action, after the observer has moved on."""
    controller = pendulum_controller(integral={"gain": 3.0})
    native = Native(controller_sources(controller))
    whole, kept = [], []
    for act in (by_torch(controller).act, native.act):
        for k in range(40):
            y = [0.2 * math.sin(0.1 * k), math.nan]
            (whole if k % 7 == 3 else kept).append(answers(act, [y], [1e308 if k % 7 == 3 else 0.1])[0])
    assert whole == [None] * 12
    np.testing.assert_allclose(kept[34:], kept[:34], atol=1e-6)


def test_so_many_states_that_a_call_would_overflow_the_stack_are_refused():
    n = 500
    names = tuple(f"x{k}" for k in range(n))
    signature = Signature(names, ("-",) * n, ("u",), (1.0,) * n)
    model = SindyModel(signature, [*names[:1], "u"])
    model.set_coefficients(torch.tensor([[-1.0] * n, [1.0] * n], dtype=torch.float64))
    task = Tracking(signature, Step([[0.0]]), ("x0",), (), TrackingReward((1.0,)), low=[0.0], high=[1.0])
    setup = ControlSetup(task, 0.1)
    watching = Observer(model, Sensors({"x0": {"noise": 0.01}}, disturbance=False), setup)
    watching.load_state_dict({"process_noise": [0.01] * n, "nis": 1.0})
    policy = actor(task.n_o, 1, (4, 4)).requires_grad_(False)
    with pytest.raises(ValueError, match="stack"):
        controller_sources(Controller(policy, setup, watching))


WORDS = ["1", "a", "a |a| b", "sign(b)", "exp(-(2 a)^2)", "sqrt(b - 0.3)", "max(0, a - -0.2)", "b /(1 + 3 cos(a)^2)"]


def compiled(sources, folder, result="dx"):
    for name, text in sources.files().items():
        (folder / name).write_text(text)
    call = getattr(
        ctypes.CDLL(str(compile_library([folder / f"{sources.name}.c"], folder / "m.so"))), f"{sources.name}_{result}"
    )

    def field(x, u, n):
        dx = (ctypes.c_double * n)()
        call((ctypes.c_double * len(x))(*x), (ctypes.c_double * max(1, len(u)))(*u), dx)
        return list(dx)

    return field


@needs_compiler
def test_it_computes_what_the_library_computes(tmp_path):
    model = SindyModel(Signature(("a", "b"), ("-", "-"), ("c",), (1.0, 1.0)), WORDS)
    table = np.random.default_rng(1).standard_normal((len(WORDS), 2))
    model.set_coefficients(torch.from_numpy(table))
    model.delay = 0.25
    sources = model_sources(model, "m1")
    field = compiled(sources, tmp_path)
    for x in np.random.default_rng(2).uniform(-1, 1, (20, 2)):
        expected = model.library(torch.from_numpy(x), torch.zeros(1)).numpy() @ table
        assert field(x, [0.0], 2) == pytest.approx(list(expected), rel=1e-12, abs=1e-14)
    assert "Inputs act 0.25 s after they are given" in " ".join(sources.header.split())
    for special in (-np.inf, np.nan):
        ours = np.array(field([0.1, special], [0.0], 2))
        with np.errstate(invalid="ignore"):
            theirs = model.library(torch.tensor([0.1, special]), torch.zeros(1)).numpy() @ table
        assert (np.isfinite(ours) == np.isfinite(theirs)).all()


@needs_compiler
def test_without_terms_or_inputs_it_compiles_too(tmp_path):
    model = SindyModel(Signature(("a",), ("-",), (), (1.0,)), ["a"])
    assert compiled(model_sources(model), tmp_path)([2.0], [], 1) == [0.0]


@needs_compiler
def test_hostile_names_are_comments_and_places_alone(tmp_path):
    sources = model_sources(pendulum_model(HOSTILE))
    assert compiled(sources, tmp_path)([0.0, 0.0], [0.5], 2) == [0.0, 4.0]
    bare = re.sub(r"/\*.*?\*/", "", sources.header, flags=re.S)
    assert "model_x_int = 0" in bare and "f()" not in bare


@needs_compiler
def test_a_difference_equation_is_what_comes_next(tmp_path):
    """theta+ = theta + 0.05 Omega and Omega+ = Omega + 0.05 (8 u - 0.6 Omega - 2.5 tanh(3.7 theta) ...)."""
    sources = model_sources(pendulum_model(step=0.05))
    assert "x[k+1] = F(x[k], u[k])" in sources.header and "A step takes 0.05 s" in " ".join(sources.header.split())
    following = compiled(sources, tmp_path, "next")
    theta, omega, u = 0.4, -1.5, 0.3
    push = 8 * u - 0.6 * omega - 2.5 * math.tanh(3.7 * theta) - 6 * math.sin(theta) - 0.04 * omega * abs(omega)
    assert following([theta, omega], [u], 2) == pytest.approx([theta + 0.05 * omega, omega + 0.05 * push], rel=1e-12)


def test_identifiers_are_of_ascii_letters_and_differ():
    names = ("a b", "a_b", "a.b", "a_b_2", "Ωmega", "int")
    model = SindyModel(Signature(names, ("-",) * 6, ("u",), (1.0,) * 6), ["u"])
    found = re.findall(r"^ *model_x_(.*) = \d", model_sources(model).header, re.M)
    assert found[0] == "a_b" and found[-1] == "int"
    assert len(set(found)) == 6
    assert all(re.fullmatch(r"[A-Za-z0-9_]+", word) for word in found)


@pytest.mark.parametrize(
    "words", ["*/ int f() /*", "/*/", "*/*/*", "*°/", "a\\", "a\nb", "a??/", "·/", "/·", "\x00", "³·/²"]
)
def test_no_words_end_a_comment_or_begin_one(words):
    shown = comment(words)
    assert "*/" not in shown and "/*" not in shown and not set("\\\n?\x00") & set(shown)
    assert shown.isascii() and comment(shown) == shown


def test_a_number_is_exact_and_finite():
    for value in (0.1, -1e-300, 3, 1 / 3, 5e22):
        assert float(number(value).strip("()")) == value
    assert number(-2.5) == "(-2.5)"
    with pytest.raises(ValueError, match=r"inf .*finite"):
        number(math.inf)
    with pytest.raises(ValueError, match="nan stands"):
        number(math.nan)
    with pytest.raises(ValueError, match="could not convert"):
        number("system()")


@pytest.mark.parametrize("name", ["", "1a", "a-b", "a b", "a" * 32, "é", "a\n"])
def test_what_begins_no_name_of_c_is_refused(name):
    with pytest.raises(ValueError, match="letter"):
        model_sources(SindyModel(Pendulum().signature, ["u"]), name)


def test_what_is_filled_in_is_not_looked_at_again():
    with pytest.raises(jinja2.UndefinedError):
        fill("model.h", name="m")
    text = fill("model.h", name="m", kind="{{ 1 + 1 }}", about=["@ if x"], places=["m_x_a = 0"], head="void f(void)")
    assert "{{ 1 + 1 }}" in text and " * @ if x\n" in text


@needs_compiler
def test_two_controllers_of_one_name_live_side_by_side():
    one, other = (
        Native(controller_sources(pendulum_controller(observer=False, integral=i))) for i in (None, {"gain": 5.0})
    )
    first = [one.act([0.1, 0.0], [0.12])[0], other.act([0.1, 0.0], [0.12])[0]]
    assert first[0] == first[1]
    assert one.act([0.1, 0.0], [0.12])[0] == first[0]
    assert other.act([0.1, 0.0], [0.12])[0] != first[1]
    with pytest.raises(ValueError, match=r"1 .* where 2"):
        one.act([0.1], [0.12])


@needs_compiler
def test_calls_that_are_timed_are_forgotten():
    one = Native(controller_sources(pendulum_controller(observer=False, integral={})))
    first = one.act([0.1, 0.0], [0.12])
    assert one.microseconds() > 0
    assert one.act([0.1, 0.0], [0.12]) == first
