"""Commands of a terminal in processes that have imported what they need already.

A command takes some six seconds of one core to import torch, TorchRL and what they need, and the tests call hundreds.
So a server (`multiprocessing`'s forkserver) imports it once (`warmed`), and each command is a fork of it, with its own
settings, folder and environment.

Some things are not as in a process of its own. Imports that are forgotten, and what imports print, are not seen. The
order of sets of words, and what libraries read of the environment when they are imported, are those of the server.
Tests of that start a process of their own.
"""

import atexit
import json
import multiprocessing
import os
import random
import runpy
import subprocess
import sys
import tempfile
import threading
import time
import types
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.machinery import PathFinder
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from hydra.core.plugins import Plugins
from hydra.core.singleton import Singleton

ROOT = Path(__file__).resolve().parents[2]
DRAWING_NOTHING = """
import dynasindy.viz.run, matplotlib.figure
dynasindy.viz.run.draw_run = matplotlib.figure.Figure.savefig = lambda *_, **__: None
"""
"""Figures are drawn from tables, and take as long as a small run."""


@cache
def _server() -> multiprocessing.context.ForkServerContext:
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(["warmed"])  # an error in it would go unheard
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), before]))
    try:
        forkserver.ensure_running()
    finally:
        del os.environ["PYTHONPATH"]
        if before is not None:
            os.environ["PYTHONPATH"] = before
    return server


@cache
def _installed() -> list[str]:
    """Return where Python looks for modules if nothing else is said."""
    asked = [sys.executable, "-c", "import json, sys; print(json.dumps(sys.path))"]
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(asked, cwd="/", env=plain, capture_output=True, text=True, check=True)
    return [place for place in json.loads(done.stdout) if place]


def script(name: str, *words: str, before: str = "") -> list[str]:
    """Return the command of a script of this repository, after lines of Python of its own."""
    path = str(ROOT / "scripts" / f"{name}.py")
    code = f"{before}\nimport runpy, sys; sys.argv[0] = {path!r}; sys.path.insert(0, {str(Path(path).parent)!r})"
    return [sys.executable, "-c", f"{code}\nrunpy.run_path({path!r}, run_name='__main__')", *words]


class Running:
    """A command that runs in a fork of the server: Python with a script, `-m` or `-c`."""

    def __init__(
        self, command: Sequence[str | Path], cwd: str | Path | None = None, env: Mapping[str, str] | None = None
    ) -> None:
        python, *words = (str(word) for word in command)
        if python != sys.executable or not (words[0] in ("-m", "-c") or words[0].endswith(".py")):
            raise ValueError(f"{command} is not Python with a script, -m or -c; use subprocess.run")
        pipes = [multiprocessing.Pipe(duplex=False) for _ in range(2)]
        given = (words, Path(cwd or Path.cwd()).resolve(), dict(os.environ if env is None else env), _installed())
        self.process = _server().Process(target=_command, args=(*given, [writer for _, writer in pipes]))
        self.process.start()
        for _, writer in pipes:
            writer.close()  # or its other end would wait for this one
        self.command, self.said = [*command], [list[bytes](), list[bytes]()]
        pairs = zip((reader for reader, _ in pipes), self.said, strict=True)
        self.threads = [threading.Thread(target=_listen, args=pair, daemon=True) for pair in pairs]
        for thread in self.threads:
            thread.start()

    def send(self, number: int) -> None:
        """Send a signal to the command, unless it has ended."""
        with suppress(ProcessLookupError):
            os.kill(self.process.pid, number)  # type: ignore[arg-type]

    def end(self, timeout: float = 300) -> subprocess.CompletedProcess[str]:
        """Wait for its end, and that of what it has started."""
        deadline = time.monotonic() + timeout
        try:
            for thread in self.threads:
                thread.join(max(0.0, deadline - time.monotonic()))
            out, err = (b"".join(pieces) for pieces in self.said)
            if any(thread.is_alive() for thread in self.threads):
                raise subprocess.TimeoutExpired(self.command, timeout, output=out, stderr=err)
            self.process.join()
        except BaseException:  # a test that is stopped leaves no command behind
            self.process.kill()
            raise
        return subprocess.CompletedProcess(self.command, self.process.exitcode or 0, out.decode(), err.decode())


