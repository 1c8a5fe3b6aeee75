"""What every command needs and none changes: libraries, the package, and the files of `conf` as they were parsed.

A fork of a process that has imported this module starts in a fraction of the time. `command` is not here: it changes
the environment when it is imported.
"""

import copy
import importlib
import sys
from pathlib import Path
from typing import TextIO

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, ListConfig, OmegaConf

ROOT = Path(__file__).resolve().parents[2]
MODULES = (
    *("torch", "tensordict", "tensordict.nn", "torchrl", "torchrl.data", "torchrl.envs", "torchrl.modules"),
    *("torchrl.objectives", "torchrl.record", "torch.optim", "torch.quasirandom", "numpy", "pandas", "control"),
    *("scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special"),
    *("matplotlib.pyplot", "matplotlib.backends.backend_agg", "jinja2", "rich.progress", "rich.table", "PIL.Image"),
    *("dynasindy.dyna.run", "dynasindy.viz.run", "dynasindy.rig", "dynasindy.checking", "dynasindy.evaluation"),
    *("dynasindy.export", "admitted", "manual", "mistakes", "next_steps", "places", "saved_run", "schema"),
)


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
sys.path.insert(0, str(ROOT / "scripts"))
for _name in MODULES:
    importlib.import_module(_name)
sys.path.pop(0)
with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
    for _name in ("train", "identify"):
        compose(_name)
