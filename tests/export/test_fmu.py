"""FMUs are what their standard says, and a controller and a plant coupled by FMPy fly as they do in Python."""

import math
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

from dynasindy import __version__
from dynasindy.export import fmu
from dynasindy.export.fmu import controller_fmu, plant_fmu
from dynasindy.systems import Signature, integrate
from dynasindy.systems.compiler import compiler
from dynasindy.world_models import SindyModel

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def described(path):
    with zipfile.ZipFile(path) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml")), set(archive.namelist())


def test_without_a_compiler_it_holds_sources_and_says_so(pendulum, tmp_path, monkeypatch):
    monkeypatch.setattr(fmu, "compiler", lambda: None)
    assert controller_fmu(pendulum(), tmp_path / "c.fmu") is False
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
def test_a_plant_takes_inputs_and_gives_states_that_may_be_set_at_the_start(
    pendulum_model, tmp_path, monkeypatch, version, token
):
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


def test_the_same_controller_is_the_same_file_and_another_has_another_token(pendulum, tmp_path, monkeypatch):
    monkeypatch.setattr(fmu, "compiler", lambda: None)
    for name, settings in (("a", {}), ("b", {}), ("c", {"delay": 0.03})):
        controller_fmu(pendulum(**settings), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    tokens = [described(tmp_path / name)[0].get("instantiationToken") for name in "ac"]
    assert tokens[0] != tokens[1]


def test_what_is_no_version_or_has_no_inputs_is_refused(pendulum, pendulum_model, tmp_path):
    with pytest.raises(ValueError, match="FMI 1 is not written; allowed are 2 and 3"):
        controller_fmu(pendulum(), tmp_path / "c.fmu", version=1)
    with pytest.raises(ValueError, match="name is 'a/b'"):
        plant_fmu(pendulum_model(), tmp_path / "p.fmu", 0.01, name="a/b")
    alone = SindyModel(Signature(("a",), ("-",), (), (1.0,)), ["a"])
    with pytest.raises(ValueError, match="this model has none"):
        plant_fmu(alone, tmp_path / "p.fmu", 0.01)
    assert not list(tmp_path.iterdir())


class Unit:
    """An FMU that FMPy runs, with its variables by name."""

    def __init__(self, path, folder):
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(path)
        self.new = description.fmiVersion.startswith("3")
        made = FMU3Slave if self.new else FMU2Slave
        self.unit = made(
            guid=description.guid,
            unzipDirectory=fmpy.extract(path, unzipdir=str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.places = {v.name: v.valueReference for v in description.modelVariables}
        self.unit.instantiate()
        if not self.new:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()

    def set(self, **values):
        places = [self.places[name] for name in values]
        (self.unit.setFloat64 if self.new else self.unit.setReal)(places, list(values.values()))

    def get(self, *names):
        return (self.unit.getFloat64 if self.new else self.unit.getReal)([self.places[name] for name in names])

    def step(self, now, h):
        self.unit.doStep(currentCommunicationPoint=now, communicationStepSize=h)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_they_are_valid_and_fly_coupled_as_they_do_in_python(pendulum, hostile, tmp_path, version):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed: pip install -e '.[export]'")
    from fmpy.validation import validate_fmu

    controller = pendulum(integral={"band": 0.9}, delay=0.07)
    model, stops, dt = controller.observer.model, controller.observer.stops, controller.dt
    files = [str(tmp_path / name) for name in ("c.fmu", "p.fmu", "h.fmu")]
    assert controller_fmu(controller, tmp_path / "c.fmu", version=version)
    assert plant_fmu(model, tmp_path / "p.fmu", dt / 3, stops, version=version)
    assert controller_fmu(pendulum(signature=hostile), tmp_path / "h.fmu", version=version)
    assert [validate_fmu(file) for file in files] == [[], [], []]
    assert fmpy.supported_platforms(files[0])[0] == "c-code" and len(fmpy.supported_platforms(files[0])) == 2
    ours, plant = Unit(files[0], tmp_path / "c"), Unit(files[1], tmp_path / "p")
    plant.set(x_theta=0.2)
    for unit in (ours, plant):
        unit.unit.exitInitializationMode()
    x, past = torch.tensor([0.2, 0.0], dtype=torch.float64), [torch.zeros(1)] * 2
    worst = 0.0
    for k in range(150):
        r, y = 0.3 * math.sin(0.08 * k), math.nan if k % 10 == 3 else float(x[0])
        past.append(torch.from_numpy(controller.act([y, math.nan], [r], [0.0])).double())
        ours.set(y_theta=math.nan if k % 10 == 3 else plant.get("x_theta")[0], r_theta=r, rate_theta=0.0)
        ours.step(k * dt, dt)
        plant.set(u_u=ours.get("u_u")[0])
        plant.step(k * dt, dt)
        # An input acts 0.07 s after it is given: within a period of 0.04 s two of them do.
        for u, seconds, steps in ((past[-3], 0.03, 3), (past[-2], 0.01, 1)):
            x = integrate(model, x, u, seconds, steps, stops)[0][-1]
        states = np.array(plant.get("x_theta", "x_Omega"))
        worst = max(worst, np.abs(states - x.numpy()).max(), abs(ours.get("u_u")[0] - float(past[-1])))
    assert worst < 1e-6
    assert abs(float(x[0])) > 0.005
