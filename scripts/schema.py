"""What a config may hold: the annotations of what it builds are its schema, checked before anything is built."""

import inspect
import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypedDict, get_args, get_type_hints

from annotations import fit, made, words
from mistakes import unknown
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError, InterpolationResolutionError, InterpolationToMissingValueError

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.simulated import Simulated
from dynasindy.evaluation.ablation import Level
from dynasindy.evaluation.identification import LoggedData
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.rig import Guard
from dynasindy.sindy.functions import register_formula
from dynasindy.systems import System
from dynasindy.tasks.references import Signal

HYDRA = {"_target_", "_partial_", "_args_", "_convert_", "_recursive_"}
GIVEN = {"signature", "dt", "system", "task", "n_u", "n_obs", "env", "agent", "replay", "policy"}
GIVEN |= {"x", "u", "x_next"}
"""Arguments that an experiment hands to what a config builds with `_partial_`."""


class Signals(TypedDict, total=False):
    """Keys of `plant.signals`: targets of a step, one per output in each row, and what is said of the waves."""

    step: list[list[float]]
    sine: Signal
    square: Signal


class Plant(TypedDict):
    """Keys of `plant`, from which other groups copy; a mistake is named here rather than where it was copied to.

    Attributes:
        outputs: States that are to be held at targets.
        rates: The rate of each output, whose changes cost; null for an output without one.
        start: Where episodes begin: state to value, or to the two ends of a range.
        bounds: Limits that end an excitation or a real episode, by state.
        low: Lower ends of the targets, one per output [unit of the output].
        high: Upper ends of the targets, one per output [unit of the output].
        library: Candidate functions of the model: a name, a builder, or functions in words.
        known: Equations that are known: the rate of the first state is the second one.
        initial: First guess of the equations, by state and function, where no sensor sees a state in any form.
        libraries: The library for each source of the data, between which `library` chooses.
        amplitude: Half range of each input under the excitation [-].
        offset: Mean of each input under the excitation [-].
        first: Share of the amplitude with which the excitation begins to move the plant.
        gain: Feedback that holds the plant about its start: a row per input, a column per state.
        sensors: Sensors of the plant's bench, for sensors=bench: `resolution` and `noise` of each measured state.
        signals: What of tasks and scenarios step, sine and square does not follow from the plant.
        noise: Standard deviation of the noise of scenario noise, by state [unit of the state].
    """

    outputs: list[str]
    rates: list[str | None]
    start: dict[str, float | list[float]] | None
    bounds: dict[str, float | list[float]]
    low: list[float]
    high: list[float]
    known: dict[str, str] | None
    initial: dict[str, dict[str, float]] | None
    libraries: dict[Literal["simulated", "logged"], str]
    amplitude: float | list[float]
    offset: float | list[float]
    first: float
    gain: list[list[float]] | None
    sensors: dict[str, dict[str, float]]
    signals: Signals | None
    noise: dict[str, float] | None


class Every(TypedDict):
    """Keys of `checkpoint`."""

    every: int


class Evaluating(Every):
    """Keys of `evaluation`."""

    must_improve: bool
    must_control: bool
    within: float


class Keys(TypedDict):
    """Keys at the top of any command's config, besides the parts of an experiment."""

    plant: Plant
    threads: Annotated[int, range(1, 8 * (os.cpu_count() or 1) + 1), "eight for each core of this computer"]
    folder: str
    formats: list[Literal["png", "svg", "pdf", "eps", "jpg", "jpeg", "tif", "tiff", "webp"]]
    run: str | None
    scenarios: list[str]
    integral: bool
    animate: bool
    animation: Literal["gif", "mp4"]
    results: str
    output: str
    save: str | None
    name: str | None
    settings: list[str]
    slim: list[str]
    refinement: str
    error_shape: str
    longest_delay: float | None
    horizons: list[float] | None
    source: Literal["simulated", "logged"]
    resume: str | None
    plugins: list[str]
    finish: bool
    tensorboard: bool
    evaluation: Evaluating
    checkpoint: Every
    scenario: Scenario
    data: LoggedData | Simulated
    level: Level
    dt: Annotated[float, "a time > 0"]
    targets: list[list[float]] | None
    seconds: float | None
    flights: int
    controller: str | None
    guard: Guard
    rig: Any
    planner: Any


class Exporting(TypedDict):
    """Keys of the command `export`, which other commands have with other values, or not at all."""

    formats: list[Literal["c", "onnx", "fmu", "model"]]
    folder: str | None
    fmi: Literal[2, 3]


class Checking(TypedDict):
    """Keys of the command `check`."""

    low: list[float] | None
    high: list[float] | None
    points: Annotated[int, range(1, 51), "their number grows with the power of the outputs"]
    reach: float
    grid: Annotated[int, range(2, 101), "flights grow with its square"]
    draws: Annotated[int, range(10_001)]
    folder: str | None


EXPERIMENT = {"task", "env", "agent", "replay", "planning", "gate"}
TOP = get_type_hints(Keys, include_extras=True) | get_type_hints(Recipe)
TOP |= {"seed": Annotated[int, range(2**63)], "system": System | None}


