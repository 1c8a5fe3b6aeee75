"""A user's mistake in one line: what was given, what is allowed, what to do."""

import re
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path

import hydra
import yaml
from cli import CONF, SCRIPTS, config_dir, group_options, plant_settings
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from trust import nodes

import dynasindy
from dynasindy.limits import is_memory_error, memory_wanted
from dynasindy.text import did_you_mean

PACKAGE = Path(dynasindy.__file__).parent
OTHERS = re.compile(r"^<|[/\\](site-packages|dist-packages|lib[/\\]python3[^/\\]*)[/\\]")
"""Where the code of libraries lies."""
MENDABLE = (
    *(yaml.YAMLError, ValueError, TypeError, KeyError, OSError, ModuleNotFoundError),
    *(HydraException, OmegaConfBaseException),
)
EXTRAS = {
    **{"joblib": "sweep", "submitit": "slurm", "ray": "ray", "tensorboard": "tensorboard"},
    **{"casadi": "export", "control": "export", "onnx": "export"},
}
"""Optional packages by the first word of a launcher or module, and the extra of ours that installs them."""
MISSPELT = re.compile(r"(?:Could not override|An item is already at) '([^']+)'")
"""What Hydra says of a key that is misspelt, or given with a + and there."""


def mendable(error: BaseException) -> bool:
    """Tell whether the user can mend an error, and so is told in a line, without a traceback."""
    return isinstance(error, MENDABLE) or is_memory_error(error) or bool(_changed_dtype() or of_user(error))


def _changed_dtype() -> str:
    """Return that a part of the user's made another number type torch's default; '' if it is as it was."""
    torch = sys.modules.get("torch")
    if not hasattr(torch, "get_default_dtype") or (kind := torch.get_default_dtype()) == torch.float32:
        return ""
    return f"a part of yours called torch.set_default_dtype({kind}), which all others use; leave it out of the plant"


def of_user(error: BaseException) -> str:
    """Return what went wrong in code of the user's, as a plant, that the package called; '' where nothing did."""
    cause: BaseException | None = error
    while cause is not None:
        frames = [(frame, Path(frame.f_code.co_filename)) for frame, _ in traceback.walk_tb(cause.__traceback__)]
        inside = next((k for k, (_, file) in enumerate(frames) if file.is_relative_to(PACKAGE)), len(frames))
        for frame, file in reversed(frames[inside:]):
            if not (OTHERS.search(str(file)) or file.is_relative_to(PACKAGE) or file.is_relative_to(SCRIPTS)):
                said = f"{type(cause).__name__}: {' '.join(str(cause).split())}".rstrip(": ")
                place = f"{frame.f_code.co_qualname} failed in {file.name}, line {frame.f_lineno}"
                return f"{place} ({said}); mend it there; DYNASINDY_TRACEBACK=1 shows the way there"
        # What has a sentence of its own is told by that.
        cause = cause.__cause__ if isinstance(cause, RuntimeError | MemoryError | InstantiationException) else None
    return ""


def in_words(error: BaseException, config_name: str, settings: object = None) -> str:
    """Return the innermost message of an error on one line, with what is allowed where it names a key.

    A key that takes its value from another one in the `settings` of the command is named as that one.
    """
    while isinstance(error, InstantiationException) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, BrokenPipeError):
        raise error
    words = str(error).strip("'\"") if isinstance(error, KeyError) else str(error)
    text = " ".join(words.split()).partition(" Config search path:")[0]
    if place := _changed_dtype() or of_user(error):
        return place
    if is_memory_error(error):
        wanted = memory_wanted(error)
        said = f": {wanted} more were wanted" if wanted else f": {text}" if text and type(error) is MemoryError else ""
        lower = "lower counts and sizes, such as replay.capacity, planning.rollouts, agent.hidden or draws, or log less"
        return f"memory ran out{said}; {lower}, or allow this command more (ulimit -v)"
    if isinstance(error, OSError) and error.strerror:
        # Of a connection, which is no file, the system names none.
        place = f"{error.filename}: " if error.filename is not None else ""
        return f"{place}{error.strerror}; choose another"
    if isinstance(error, yaml.MarkedYAMLError) and (mark := error.problem_mark) is not None:
        where = f"{mark.name}, line {mark.line + 1}"
        return f"{where}: {error.problem}; mend the file, in which blanks tell what belongs where"
    if isinstance(error, OverrideParseException):
        return (
            f"'{error.override}' cannot be read; write key=value, close all brackets and quotes, and put a word with "
            "brackets, quotes, commas or blanks between quotes of the shell, such as 'plant.outputs=[angle]'"
        )
    engine = re.search(r"Could not find 'hydra/launcher/([a-z]+)", text)
    module = engine[1] if engine else str(getattr(error, "name", None)).partition(".")[0]
    if module in EXTRAS:
        instead = ", or choose hydra/launcher=basic" * bool(engine)
        return f"{module} is not installed; install it by pip install 'dynasindy[{EXTRAS[module]}]'{instead}"
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        return unknown_name(option, (choice for choice in error.options if not choice.startswith("_")), group)
    if lacking := re.search(r"Missing mandatory value: ([\w.]+)", text):  # also where another key takes it from there
        return f"{lacking[1]} is not given; give {lacking[1]}=VALUE, of which --help says more"
    if text.startswith("Config group override must be"):
        for group, _, option in (word.partition("=") for word in sys.argv[1:]):
            choices = group_options(group) if option else ()
            if choices and not isinstance(yaml.safe_load(option), str):  # a name may be that of a file of the user
                return unknown_name(option, choices, group)
    if text.startswith("Ambiguous value for argument"):
        try:  # that there are several values is no mistake in a command that sweeps
            compose(config_name, _words())
        except MENDABLE as wrong:
            return in_words(wrong, config_name, settings)
    if misspelt := MISSPELT.search(text):
        return _misspelt(misspelt[1], config_name) or f"{text}; replace the whole of a group's keys in a file"
    if deleted := next((word for word in sys.argv[1:] if word.startswith("~")), ""):
        return f"{deleted} takes away what the command reads ({text}); leave it out, or give the key another value"
    return re.sub(r"\b[a-z_]+(?:\.[a-z_]+)+\b", lambda key: _taken_from(key[0], settings) or key[0], text)


