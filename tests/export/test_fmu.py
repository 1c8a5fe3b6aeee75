"""FMUs are what their standard says, and a controller and a plant coupled by FMPy fly as they do in Python."""

import ctypes
import math
import zipfile
from xml.etree import ElementTree

import pytest
import torch
from controllers import pendulum_controller, pendulum_model, rotor_controller

from dynasindy import __version__
from dynasindy.control.c_code import Native
from dynasindy.export import controller_sources, fmu
from dynasindy.export.fmu import controller_fmu, plant_fmu
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.compiler import compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def described(path):
    with zipfile.ZipFile(path) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml")), set(archive.namelist())


def test_without_a_compiler_it_holds_sources_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(fmu, "compiler", lambda: None)
    assert controller_fmu(pendulum_controller(), tmp_path / "c.fmu") is False
    root, files = described(tmp_path / "c.fmu")
    assert files == {"modelDescription.xml", *(f"sources/{n}" for n in (
        "buildDescription.xml", "controller.c", "controller.h", "controller_fmi.c"))}  # fmt: skip
    variables = {v.get("name"): (v.get("causality"), v.get("unit")) for v in root.find("ModelVariables")}
    assert variables == {
        "time": ("independent", None),
        "y_theta": ("input", "rad"),
        "r_theta": ("input", "rad"),
        "rate_theta": ("input", "rad/s"),
        "u_u": ("output", "1"),
    }
    assert [output.get("valueReference") for output in root.find("ModelStructure")] == ["4"]


@pytest.mark.parametrize(("version", "token"), [(2, "guid"), (3, "instantiationToken")])
def test_a_plant_takes_inputs_and_gives_states_that_may_be_set_at_the_start(tmp_path, monkeypatch, version, token):
    monkeypatch.setattr(fmu, "compiler", lambda: None)
    plant_fmu(pendulum_model(), tmp_path / "p.fmu", 0.02, version=version)
    root, _ = described(tmp_path / "p.fmu")
    assert root.get("fmiVersion") == f"{version}.0" and root.get(token).startswith("{")
    assert root.get("generationTool") == f"dynasindy {__version__}"
    assert root.find("DefaultExperiment").get("stepSize") == "0.02"
    assert [unit.get("name") for unit in root.find("UnitDefinitions")] == ["1", "rad", "rad/s"]
    variables = [(v.get("name"), v.get("causality"), v.get("initial")) for v in root.find("ModelVariables")]
    time = [("time", "independent", None)] if version == 3 else []
    outputs = [(name, "output", "exact") for name in ("x_theta", "x_Omega")]
    assert variables == [*time, ("u_u", "input", None), *outputs]
    assert {v.get("variability") for v in root.find("ModelVariables")} == {"continuous"}
    with zipfile.ZipFile(tmp_path / "p.fmu") as archive:  # each version lists what is to be compiled in its own place
        built = root if version == 2 else ElementTree.fromstring(archive.read("sources/buildDescription.xml"))
    listed = built.findall(".//File") if version == 2 else built.findall(".//SourceFile")
    assert [file.get("name") for file in listed] == ["plant.c"]


OK, ERROR = 0, 3
"""Statuses of both standards."""


