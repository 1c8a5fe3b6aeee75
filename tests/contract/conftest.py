"""The doors that a user has: a command with its words, and the log of a plant.

A command is run in a fork of the process of the tests, which has imported torch and the package already. Tests of how
a command starts, or of what it finds in its environment, have a process of their own.
"""

import os
import runpy
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, negative for a signal, and what it printed."""

    code: int
    out: str
    err: str


class Running:
    """A command that runs in a fork, with its output in files beside its folder."""

    def __init__(self, name: str, words: tuple[str, ...], cwd: Path, figures: bool) -> None:
        import warmed  # noqa: F401 - before the fork

        self.figures = figures
        cwd.mkdir(parents=True, exist_ok=True)
        self.files = [cwd.parent / f"{cwd.name}.{stream}" for stream in ("out", "err")]
        self.id = os.fork()
        if not self.id:
            self._be(name, words, cwd)

    def _be(self, name: str, words: tuple[str, ...], cwd: Path) -> None:
        """Become the process of the command."""
        code = 1
        try:
            os.chdir(cwd)
            if not self.figures:  # which are drawn from tables, and take as long as a small run
                sys.modules["dynasindy.viz.run"].draw_run = lambda *_, **__: None
                sys.modules["matplotlib.figure"].Figure.savefig = lambda *_, **__: None
            for descriptor, file in enumerate(self.files, 1):
                os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor)
            sys.stdout, sys.stderr = (os.fdopen(d, "w", buffering=1, closefd=False) for d in (1, 2))
            sys.argv = [f"{name}.py", *words]
            sys.path.insert(0, str(ROOT / "scripts"))
            runpy.run_path(str(ROOT / "scripts" / f"{name}.py"), run_name="__main__")
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    def send(self, number: int) -> None:
        """Send a signal to the command."""
        os.kill(self.id, number)

    def end(self, seconds: float = 1200.0) -> Ended:
        """Wait for the end of the command."""
        deadline = time.monotonic() + seconds
        while not (found := os.waitpid(self.id, os.WNOHANG))[0]:
            if time.monotonic() > deadline:
                self.send(signal.SIGKILL)
            time.sleep(0.005)
        return Ended(os.waitstatus_to_exitcode(found[1]), *(file.read_text(errors="replace") for file in self.files))


@pytest.fixture(scope="session")
def start() -> Any:
    """Return what starts a command by its name and its words in a folder, where figures are drawn if asked for."""
    return lambda name, *words, cwd, figures=False: Running(name, words, Path(cwd), figures)


@pytest.fixture(scope="session")
def command(start) -> Any:
    """Return what runs a command by its name and its words in a folder."""
    return lambda name, *words, seconds=1200.0, **more: start(name, *words, **more).end(seconds)


@pytest.fixture(scope="session")
def refused(command) -> Any:
    """Return what runs a command that must refuse its words, in one line and before it leaves anything."""

    def run(name: str, *words: str, cwd: Path) -> str:
        before = sorted(cwd.rglob("*"))
        done = command(name, *words, cwd=cwd)
        lines = [line for line in done.err.splitlines() if not line.startswith("sweep: ")]
        assert (done.code, len(lines)) == (2, 1), done
        assert lines[0].startswith("error: ") and sorted(cwd.rglob("*")) == before
        return lines[0]

    return run


@pytest.fixture(scope="session")
def log(tmp_path_factory, write_log) -> Path:
    """Return six seconds of a pendulum, Omega' = 12 u - 9.81 sin(theta) - 0.5 Omega, moved by a sum of sines.

    An encoder of 4096 steps measures its angle, and its rate is measured with a noise of 0.02 rad/s.
    """
    import math

    import torch

    from dynasindy.envs.rollout_data import record_plant
    from dynasindy.excitation import Multisine
    from dynasindy.systems import Pendulum

    data = record_plant(Pendulum(), Multisine(1, duration=6, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    count, noise = 2 * math.pi / 4096, torch.Generator().manual_seed(0)
    theta, rate = (data.x[:, :1] / count).round() * count, data.x[:, 1:]
    rate = rate + 0.02 * torch.randn(rate.shape, generator=noise, dtype=rate.dtype)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    return write_log(path, ["theta [rad]", "Omega [rad/s]", "u"], torch.cat([theta, rate], 1), data.u)


@pytest.fixture(scope="session")
def planned(command, log, tmp_path_factory) -> Path:
    """Return the folder of a short plan from the log, whose controller holds the pendulum all the same."""
    home = tmp_path_factory.mktemp("planned")
    words = ["data=csv", f"data.path={log}", "plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]
    words += [
        "plant.library=['1',u,theta,Omega,'sin(theta)']",
        "planning.updates=50",
        "planning.rollouts=32",
        "longest_delay=0",
    ]
    words += ["planning.window=30", "scenario.reference.number=8", "scenario.episodes=8", "evaluation.within=0.05"]
    words += ["task.max_steps=80"]
    done = command("train", *words, "folder=run", cwd=home)
    assert done.code == 0, done
    return home / "run"
