"""Compositions take a fraction of their time: most of it is parsing, and Hydra composes twice to run a command.

YAML that it has opened before is a copy of what it read then. It composes once more only to find `hydra.mode`, of which
of our files that of an ablation alone says anything: for the others `-m` decides.
"""

import pickle
from pathlib import Path
from typing import Any, TextIO

from hydra._internal.hydra import Hydra
from omegaconf import DictConfig, ListConfig, OmegaConf

PARSED: dict[str, bytes] = {}
"""What was read, pickled: a copy out of that takes a quarter of the time of a deep copy."""
_load, _get_mode = OmegaConf.load, Hydra.get_mode
WITHOUT_MODE = ("train", "identify", "evaluate", "check", "export", "rig", "report")


def _load_once(file_: str | Path | TextIO) -> DictConfig | ListConfig:
    """Read YAML as OmegaConf does, and from a copy if it is a text that Hydra has opened before."""
    if isinstance(file_, str | Path):
        return _load(file_)
    text = file_.read()
    if text not in PARSED:
        file_.seek(0)  # from the file, whose name is in the errors
        PARSED[text] = pickle.dumps(_load(file_))
    return pickle.loads(PARSED[text])


def _mode(hydra: Hydra, config_name: str | None, overrides: list[str]) -> Any:
    """Return whether a command is a sweep, None where its words say so."""
    return None if config_name in WITHOUT_MODE else _get_mode(hydra, config_name, overrides)


OmegaConf.load = staticmethod(_load_once)  # type: ignore[method-assign]
Hydra.get_mode = _mode  # type: ignore[method-assign]
