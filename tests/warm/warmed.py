"""What every command needs and none changes: libraries, the package, the files of `conf`, parsed, and their schema.

A fork of a process that has imported this module starts in a fraction of the time. Of the scripts only `settings` is
here, and what it imports: others change the environment when they are imported.
"""

import gc
import importlib
import sys
from pathlib import Path

import parsed  # noqa: F401
from hydra import compose, initialize_config_dir

ROOT = Path(__file__).resolve().parents[2]
MODULES = (
    *("torch", "tensordict", "tensordict.nn", "torchrl", "torchrl.data", "torchrl.envs", "torchrl.modules"),
    *("gymnasium", "torchrl.objectives", "torchrl.record", "torch.optim", "torch.quasirandom", "numpy", "pandas"),
    *("scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special"),
    *("matplotlib.pyplot", "matplotlib.backends.backend_agg", "jinja2", "rich.progress", "rich.table", "PIL.Image"),
    *("dynasindy.dyna.run", "dynasindy.viz.run", "dynasindy.rig", "dynasindy.evaluation"),
    *("dynasindy.export", "dynasindy.export.formats", "dynasindy.workbench"),
    *("dynasindy.identification.identify", "dynasindy.viz.animation"),
    *("dynasindy.viz.report", "dynasindy.rig.simulated"),
    *("hydra.experimental.callback", "hydra._internal.logging_config"),
)

for _name in MODULES:
    importlib.import_module(_name)
with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
    sys.path.insert(0, str(ROOT / "scripts"))
    _settings = importlib.import_module("settings")
    sys.path.remove(str(ROOT / "scripts"))
    for _name in ("train", "identify"):
        _config = compose(_name)
        _config.folder = "run"
        _settings.check(_config)
gc.freeze()  # else each fork looks through all of it for garbage
