"""Settings every test shares: one thread per process and quiet libraries, set before torch is imported."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MPLBACKEND", "Agg")

import re
from pathlib import Path
from typing import Any

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _no_global_state() -> None:
    """Give every test the same global torch random state, so that the order of the tests is irrelevant."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def settle() -> Any:
    """Return the task without references that docs/extending.md shows."""
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    (block,) = re.findall(r"```python\n# dynasindy/tasks/settle\.py\n(.*?)```", page, re.S)
    module: dict[str, Any] = {}
    exec(compile(block, "docs/extending.md", "exec"), module)
    return module["Settle"]
