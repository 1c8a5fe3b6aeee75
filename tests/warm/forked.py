"""Commands of a terminal in processes that have imported the libraries of others already.

A command takes some four seconds of one core to import torch, TorchRL and what they need, and the tests call hundreds.
So a server (`multiprocessing`'s forkserver) imports them once, and each command is a fork of it. Nothing of `dynasindy`
is among them: a command imports it anew, with its own settings, folder and environment, and ends as any process does.
What a command says or leaves out before its work begins is not seen in such a fork: what is imported, and what that
prints. Tests of that start a process of their own.
"""

import atexit
import json
import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
import traceback
import types
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

LIBRARIES = (
    *("torch", "tensordict", "tensordict.nn", "torchrl", "torchrl.data", "torchrl.envs", "torchrl.modules"),
    *("torchrl.objectives", "torchrl.record", "torchrl.collectors", "hydra", "hydra.main", "omegaconf", "gymnasium"),
    *("scipy.linalg", "scipy.optimize", "scipy.signal", "tqdm", "matplotlib.pyplot", "matplotlib.animation"),
)


@cache
def _server() -> multiprocessing.context.ForkServerContext:
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(list(LIBRARIES))
    return server


@cache
def _installed() -> list[str]:
    """Return where Python looks for modules if nothing else is said."""
    asked = [sys.executable, "-c", "import json, sys; print(json.dumps(sys.path))"]
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(asked, cwd="/", env=plain, capture_output=True, text=True, check=True)
    return [place for place in json.loads(done.stdout) if place]


def run(
    command: Sequence[str | Path],
    *,
    cwd: str | Path | None = None,
    env: Mapping[str, str] | None = None,
    timeout: float = 300,
    check: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Do what `subprocess.run(..., capture_output=True, text=True)` does with Python: a script, `-m` or `-c`.

    Raises:
        ValueError: The command is another one.
        subprocess.TimeoutExpired: It takes longer than `timeout` [s].
        subprocess.CalledProcessError: It fails, and `check` is true.
    """
    python, *words = (str(word) for word in command)
    if python != sys.executable or not (words[0] in ("-m", "-c") or words[0].endswith(".py")):
        raise ValueError(f"{command} is not Python with a script, -m or -c; use subprocess.run")
    folder = Path(cwd or Path.cwd()).resolve()
    environment = dict(os.environ if env is None else env)
    with tempfile.TemporaryDirectory() as told:
        process = _server().Process(target=_command, args=(words, folder, environment, _installed(), told))
        process.start()
        process.join(timeout)
        if process.exitcode is None:
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired(list(command), timeout)
        out, err = ((Path(told) / name).read_text() if (Path(told) / name).exists() else "" for name in ("1", "2"))
    done = subprocess.CompletedProcess(list(command), process.exitcode, out, err)
    if check:
        done.check_returncode()
    return done


def _command(words: list[str], folder: Path, environment: dict[str, str], installed: list[str], told: str) -> None:
    """Become the process of a command, in a fork of the server."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number in (1, 2):
        file = os.open(Path(told) / str(number), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    more = [place for place in environment.get("PYTHONPATH", "").split(os.pathsep) if place]
    first = {"-m": str(folder), "-c": ""}.get(words[0], str(Path(words[0]).resolve().parent))
    sys.path[:] = [first, *more, *installed]
    sys.exit(_done(words))


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
        traceback.print_exc()
        code = 1
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def _main() -> types.ModuleType:
    """Return an empty main module, in which `-c` puts what it names."""
    main = sys.modules["__main__"] = types.ModuleType("__main__")
    return main
