"""YAML that Hydra has opened before is a copy of what it read then: most of the time of a composition is parsing."""

import copy
from pathlib import Path
from typing import TextIO

from omegaconf import DictConfig, ListConfig, OmegaConf

PARSED: dict[str, DictConfig | ListConfig] = {}
_load = OmegaConf.load


def _load_once(file_: str | Path | TextIO) -> DictConfig | ListConfig:
    """Read YAML as OmegaConf does, and from a copy if it is a text that Hydra has opened before."""
    if isinstance(file_, str | Path):
        return _load(file_)
    text = file_.read()
    if text not in PARSED:
        file_.seek(0)  # from the file, whose name is in the errors
        PARSED[text] = _load(file_)
    return copy.deepcopy(PARSED[text])


OmegaConf.load = staticmethod(_load_once)  # type: ignore[method-assign]
