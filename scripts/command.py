"""What the scripts share: a Hydra command whose user's errors are one line each."""

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import wraps
from pathlib import Path

os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us instead of Hydra's printer

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, InstantiationException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

CONF = Path(__file__).resolve().parents[1] / "conf"
# The jobs of a sweep run in processes of their own, which have to find the modules beside this one.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
MENDABLE = (ValueError, TypeError, KeyError, FileNotFoundError, HydraException, OmegaConfBaseException)


def command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Make a function of a config a command: a bad setting or file costs one line and exit code 2.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. Set
    DYNASINDY_TRACEBACK=1 to see where an error comes from.
    """

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        @wraps(task)
        def guarded(cfg: DictConfig) -> None:
            with _one_line(config_name):
                task(cfg)

        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(guarded)

        def run() -> None:
            with _one_line(config_name):
                main()

        return run

    return decorate


@contextmanager
def _one_line(config_name: str) -> Iterator[None]:
    try:
        yield
    except MENDABLE as error:
        if os.environ.get("DYNASINDY_TRACEBACK"):
            raise
        line = f"error: {_words(error, config_name)}"
        _leave_word(line)
        print(line, file=sys.stderr)
        sys.exit(2)


def _words(error: BaseException, config_name: str) -> str:
    """Return the innermost message of an error on one line, with what is allowed where it names a key."""
    part = ""
    while isinstance(error, InstantiationException) and error.__cause__ is not None:
        part = str(error).rpartition("full_key: ")[2].strip()
        error = error.__cause__
    if part and not isinstance(error, ValueError):
        return f"{part} got a setting of the wrong type or name ({error}); compare it with conf/"
    text = " ".join(str(error).strip("'\"").split()).partition(" Config search path:")[0]
    misspelt = re.search(r"Could not override '([^']+)'", text)
    if not misspelt:
        return text
    try:
        return _allowed_keys(misspelt[1], config_name)
    except MENDABLE:  # another override is wrong too, or the key itself exists and what it holds cannot be extended
        return f"{text}; replace the whole of a group's keys in a file of its own, as conf/ has them"


def _allowed_keys(key: str, config_name: str) -> str:
    """Return which keys stand where a misspelt one was given."""
    GlobalHydra.instance().clear()
    others = [word for word in sys.argv[1:] if "=" in word and not word.lstrip("+~").startswith(f"{key}=")]
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        node = hydra.compose(config_name, overrides=others)
    given, parent = key.split("."), []
    for step in given[:-1]:
        if not (step in node and OmegaConf.is_dict(node[step])):
            break
        node = node[step]
        parent.append(step)
    name = ".".join(given[len(parent) :])
    names = sorted(str(k) for k in node if not str(k).startswith("_"))
    if name in names:
        raise KeyError(name)
    guess = get_close_matches(name, names, 1)
    hint = f"; did you mean '{guess[0]}'?" if guess else ""
    where = f" in '{'.'.join(parent)}'" if parent else ""
    return f"'{name}' does not exist{where}; allowed are {', '.join(names)}{hint}"


def _leave_word(line: str) -> None:
    """Remove the run folder if it is empty; else write the line into it."""
    if not HydraConfig.initialized():
        return
    folder = Path(HydraConfig.get().runtime.output_dir)
    if not folder.is_dir() or folder.resolve() == Path.cwd():
        return
    if any(folder.iterdir()):
        (folder / "error.txt").write_text(line + "\n")
    else:
        folder.rmdir()
