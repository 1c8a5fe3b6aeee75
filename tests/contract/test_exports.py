"""What `export` writes acts as the controller does, and moves as the model does."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest
import torch

import dynasindy
from dynasindy.sindy import SindyModel

CC = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
POINTS = np.random.default_rng(3).uniform(-1, 1, (10, 3))
FILES = {
    "c": {"controller.c", "controller.h"},
    "onnx": {"controller.onnx", "policy.onnx"},
    "fmu": {"controller.fmu", "plant.fmu"},
    "model": {"model.c", "model.h", "model.tex", "model.py"},
}


@pytest.fixture(scope="module")
def exported(planned, command, tmp_path_factory):
    """Return what writes a format, once for each, and returns its folder."""
    home, made = tmp_path_factory.mktemp("exported"), {}

    def write(name, *words):
        if (name, *words) not in made:
            folder = home / "_".join((name, *words)).replace("=", "_")
            given = (f"run={planned}", f"formats=[{name}]", f"folder={folder}", *words)
            done = command("export", *given, cwd=home)
            assert done.code == 0, done
            assert {file.name for file in folder.iterdir()} == FILES[name]
            made[name, *words] = folder
        return made[name, *words]

    return write


def calls(n=60):
    """Measurements of a moving pendulum, some of them lost, and references with their rates."""
    for k in range(n):
        y = [0.3 * math.sin(0.15 * k), 0.9 * math.cos(0.15 * k)]
        yield [math.nan] * 2 if k % 9 == 4 else y, [0.4 * math.cos(0.05 * k)], [-0.4 * math.sin(0.05 * k)]


def acts(controller):
    controller.reset()
    return np.array([controller.act(y, r, rate) for y, r, rate in calls()])


def test_onnx_acts_as_the_controller(exported, planned):
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install -e '.[export]'")
    folder = exported("onnx")
    session = runtime.InferenceSession(str(folder / "controller.onnx"), providers=["CPUExecutionProvider"])
    state, found = np.zeros(session.get_inputs()[0].shape), []
    for y, r, rate in calls():
        given = {"state": state, "measurement": np.array(y), "reference": np.array(r), "rate": np.array(rate)}
        u, state = session.run(["u", "next_state"], given)
        found.append(u)
    expected = acts(dynasindy.load(planned))
    assert expected.std() > 0.05
    np.testing.assert_allclose(np.reshape(found, expected.shape), expected, atol=1e-5)
    policy = runtime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
    rows = np.random.default_rng(0).standard_normal((7, policy.get_inputs()[0].shape[1])).astype(np.float32)
    (action,) = policy.run(["action"], {"observation": rows})
    assert action.shape == (7, 1) and action.std() > 0.01 and np.abs(action).max() <= 1


class Unit:
    """An FMU that FMPy runs, with its variables by name."""

    def __init__(self, path, folder):
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(str(path))
        self.new = description.fmiVersion.startswith("3")
        made = FMU3Slave if self.new else FMU2Slave
        self.unit = made(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), unzipdir=str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.places = {v.name: v.valueReference for v in description.modelVariables}
        self.unit.instantiate()
        if not self.new:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def set(self, **values):
        places = [self.places[name] for name in values]
        (self.unit.setFloat64 if self.new else self.unit.setReal)(places, list(values.values()))

    def get(self, *names):
        return (self.unit.getFloat64 if self.new else self.unit.getReal)([self.places[name] for name in names])

    def step(self, now, h):
        self.unit.doStep(currentCommunicationPoint=now, communicationStepSize=h)


@pytest.mark.skipif(CC is None, reason="there is no C compiler on this computer")
@pytest.mark.parametrize("version", [2, 3])
def test_fmus_are_valid_act_as_the_controller_and_move_as_the_model(exported, planned, tmp_path, version):
    pytest.importorskip("fmpy", reason="FMPy is not installed: pip install -e '.[export]'")
    from fmpy.validation import validate_fmu

    folder, controller = exported("fmu", f"fmi={version}"), dynasindy.load(planned)
    assert [validate_fmu(str(folder / f"{name}.fmu")) for name in ("controller", "plant")] == [[], []]
    unit, plant = (Unit(folder / f"{name}.fmu", tmp_path / name) for name in ("controller", "plant"))
    measured, found = [name for name in ("theta", "Omega") if f"y_{name}" in unit.places], []
    for k, (y, r, rate) in enumerate(calls()):
        unit.set(**{f"y_{name}": y[("theta", "Omega").index(name)] for name in measured}, r_theta=r[0])
        if "rate_theta" in unit.places:
            unit.set(rate_theta=rate[0])
        unit.step(k * controller.dt, controller.dt)
        found.append(unit.get("u_u"))
    np.testing.assert_allclose(found, acts(controller), atol=1e-5)
    model, x = SindyModel.load(planned / "model.json"), torch.zeros(2, dtype=torch.float64)
    for k in range(20):
        plant.set(u_u=0.4)
        plant.step(0.01 * k, 0.01)
        for _ in range(10):  # by Euler's steps of a millisecond
            with torch.no_grad():
                x = x + 0.001 * model(x, torch.tensor([0.4], dtype=torch.float64))
    np.testing.assert_allclose(plant.get("x_theta", "x_Omega"), x.numpy(), rtol=0.02)


def test_the_model_is_the_same_in_c_casadi_and_python(exported, planned):
    """Omega' = 12 u - 9.81 sin(theta) - 0.5 Omega, as it was identified."""
    folder, model = exported("model"), SindyModel.load(planned / "model.json")
    fields = {}
    if CC:
        subprocess.run([CC, "-shared", "-fPIC", "model.c", "-lm", "-o", "m.so"], cwd=folder, check=True)
        call = ctypes.CDLL(str(folder / "m.so")).model_dx

        def native(x, u):
            dx = (ctypes.c_double * 2)()
            call((ctypes.c_double * 2)(*x), (ctypes.c_double * 1)(u), dx)
            return list(dx)

        fields["c"] = native
        (folder / "m.so").unlink()
    scope = {}
    try:
        import casadi  # noqa: F401
    except ModuleNotFoundError:
        pass
    else:
        exec(compile((folder / "model.py").read_text(), "model.py", "exec"), scope)
        function = scope["function"]()
        fields["casadi"] = lambda x, u: np.array(function(x, u)).ravel()
    assert fields
    for theta, omega, u in POINTS:
        x = torch.tensor([theta, omega], dtype=torch.float64)
        with torch.no_grad():
            expected = model(x, torch.tensor([u], dtype=torch.float64)).numpy()
        np.testing.assert_allclose(expected, [omega, 12 * u - 9.81 * math.sin(theta) - 0.5 * omega], atol=0.2)
        for field in fields.values():
            np.testing.assert_allclose(field([theta, omega], u), expected, rtol=1e-9, atol=1e-12)


def test_a_model_alone_gives_its_own_files_and_no_controller(command, planned, tmp_path):
    source = tmp_path / "alone" / "model.json"
    source.parent.mkdir()
    shutil.copy(planned / "model.json", source)
    done = command("export", f"run={source}", "formats=[c,model]", f"folder={tmp_path}/out", cwd=tmp_path)
    assert done.code == 0 and {file.name for file in (tmp_path / "out").iterdir()} == FILES["model"]
    done = command("export", f"run={source}", "formats=[c]", f"folder={tmp_path}/none", cwd=tmp_path)
    assert done.code == 2 and not (tmp_path / "none").exists()
