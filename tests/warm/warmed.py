"""What every command needs and none changes: libraries, the package, and the files of `conf`, parsed.

A fork of a process that has imported this module starts in a fraction of the time. Modules of the scripts are not here:
they change the environment when they are imported.
"""

import importlib
from pathlib import Path

import parsed  # noqa: F401
from hydra import compose, initialize_config_dir

ROOT = Path(__file__).resolve().parents[2]
MODULES = (
    *("torch", "tensordict", "tensordict.nn", "torchrl", "torchrl.data", "torchrl.envs", "torchrl.modules"),
    *("torchrl.objectives", "torchrl.record", "torch.optim", "torch.quasirandom", "numpy", "pandas", "control"),
    *("scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special"),
    *("matplotlib.pyplot", "matplotlib.backends.backend_agg", "jinja2", "rich.progress", "rich.table", "PIL.Image"),
    *("dynasindy.dyna.run", "dynasindy.viz.run", "dynasindy.rig", "dynasindy.checking", "dynasindy.evaluation"),
    *("dynasindy.export", "dynasindy.workbench"),
)

for _name in MODULES:
    importlib.import_module(_name)
with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
    for _name in ("train", "identify"):
        compose(_name)
