"""Functional mock-up units of a controller and of the plant as the model knows it: co-simulation, C inside, no Python.

Sources: FMI 3.0.2 and 2.0.4, https://fmi-standard.org.
"""

from __future__ import annotations

import platform
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from dynasindy import __version__
from dynasindy.control import Controller
from dynasindy.control.c_code import TEMPLATES, controller_sources, fill
from dynasindy.safe_io import replace_file
from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import formulas, number
from dynasindy.systems import Stops
from dynasindy.systems.compiler import SUFFIX, compile_library, compiler

_TEMPLATES = TEMPLATES.overlay(
    loader=jinja2.ChoiceLoader([jinja2.PackageLoader(f"dynasindy.{room}", "c") for room in ("export", "control")])
)
PAST = 1024
"""Largest number of inputs that are on their way to a plant with a delay."""
FINE = {
    2: ("SetDebugLogging", "EnterInitializationMode", "ExitInitializationMode", "Terminate"),
    3: ("SetDebugLogging", "ExitInitializationMode", "EnterStepMode", "Terminate"),
}
"""Functions that every FMU has to have, and that change nothing here."""
_TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean", "String")
ABSENT = {
    2: (
        *(f"{way}{kind}" for way in ("Get", "Set") for kind in ("Integer", "Boolean", "String")),
        *("GetFMUstate", "SetFMUstate", "FreeFMUstate", "SerializedFMUstateSize", "SerializeFMUstate"),
        *("DeSerializeFMUstate", "GetDirectionalDerivative", "SetRealInputDerivatives", "GetRealOutputDerivatives"),
        *("CancelStep", "GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"),
    ),
    3: (
        *(f"{way}{kind}" for way in ("Get", "Set") for kind in (*_TYPES, "Binary", "Clock")),
        *("GetNumberOfVariableDependencies", "GetVariableDependencies", "GetFMUState", "SetFMUState", "FreeFMUState"),
        *("SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState"),
        *("GetDirectionalDerivative", "GetAdjointDerivative", "EnterConfigurationMode"),
        *("ExitConfigurationMode", "GetIntervalDecimal", "GetIntervalFraction", "GetShiftDecimal", "GetShiftFraction"),
        *("SetIntervalDecimal", "SetIntervalFraction", "SetShiftDecimal", "SetShiftFraction", "EnterEventMode"),
        *("EvaluateDiscreteStates", "UpdateDiscreteStates", "EnterContinuousTimeMode", "CompletedIntegratorStep"),
        *("SetTime", "SetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators"),
        *("GetContinuousStates", "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators"),
        *("GetNumberOfContinuousStates", "GetOutputDerivatives", "ActivateModelPartition"),
    ),
}
"""Those that answer with an error."""


Variable = tuple[str, str, bool]
"""A variable of an FMU: its name, its unit, and whether it is an output, or an input."""


def controller_fmu(controller: Controller, path: Path, version: int = 3) -> bool:
    """Write an FMU of a controller: measurements `y_`, references `r_` and their rates `rate_` in, inputs `u_` out.

    Args:
        controller: The controller.
        path: File to write.
        version: Of FMI, 2 or 3.

    Returns:
        Whether it holds a library for this computer; without a compiler it holds sources alone.

    Raises:
        ValueError: The controller cannot be written in C, or the version is another.
    """
    sources = controller_sources(controller)
    name = sources.name
    signature, seen = controller.signature, controller.measured
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    variables = (
        *((f"y_{state}", units[state], False) for state in seen),
        *((f"r_{state}", units[state], False) for state in controller.outputs),
        *((f"rate_{state}", f"{units[state]}/s", False) for state in controller.outputs),
        *((f"u_{word}", "1", True) for word in signature.input_names),
    )
    text = fill(
        "fmu_controller.c",
        _TEMPLATES,
        name=name,
        dt=number(controller.dt),
        measured=[signature.state_index(state) for state in seen],
        inputs=len(variables) - signature.n_u,
        values=len(variables),
    )
    return _write(name, controller.dt, variables, {**sources.files(), f"{name}_fmi.c": text}, path, version)


def plant_fmu(model: SindyModel, path: Path, step: float, stops: Stops | None = None, version: int = 3) -> bool:
    """Write an FMU of a plant as its model knows it: inputs `u_` in, states `x_` out, which may be set at the start.

    Inputs act as late as the model says.

    Args:
        model: The model.
        path: File to write.
        step: Longest step of the Runge-Kutta method [s]; a difference equation has its own, and moves by whole steps.
        stops: Mechanical stops, if any.
        version: Of FMI, 2 or 3.

    Returns:
        Whether it holds a library for this computer; without a compiler it holds sources alone.

    Raises:
        ValueError: The model cannot be written in C, has no inputs, or the version is another.
    """
    name, signature = "plant", model.signature
    if not signature.n_u:
        raise ValueError("an FMU of a plant has inputs, and this model has none; export it as C instead")
    step, ends = model.step or step, stops.rows(signature.n_x) if stops else []
    words = {"model": model, "found": formulas(model), "stops": ends, "past": PAST}
    text = fill("fmu_plant.c", _TEMPLATES, **words, step=number(step), delay=number(model.delay))
    units = zip(signature.state_names, signature.state_units, strict=True)
    variables = (
        *((f"u_{word}", "1", False) for word in signature.input_names),
        *((f"x_{state}", unit, True) for state, unit in units),
    )
    return _write(name, step, variables, {f"{name}.c": text}, path, version)


def _write(
    name: str, step: float, variables: Sequence[Variable], texts: Mapping[str, str], path: Path, version: int
) -> bool:
    if version not in FINE:
        raise ValueError(f"FMI {version} is not written; allowed are 2 and 3")
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, ''.join(texts.values()))}}}"
    *_, last = texts
    interface = fill("fmi.c", _TEMPLATES, version=version, token=token, fine=FINE[version], absent=ABSENT[version])
    sources = {**texts, last: texts[last] + interface}
    words: dict[str, Any] = {"name": name, "files": [file for file in sources if file.endswith(".c")]}
    about = {"step": repr(step), "variables": variables, "units": sorted({unit for _, unit, _ in variables})}
    more = {"version": version, "release": __version__, "token": token}
    described = fill("modelDescription.xml", _TEMPLATES, **words, **about, **more)
    files = {"modelDescription.xml": described.encode()}
    files |= {f"sources/{file}": text.encode() for file, text in sources.items()}
    if version == 3:
        files["sources/buildDescription.xml"] = fill("buildDescription.xml", _TEMPLATES, **words).encode()
    built = compiler() is not None
    if built:
        system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
        machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
        place = f"{system.replace('dows', '')}64" if version == 2 else f"{machine}-{system}"
        with tempfile.TemporaryDirectory() as folder:
            for file, text in sources.items():
                (Path(folder) / file).write_text(text, encoding="utf-8")
            library = compile_library([Path(folder) / file for file in words["files"]], Path(folder) / f"unit{SUFFIX}")
            files[f"binaries/{place}/{name}{SUFFIX}"] = library.read_bytes()
    with replace_file(path) as target, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in files.items():
            archive.writestr(zipfile.ZipInfo(member, (2000, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return built
