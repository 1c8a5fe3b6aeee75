"""Settings every test shares: one thread per process and quiet libraries, set before torch is imported."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MPLBACKEND", "Agg")

import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import parsed  # noqa: F401 - compositions of this process are fast from here on
import pytest
import torch

torch.set_num_threads(1)

if (found := shutil.which(os.environ.get("CC") or "cc")) and "CC_KEPT" not in os.environ and os.name == "posix":
    kept = tempfile.TemporaryDirectory(prefix="dynasindy_compiled_")  # of this session and of all its processes
    os.environ |= {"CC_OF_TESTS": found, "CC_KEPT": kept.name, "CC": str(Path(__file__).parent / "warm" / "cc")}


@pytest.fixture(autouse=True)
def _no_global_state() -> None:
    """Give every test the same global torch random state, so that the order of the tests is irrelevant."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def settle() -> Any:
    """Return the task without references that docs/extending.md shows."""
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    (block,) = re.findall(r"`dynasindy/tasks/settle\.py`\n\n```python\n(.*?)```", page, re.S)
    module: dict[str, Any] = {}
    exec(compile(block, "docs/extending.md", "exec"), module)
    return module["Settle"]


@pytest.fixture(scope="session")
def hearing() -> Any:
    """Return a callback of a run that keeps what the plant showed."""
    from dynasindy.dyna.callback import Callback, Cost, Episode

    class Hearing(Callback):
        def __init__(self) -> None:
            self.rollouts: list[Any] = []

        def fitted(self, report: object, excited: Any, cost: Cost) -> None:
            self.rollouts.append(excited)

        def episode(self, episode: Episode, cost: Cost) -> None:
            self.rollouts.append(episode.rollout)

    return Hearing


@pytest.fixture(scope="session")
def write_log() -> Any:
    """Return what writes samples of 0.01 s of a pendulum as a log, with the headings of its columns."""

    def write(path: Path, headings: list[str], *columns: torch.Tensor) -> Path:
        lines = [",".join(["time [s]", *headings])]
        rows = torch.cat(columns, -1).tolist()
        lines += [",".join(map(repr, [0.01 * k, *row])) for k, row in enumerate(rows)]
        path.write_text("\n".join(lines) + "\n")
        return path

    return write
