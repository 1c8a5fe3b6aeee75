"""A user's mistake in one line: what was given, what is allowed, what to do."""

import os
import re
import sys
from difflib import get_close_matches
from pathlib import Path

os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach us instead of Hydra's printer

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, InstantiationException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

CONF = Path(__file__).resolve().parents[1] / "conf"
MENDABLE = (ValueError, TypeError, KeyError, FileNotFoundError, HydraException, OmegaConfBaseException)


def in_words(error: BaseException, config_name: str) -> str:
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
