"""The doors that a user has: a command with its words, and the log of a plant."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import forked
import pytest


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, negative for a signal, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="session")
def command() -> Any:
    """Return what runs a command by its name and its words in a folder, where figures are drawn if asked for."""

    def run(name: str, *words: str, cwd: Path, figures: bool = False, seconds: float = 1200.0) -> Ended:
        cwd.mkdir(parents=True, exist_ok=True)
        words = forked.script(name, *words, before="" if figures else forked.DRAWING_NOTHING)
        done = forked.run(words, cwd=cwd, timeout=seconds)
        return Ended(done.returncode, done.stdout, done.stderr)

    return run


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

    from dynasindy.dyna.simulated import record_plant
    from dynasindy.envs import Multisine
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