def _misspelt(key: str, config_name: str) -> str:
    """Return which keys stand where a misspelt one was given; '' if it exists."""
    chosen = [word for word in _words() if (CONF / word.partition("=")[0]).is_dir()]
    try:
        whole = OmegaConf.to_container(compose(config_name, chosen))
    except HydraException:  # a group that this command does not have is chosen
        whole = OmegaConf.to_container(compose(config_name, []))
    if source := _taken_from(key, whole):
        return f"'{key}' follows another key; give {source} instead"
    names = [f"{group}.{name}".lstrip(".") for group, node in nodes(whole) for name in node if str(name)[0] != "_"]
    names += [f"plant.{name}" for name in plant_settings() if "plant" in names]
    keys = sorted((name for name in dict.fromkeys(names) if "[" not in name), key=lambda name: name.count("."))
    group = key
    while group not in ("", *keys):
        group = group.rpartition(".")[0]
    names = [each.rpartition(".")[2] for each in keys if each.rpartition(".")[0] == group]
    return "" if group == key else unknown_name(key.removeprefix(f"{group}."), names, group, keys)


def _words() -> list[str]:
    """Return the settings that the command line gives, each with the first of its values."""
    read = [word for word in sys.argv[1:] if "=" in word and not word.startswith("-")]
    found = zip(read, OverridesParser.create().parse_overrides(read))
    sweeping = [(w, o, o.is_choice_sweep() or o.is_range_sweep()) for w, o in found if not o.is_interval_sweep()]
    return [f"{o.get_key_element()}={next(o.sweep_string_iterator())}" if many else w for w, o, many in sweeping]


def compose(config_name: str | None, words: list[str]) -> DictConfig:
    """Return a config as Hydra composes it of settings, with the folder of the user's own as the command names it."""
    own = config_dir(sys.argv[1:])
    folder = [f"hydra.searchpath=[file://{Path(own).absolute()}]"] if own else []
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra.compose(config_name, overrides=[*folder, *words])


def _taken_from(key: str, node: object) -> str:
    """Return the key that another one takes its value from, as `sensors.channels` does from `plant.sensors`, or ''."""
    step, _, rest = key.partition(".")
    if not isinstance(node, dict) or step not in node:
        return ""
    source = re.fullmatch(r"\$\{(?:oc\.select:)?([\w.]+)(,.*)?\}", str(node[step]))
    return f"{source[1]}.{rest}".rstrip(".") if source else _taken_from(rest, node[step])


def unknown_name(name: str, names: Iterable[str], where: str, elsewhere: Iterable[str] = ()) -> str:
    """Return which names are allowed instead of one that does not exist in a group, or is a key of another one."""
    names = sorted(names)
    same = [key for key in elsewhere if key.rpartition(".")[2] == name.rpartition(".")[2]]
    meant = [repr(key) for key in same if key.count(".") == same[0].count(".")][:3]
    hint = f"; did you mean {' or '.join(meant)}?" if meant else did_you_mean(name, names)
    group, _, key = f"{where}.{name}".strip(".").partition(".")
    files = group_options(group) if key else {}  # another option of the group may have the key
    own = [option for option, file in files.items() if re.search(rf"^ *{re.escape(key)}:", file.read_text(), re.M)]
    hint = f"; {group}={' or '.join(own)} has it" if own else hint
    place = f" in '{where}'" if where else ""
    return f"'{name}' does not exist{place}; allowed are {', '.join(names) or 'none'}{hint}"