class Library:
    """The library of an FMU, called as the standard's headers declare its functions."""

    def __init__(self, path, version, start=0.0):
        self.version, (root, files) = version, described(path)
        self.token = root.get("instantiationToken" if version == 3 else "guid").encode()
        self.places = {v.get("name"): int(v.get("valueReference")) for v in root.find("ModelVariables")}
        (name,) = (name for name in files if name.startswith("binaries/"))
        with zipfile.ZipFile(path) as archive:
            self.loaded = ctypes.CDLL(archive.extract(name, path.parent / path.stem))
        self.unit = self.made(self.token)
        setup = (False, ctypes.c_double(0), ctypes.c_double(start), False, ctypes.c_double(0))
        assert self.call("EnterInitializationMode" if version == 3 else "SetupExperiment", *setup) == OK

    def function(self, name):
        return self.loaded[f"fmi{self.version}{name}"]

    def made(self, token, special=False, intermediate=0):
        make = self.function("InstantiateCoSimulation" if self.version == 3 else "Instantiate")
        make.restype, null, n = ctypes.c_void_p, ctypes.c_void_p(), ctypes.c_size_t(intermediate)
        if self.version == 3:
            return make(b"unit", token, b"", False, False, special, False, null, n, null, null, null)
        return make(b"unit", 0 if special else 1, token, b"", null, False, False)

    def call(self, name, *given):
        return self.function(name)(ctypes.c_void_p(self.unit), *given)

    def numbers(self, way, places, values, count=None):
        """Return the status, and what is in the array then."""
        kind = ctypes.c_uint32 if self.version == 3 else ctypes.c_uint
        array, n = (ctypes.c_double * len(values))(*values), ctypes.c_size_t(len(places))
        more = (ctypes.c_size_t(len(values) if count is None else count),) if self.version == 3 else ()
        name = f"{way}Float64" if self.version == 3 else f"{way}Real"
        return self.call(name, (kind * len(places))(*places), n, array, *more), list(array)

    def set(self, **values):
        status, _ = self.numbers("Set", [self.places[name] for name in values], list(values.values()))
        assert status == OK

    def get(self, *names):
        status, found = self.numbers("Get", [self.places[name] for name in names], [0.0] * len(names))
        assert status == OK
        return found

    def step(self, now, h):
        flags, reached = [ctypes.c_bool(True) for _ in range(3)], ctypes.c_double(-1)
        told = [ctypes.byref(each) for each in (*flags, reached)] if self.version == 3 else []
        status = self.call("DoStep", ctypes.c_double(now), ctypes.c_double(h), False, *told)
        if self.version == 3:
            assert not any(flag.value for flag in flags)
            assert reached.value == pytest.approx(now + h if status == OK else now)
        return status


def linear(*rows, delay=0.0):
    """A model x' = A x + b u of states x1, x2..., rows of A and b."""
    names = tuple(f"x{i}" for i in range(1, 1 + len(rows)))
    model = SindyModel(Signature(names, ("-",) * len(rows), ("u",), (1.0,) * len(rows)), [*names, "u"])
    model.set_coefficients(torch.tensor(rows, dtype=torch.float64).mT)
    model.delay = delay
    return model


@needs_compiler
@pytest.mark.parametrize(("version", "delay"), [(2, 0.07), (3, 0.07), (3, 0.0)])
def test_inputs_of_a_plant_act_as_late_as_its_model_says_in_steps_of_any_length(tmp_path, version, delay):
    """x1' = u and x2' = x1, so that the states are the first and the second integral of the inputs, made later."""
    plant_fmu(linear([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], delay=delay), tmp_path / "p.fmu", 0.02, version=version)
    plant, now, begun = Library(tmp_path / "p.fmu", version, start=5.0), 5.0, []
    plant.set(x_x1=0.3, x_x2=-0.1)
    for h, u in zip((0.03, 0.05, 0.02, 0.11, 0.04, 0.3, 0.01, 0.07), (0.5, -1.0, 0.25, 1.0, 0.8, -0.6, 0.1, 0.9)):
        plant.set(u_u=u)
        assert plant.step(now, h) == OK
        begun.append((now + delay, u - (begun[-1][2] if begun else 0.0), u))
        now += h
        left = [(max(0.0, now - begin), change) for begin, change, _ in begun]  # a step that acted for so long
        first = 0.3 + sum(change * t for t, change in left)
        second = -0.1 + 0.3 * (now - 5.0) + sum(change * t**2 / 2 for t, change in left)
        assert plant.get("x_x1", "x_x2") == pytest.approx([first, second], abs=1e-12)


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_what_the_standard_forbids_is_an_error(tmp_path, version):
    plant_fmu(linear([0.0, 1.0], delay=1.0), tmp_path / "p.fmu", 0.02, version=version)
    plant = Library(tmp_path / "p.fmu", version)
    told = plant.function("GetVersion")
    told.restype = ctypes.c_char_p
    assert told() == f"{version}.0".encode()
    assert plant.made(b"{another}") is None and plant.made(None) is None and plant.made(plant.token, True) is None
    for place, status in ((0, ERROR), (1, OK), (2, OK), (3, ERROR)):  # an input and a state
        assert plant.numbers("Get", [place], [0.0])[0] == plant.numbers("Set", [place], [0.0])[0] == status
    assert [plant.step(0.0, h) for h in (0.0, -0.1, math.nan)] == [ERROR] * 3
    # 1024 inputs are remembered; a plant with a longer delay, or shorter steps, is refused and not simulated wrongly.
    assert {plant.step(1e-4 * k, 1e-4) for k in range(1024)} == {OK} and plant.step(0.1024, 1e-4) == ERROR
    assert plant.call("Reset") == OK and plant.step(0.0, 1e-4) == OK
    if version == 3:
        assert plant.made(plant.token, intermediate=1) is None
        assert [plant.numbers(way, [1], [0.0], count=2)[0] for way in ("Get", "Set")] == [ERROR, ERROR]
        assert plant.call("UpdateDiscreteStates") == ERROR and plant.call("Terminate") == OK