def _listen(reader: Connection, pieces: list[bytes]) -> None:
    while piece := os.read(reader.fileno(), 65536):
        pieces.append(piece)


def run(
    command: Sequence[str | Path],
    *,
    cwd: str | Path | None = None,
    env: Mapping[str, str] | None = None,
    timeout: float = 300,
) -> subprocess.CompletedProcess[str]:
    """Do what `subprocess.run(..., capture_output=True, text=True)` does with a command that `Running` takes."""
    if "forkserver" not in multiprocessing.get_all_start_methods():  # as on Windows
        return subprocess.run([*command], capture_output=True, text=True, cwd=cwd, env=env, timeout=timeout)
    return Running(command, cwd, env).end(timeout)


def call(name: str, *words: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """Do what `run` does with a script of this repository."""
    return run([sys.executable, ROOT / "scripts" / f"{name}.py", *words], **more)


def _command(
    words: list[str], folder: Path, environment: dict[str, str], installed: list[str], writers: list[Connection]
) -> None:
    """Become the process of a command, in a fork of the server."""
    os.chdir(folder)
    known = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    os.environ.clear()
    os.environ.update(environment)
    for number, writer in enumerate(writers, 1):
        os.dup2(writer.fileno(), number)
        writer.close()
    # What a process of its own would find out anew.
    np.random.seed()  # noqa: NPY002 - the generator that all forks would share
    random.seed()
    tempfile.tempdir = None
    multiprocessing.process.ORIGINAL_DIR = str(folder)  # type: ignore[attr-defined]
    more = [place for place in environment.get("PYTHONPATH", "").split(os.pathsep) if place]
    first = {"-m": str(folder), "-c": ""}.get(words[0], str(Path(words[0]).resolve().parent))
    sys.path[:] = [first, *more, *installed]
    if not {*more} <= {*known}:
        Singleton._instances.pop(Plugins, None)  # Hydra looks for plug-ins once, and there may be others
    _forget_other_copies()
    sys.exit(_done(words))


def _forget_other_copies() -> None:
    """Let a command whose path leads to a copy of the package import that one."""
    ours, found = getattr(sys.modules.get("dynasindy"), "__file__", None), PathFinder.find_spec("dynasindy")
    if ours is None or found is None or found.origin == ours:
        return
    package = Path(ours).parent
    for name, module in list(sys.modules.items()):
        file = Path(getattr(module, "__file__", None) or "")
        if file.is_relative_to(package) or file.parent == package.parent / "scripts":
            del sys.modules[name]
    registry = sys.modules["gymnasium"].registry
    for name in [name for name in registry if name.startswith("dynasindy/")]:
        del registry[name]


def _done(words: list[str]) -> int:
    """Do the work of a command to its end, and return its exit code as Python tells it to the system."""
    how, sys.argv = words[0], words if words[0].endswith(".py") else words[1:]
    code = 0
    try:
        if how == "-m":
            runpy.run_module(words[1], run_name="__main__", alter_sys=True)
        elif how == "-c":
            sys.argv = ["-c", *words[2:]]
            exec(compile(words[1], "<string>", "exec"), vars(_main()))
        else:
            runpy.run_path(how, run_name="__main__")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if code and not isinstance(end.code, int):
            print(end.code, file=sys.stderr)
    except BaseException:
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        code = 1
    # A process of multiprocessing ends without them.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    return code


def _main() -> types.ModuleType:
    """Return an empty main module, in which `-c` puts what it names."""
    main = sys.modules["__main__"] = types.ModuleType("__main__")
    return main
