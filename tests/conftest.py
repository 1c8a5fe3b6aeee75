"""Settings every test shares: one thread per process and quiet libraries, set before torch is imported."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MPLBACKEND", "Agg")

import contextlib
import hashlib
import platform
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import parsed  # noqa: F401 - compositions of this process are fast from here on
import pytest
import torch

torch.set_num_threads(1)


def _compiled(compiler: str) -> Path:
    """Return where what this compiler has made for this processor lies from one session to the next.

    Compiling takes an eighth of the time of the tests. What has not been asked for in a month is removed.
    """
    version = subprocess.run([compiler, "--version"], capture_output=True, check=False).stdout
    about = Path("/proc/cpuinfo")
    lines = about.read_text(errors="replace").splitlines() if about.is_file() else [platform.processor()]
    facts = [line for line in lines if not line.startswith(("cpu MHz", "bogomips"))]
    key = hashlib.sha256(version + "\n".join(sorted(set(facts))).encode()).hexdigest()[:16]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dynasindy_tests" / key
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for file in folder.iterdir():
        with contextlib.suppress(OSError):  # another session may have removed it
            if time.time() - file.stat().st_mtime > 30 * 86400:
                file.unlink()
    return folder


if (found := shutil.which(os.environ.get("CC") or "cc")) and "CC_KEPT" not in os.environ and os.name == "posix":
    try:
        kept = str(_compiled(found))
    except OSError:  # as without a home that can be written
        temporary = tempfile.TemporaryDirectory(prefix="dynasindy_compiled_")
        kept = temporary.name
    os.environ |= {"CC_OF_TESTS": found, "CC_KEPT": kept, "CC": str(Path(__file__).parent / "warm" / "cc")}


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Any:
    """Begin what tests share, too, from one global torch random state, whichever test asks for it first."""
    if fixturedef.scope != "function":
        torch.manual_seed(0)
    return (yield)


@pytest.fixture(autouse=True)
def _no_global_state() -> None:
    """Give every test the same global torch random state, so that the order of the tests is irrelevant."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def settle() -> Any:
    """Return the task without references that docs/extending.md shows."""
    page = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
    (block,) = re.findall(r"`dynasindy/envs/settle\.py`\n\n```python\n(.*?)```", page, re.S)
    module: dict[str, Any] = {}
    exec(compile(block, "docs/extending.md", "exec"), module)
    return module["Settle"]


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
