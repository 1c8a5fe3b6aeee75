"""All files of an export, and what is to be said of each."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from dynasindy.control import Controller, load
from dynasindy.control.c_code import Native, controller_sources, model_sources
from dynasindy.control.controller import FORMAT, NAME
from dynasindy.export.fmu import controller_fmu, plant_fmu
from dynasindy.export.formats import casadi_source, latex_source
from dynasindy.export.onnx import controller_onnx, policy_onnx
from dynasindy.safe_io import read_json, write_text
from dynasindy.sindy import SindyModel
from dynasindy.systems.compiler import compiler

STEP = 0.01
"""Longest Runge-Kutta step of the plant's FMU, whatever the steps of a controller [s]."""


def read(path: str | Path) -> tuple[Controller | None, SindyModel | None]:
    """Read a controller or a model from its file, or both from a run folder; what is not there is None.

    Raises:
        FileNotFoundError: There is neither.
        DamagedFileError: A file is damaged.
        ValueError: A model cannot be read.
    """
    given = Path(path)
    file, model = (given / NAME, given / "model.json") if given.is_dir() else (given, given)
    if (given.is_dir() and not file.is_file() and model.is_file()) or (
        given.is_file() and read_json(given).get("format") != FORMAT
    ):
        return None, SindyModel.load(model)
    controller = load(given)
    if controller.observer is not None:
        known = controller.observer.model
        return controller, known if isinstance(known, SindyModel) else None
    return controller, SindyModel.load(model) if given.is_dir() and model.is_file() else None


def write(
    controller: Controller | None, model: SindyModel | None, folder: Path, formats: Collection[str], fmi: int = 3
) -> list[str]:
    """Write an export.

    Args:
        controller: The controller, if any, whose mechanical stops the plant has.
        model: The identified model of its plant, if any.
        folder: Where the files go; made if missing.
        formats: Some of `c`, `onnx`, `fmu` and `model`.
        fmi: Version of FMI, 2 or 3.

    Returns:
        One line per file, or about a file that was not written.

    Raises:
        ValueError: Nothing could be written, or the controller or its model has no form in C.
    """
    found: list[str] = []
    missing: list[str] = []
    if controller is not None and "c" in formats:
        sources, timed = controller_sources(controller), "not timed, as there is no C compiler on this computer"
        for name, text in sources.files().items():
            write_text(folder / name, text)
        if compiler():
            timed = f"{Native(sources).microseconds():.3g} us per call on this computer, compiled with -O2"
        found.append(f"{' and '.join(sources.files())}: {timed}")
    if controller is not None and "onnx" in formats:
        try:
            controller_onnx(controller, folder / "controller.onnx")
            found.append(_size(folder / "controller.onnx", "the whole control step"))
            policy_onnx(controller, folder / "policy.onnx")
            found.append(_size(folder / "policy.onnx", "the policy, observation to action"))
        except ModuleNotFoundError as error:
            missing.append(f"controller.onnx and policy.onnx are not written: {error}")
    if "fmu" in formats:
        if controller is not None:
            path = folder / "controller.fmu"
            found.append(_fmu(path, controller_fmu(controller, path, fmi)))
        if model is not None and model.signature.n_u:
            path = folder / "plant.fmu"
            setup = None if controller is None else controller.setup
            step, stops = (STEP, None) if setup is None else (setup.dt / max(1, setup.substeps), setup.stops)
            found.append(_fmu(path, plant_fmu(model, path, min(STEP, step), stops, fmi)))
    if "model" in formats and model is not None:
        texts = {"model.tex": ("the equations as LaTeX", latex_source(model))}
        texts |= {"model.py": ("the equations for CasADi", casadi_source(model))}
        code = {name: ("the equations in C", text) for name, text in model_sources(model).files().items()}
        for name, (words, text) in (code | texts).items():
            write_text(folder / name, text)
            found.append(_size(folder / name, words))
    if controller is None:
        missing.append("nothing of a controller is written: a model was given, and no controller.json is there")
    if model is None:
        missing.append("nothing of the plant is written: the controller has no observer, and no model.json is there")
    if not found:
        raise ValueError("; ".join(missing) or "nothing is written: formats is empty; give some of c, onnx, fmu, model")
    return found + missing


def _fmu(path: Path, built: bool) -> str:
    more = "with a library for this computer" if built else "sources alone, as there is no C compiler on this computer"
    return _size(path, f"an FMU, {more}")


def _size(path: Path, what: str) -> str:
    return f"{path.name}: {what}, {path.stat().st_size} bytes"
