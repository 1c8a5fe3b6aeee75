"""An export holds the files that were asked for, of what there is."""

import sys
import zipfile

import pytest
from controllers import pendulum_controller, pendulum_model

from dynasindy.control import save
from dynasindy.export import fmu, write

MODEL = {"model.c", "model.h", "model.tex", "model.py"}


@pytest.fixture(autouse=True)
def _no_compiler(monkeypatch):
    """What is compiled is tested elsewhere, and takes seconds."""
    for module in (write, fmu):
        monkeypatch.setattr(module, "compiler", lambda: None)


def names(folder):
    return {path.name for path in folder.iterdir()}


def unit(folder, member):
    """Return the text of a file in the FMU of the plant."""
    with zipfile.ZipFile(folder / "plant.fmu") as packed:
        return packed.read(member).decode()


def test_a_run_folder_gives_everything(tmp_path):
    controller = pendulum_controller()
    save(controller, tmp_path / "controller.json")
    lines = write.write(*write.read(tmp_path), tmp_path / "out", ["c", "fmu", "model"])
    assert names(tmp_path / "out") == MODEL | {"controller.c", "controller.h", "controller.fmu", "plant.fmu"}
    assert "not timed, as there is no C compiler" in lines[0]
    assert f"{(tmp_path / 'out' / 'plant.fmu').stat().st_size} bytes" in lines[2] and "sources alone" in lines[2]
    assert 'stepSize="0.01"' in unit(tmp_path / "out", "modelDescription.xml")  # a third of 0.04 s would be longer
    assert controller.observer.stops is not None and "stop(" in unit(tmp_path / "out", "sources/plant.c")
    for found in write.read(tmp_path / "controller.json"):
        assert found is not None


def test_a_model_alone_gives_its_own_files(tmp_path):
    pendulum_model().save(tmp_path / "model.json")
    for source in (tmp_path, tmp_path / "model.json"):
        write.write(*write.read(source), tmp_path / "out", ["c", "onnx", "fmu", "model"])
        assert names(tmp_path / "out") == MODEL | {"plant.fmu"}
    with pytest.raises(ValueError, match="model was given"):
        write.write(*write.read(tmp_path), tmp_path / "none", ["c"])
    with pytest.raises(ValueError, match="formats is empty"):
        write.write(pendulum_controller(), pendulum_model(), tmp_path / "none", [])


def test_without_an_observer_the_model_of_the_run_is_taken_or_missed(tmp_path):
    save(pendulum_controller(observer=False), tmp_path / "controller.json")
    lines = write.write(*write.read(tmp_path), tmp_path / "out", ["fmu", "model"])
    assert names(tmp_path / "out") == {"controller.fmu"} and "nothing of the plant is written" in lines[-1]
    pendulum_model().save(tmp_path / "model.json")
    write.write(*write.read(tmp_path), tmp_path / "out", ["fmu", "model"])
    assert names(tmp_path / "out") == MODEL | {"controller.fmu", "plant.fmu"}


@pytest.mark.parametrize(("dt", "substeps", "step"), [(0.04, 1, 0.01), (0.04, 8, 0.005), (0.008, 1, 0.008)])
def test_without_an_observer_the_plant_keeps_its_stops_and_its_steps(tmp_path, dt, substeps, step):
    controller = pendulum_controller(observer=False)
    controller.setup.dt, controller.setup.substeps = dt, substeps
    save(controller, tmp_path / "controller.json")
    pendulum_model().save(tmp_path / "model.json")
    write.write(*write.read(tmp_path), tmp_path / "out", ["fmu"])
    assert f'stepSize="{step}"' in unit(tmp_path / "out", "modelDescription.xml")
    assert "stop(&x[0], &x[1], (-0.6), 0.25);" in unit(tmp_path / "out", "sources/plant.c")


def test_a_package_that_is_missing_is_named_and_the_rest_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    save(pendulum_controller(), tmp_path / "controller.json")
    lines = write.write(*write.read(tmp_path), tmp_path / "out", ["c", "onnx"])
    assert "controller.onnx and policy.onnx are not written: ONNX needs the package onnx" in lines[-1]
    with pytest.raises(ValueError, match=r"policy\.onnx"):
        write.write(*write.read(tmp_path), tmp_path / "none", ["onnx"])