def check(cfg: DictConfig, file: str = "") -> None:
    """Check every value of a composed config, and make numbers of those that were written as text.

    Args:
        cfg: The config of any command.
        file: Where it was read from, if it is a finished run's, which has all parts of an experiment.

    Raises:
        ValueError: A value is not what its key allows, or an argument does not exist or is not given.
    """
    if OmegaConf.is_dict(cfg) and isinstance(plant := cfg.get("plant"), str):
        raise ValueError(
            f"{file and f'{file}: '}plant={plant} is a name, and plant is the group of keys that say what is known of "
            f"one, such as plant.low; a plant is chosen by system=NAME: did you mean system={plant}?"
        )
    if not OmegaConf.is_dict(cfg) or not isinstance(cfg.get("plant", {}), DictConfig | dict):
        raise ValueError(f"{file or 'plant'} is no group of keys; give them as conf/ does")
    try:
        tree = OmegaConf.to_container(cfg, resolve=True)
    except InterpolationToMissingValueError:  # a log where a plant is wanted; the command says which plants there are
        return
    except InterpolationKeyError as error:
        key = str(error).partition("'")[2].partition("'")[0]
        raise ValueError(
            f"{key} is not given, which {error.full_key} is taken from; add it to the plant's file, as those of "
            "docs/examples/conf/system have it"
        ) from error
    except InterpolationResolutionError as error:
        if not any(words in str(error) for words in ("is not an int", "is not a container")):
            raise
        taken: Any = OmegaConf.to_container(cfg, resolve=False)
        for part in str(error.full_key).split("."):
            taken = taken[part]
        raise ValueError(
            f"{error.full_key} is taken from {str(taken).strip('${}')}, where a list or a single value stands for the "
            "group of keys; give the keys as conf/ does"
        ) from error
    found: dict[str, Any] = {}
    try:
        for name in sorted(get_type_hints(Recipe).keys() - tree.keys() - {"sensors"}) if file else ():
            raise ValueError(f"'{name}' is not given; restore it, or train again")
        # A plant has words for the task of an experiment, which a command without one does not build.
        spare = set() if "train" in tree or file else EXPERIMENT
        keys = TOP | (get_type_hints(Exporting) if "fmi" in tree else {})
        keys |= get_type_hints(Checking, include_extras=True) if "draws" in tree else {}
        _arguments({name: value for name, value in tree.items() if name not in spare}, keys, "", found)
        _nodes(tree, "", found)
    except ValueError as error:
        raise ValueError(f"{file}: {error}" if file else str(error)) from error
    for key, value in found.items():
        OmegaConf.update(cfg, key, value, merge=False)
    register_functions(tree)


def register_functions(tree: Any) -> None:
    """Register the functions of the user's own that the library of the plant is made of.

    Raises:
        ValueError: They are no names with formulas.
    """
    given = (tree.get("plant") or {}).get("functions") or {}
    if not isinstance(given, Mapping):
        raise ValueError(f"plant.functions is {given}; give names with formulas, such as {{softened: '...'}}")
    for name, formula in given.items():
        register_formula(name, formula)


def _nodes(tree: Any, key: str, found: dict[str, Any]) -> None:
    """Check all groups with `_target_`, wherever they stand."""
    if isinstance(tree, list):
        for place, child in enumerate(tree):
            _nodes(child, f"{key}[{place}]", found)
    elif isinstance(tree, dict):
        if "_target_" in tree:
            _call(tree, key, found)
        for name, child in tree.items():
            _nodes(child, f"{key}.{name}".lstrip("."), found)


def _call(node: dict[str, Any], key: str, found: dict[str, Any]) -> None:
    """Check the arguments of one `_target_` by its annotations."""
    named = made(node, key)
    function = named.__init__ if isinstance(named, type) else named  # a class may hide its own behind a metaclass
    try:
        hints = get_type_hints(function, include_extras=True)
        parameters = list(inspect.signature(function).parameters.values())[isinstance(named, type) :]
    except (NameError, TypeError, ValueError, AttributeError):  # another library's, that does not say
        return
    given = {name: value for name, value in node.items() if name not in HYDRA}
    allowed = {p.name: hints.get(p.name, Any) for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    needed = {p.name for p in parameters if p.name in allowed and p.default is p.empty}
    for rest in (hints.get(p.name) for p in parameters if p.kind is p.VAR_KEYWORD):
        # Unpack[a TypedDict], or Annotated[Any, a dataclass], say what else is taken; others take anything.
        inner = get_args(rest)
        allowed |= get_type_hints(inner[-1], include_extras=True) if inner else dict.fromkeys(given, Any)
    for name in given.keys() - allowed.keys():
        raise ValueError(unknown(str(name), allowed.keys() - GIVEN, key))
    for name in sorted(needed - given.keys() - (GIVEN if node.get("_partial_") else set())):
        raise ValueError(f"{key}.{name} is not given; allowed is {words(allowed[name])}: give it, as conf/ does")
    _arguments(given, allowed, key, found)


def _arguments(given: Mapping[str, Any], hints: Mapping[str, Any], key: str, found: dict[str, Any]) -> None:
    """Fit the values that are given, and note those that change."""
    for name in [name for name in hints if name in given]:
        whole = f"{key}.{name}".lstrip(".")
        value = fit(given[name], hints[name], whole)
        if repr(value) != repr(given[name]):  # 10 equals 10.0
            found[whole] = value