@needs_compiler
def test_a_controller_acts_at_the_multiples_of_its_period_whatever_the_steps_of_the_simulator(tmp_path):
    controller = rotor_controller(
        {"gain": 2.0, "rate": 0.3, "band": 0.9}
    )  # it reads two angles and two speeds of six states
    controller_fmu(controller, tmp_path / "c.fmu")
    unit, native, now = Library(tmp_path / "c.fmu", 3, start=2.0), Native(controller_sources(controller)), 2.0
    names, seen = controller.signature.state_names, [0.1, -0.2, 300.0, 500.0]
    measured = [name for name in ("alpha_a", "alpha_p", "omega_a", "omega_p") if f"y_{name}" in unit.places]
    # Periods of 0.05 s from 2 s on: at 0, then none, then 0.05 and 0.1, then none, then 0.15.
    for h, calls in ((0.03, 1), (0.02, 0), (0.07, 2), (0.03, 0), (0.05, 1)):
        y = dict(zip(measured, [value * (1 + now) for value in seen], strict=True))
        unit.set(**{f"y_{name}": value for name, value in y.items()}, r_alpha_a=0.1 * now, r_alpha_p=-0.1)
        unit.set(rate_alpha_a=0.1, rate_alpha_p=-0.3)
        for _ in range(calls):
            u = native.act([y.get(name, math.nan) for name in names], [0.1 * now, -0.1], [0.1, -0.3])
        assert unit.step(now, h) == OK
        now += h
        assert unit.get(*(f"u_{name}" for name in controller.signature.input_names)) == u.tolist()
    assert unit.call("Reset") == OK
    native.reset()
    expected = native.act([0.0 if name in measured else math.nan for name in names], [0.0, 0.0], [0.0, 0.0])
    assert unit.step(0.0, 0.05) == OK
    assert unit.get(*(f"u_{name}" for name in controller.signature.input_names)) == expected.tolist()
    unit.set(r_alpha_a=math.nan)
    assert unit.step(0.05, 0.05) == ERROR


@needs_compiler
@pytest.mark.parametrize(("version", "delay"), [(2, 0.0), (3, 0.2)])
def test_a_plant_in_discrete_time_moves_by_whole_steps_alone(tmp_path, version, delay):
    """x1+ = -0.6 x1 + 0.3 u, every 0.1 s, whatever the step of Runge and Kutta is."""
    model = linear([-16.0, 3.0], delay=delay)
    model.library = model.library.with_step(0.1)
    plant_fmu(model, tmp_path / "p.fmu", 0.004, version=version)
    plant, now, x, inputs = Library(tmp_path / "p.fmu", version), 0.0, 1.0, [0.0] * round(delay / 0.1)
    plant.set(x_x1=x)
    for steps, u in ((1, 0.5), (2, -1.0), (1, 0.25), (3, 1.0)):
        plant.set(u_u=u)
        assert plant.step(now, 0.1 * steps) == OK
        now += 0.1 * steps
        for _ in range(steps):
            inputs.append(u)
            x = -0.6 * x + 0.3 * inputs.pop(0)
        assert plant.get("x_x1") == pytest.approx([x], abs=1e-12)
    assert plant.step(now, 0.05) == ERROR and plant.step(now, 0.15) == ERROR
    assert plant.get("x_x1") == pytest.approx([x], abs=1e-12)
