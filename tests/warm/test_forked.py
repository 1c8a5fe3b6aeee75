"""A command in a fork says and leaves what the same command does as a process of its own."""

import ctypes
import os
import subprocess
import sys
import time
from pathlib import Path

import forked
import pytest

SCRIPT = """
import atexit, os, sys
from pathlib import Path
import beside
atexit.register(print, "at its end")
if __name__ == "__main__":
    print(sys.argv, Path.cwd().name, os.environ.get("GIVEN"), "PATH" in os.environ, beside.NAME)
    print("FROM_OUTSIDE" in os.environ, sys.path)
    print("an error", file=sys.stderr)
    sys.path and Path("left").write_text(sys.path[0])
    how = sys.argv[1]
    if how == "raise":
        raise KeyError("the plant")
    sys.exit({"zero": 0, "words": "what is wrong"}[how])
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "work.py").write_text(SCRIPT)
    (tmp_path / "scripts" / "beside.py").write_text("NAME = 'beside the script'")
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "beside.py").write_text("NAME = 'on the path'")
    (tmp_path / "work").mkdir()
    return tmp_path


def both(command, **more):
    given = {"capture_output": True, "text": True, **more}
    return forked.run(command, **more), subprocess.run(command, **given)


@pytest.mark.parametrize("how", ["zero", "words", "raise"])
def test_a_script_ends_alike(folder, how, monkeypatch):
    monkeypatch.setenv("FROM_OUTSIDE", "which the environment of the command lacks")
    environment = {"GIVEN": "a word", "PATH": os.environ["PATH"]}
    command = [sys.executable, str(folder / "scripts" / "work.py"), how, "x=[1, 2]"]
    ours, plain = both(command, cwd=folder / "work", env=environment)
    assert (ours.returncode, ours.stdout) == (plain.returncode, plain.stdout)
    assert "a word" in ours.stdout and "beside the script" in ours.stdout and ours.stdout.endswith("at its end\n")
    assert ours.stderr.splitlines()[0] == "an error" and ours.stderr.splitlines()[-1] == plain.stderr.splitlines()[-1]
    assert (folder / "work" / "left").read_text() == str(folder / "scripts")


@pytest.mark.parametrize(
    "words",
    [
        ["-m", "beside"],
        ["-c", "import sys, beside; x = 1; print(beside.NAME, sys.argv, sys.path, (lambda: x)())", "y"],
        ["-c", "import tempfile; print(tempfile.gettempdir())"],
        ["-c", "import threading as t, time; t.Thread(target=lambda: (time.sleep(0.2), print('later'))).start()"],
        ["-c", "import os, time; os.fork() or (time.sleep(0.2), print('from a child that stays'))"],
    ],
    ids=["module", "line", "folder", "thread", "child"],
)
def test_so_do_a_module_and_a_line(folder, words):
    environment = {**os.environ, "PYTHONPATH": str(folder / "more"), "TMPDIR": str(folder)}
    ours, plain = both([sys.executable, *words], cwd=folder / "work", env=environment)
    assert (ours.returncode, ours.stdout, ours.stderr) == (plain.returncode, plain.stdout, plain.stderr)
    assert ours.returncode == 0


def test_what_commands_need_is_there():
    code = "import sys; print(all(m in sys.modules for m in ('torchrl.envs', 'pandas', 'dynasindy.dyna.run')))"
    assert forked.run([sys.executable, "-c", code]).stdout == "True\n"


def test_two_commands_draw_other_numbers():
    code = "import random, numpy; print(random.random(), numpy.random.rand())"
    first, second = (forked.run([sys.executable, "-c", code]).stdout.split() for _ in range(2))
    assert first[0] != second[0] and first[1] != second[1]


def test_what_takes_too_long_is_killed_and_what_it_said_is_told():
    code = "import os, time; print(os.getpid(), flush=True); time.sleep(600)"
    with pytest.raises(subprocess.TimeoutExpired) as late:
        forked.run([sys.executable, "-c", code], timeout=3)
    process, deadline = Path(f"/proc/{int(late.value.output)}"), time.monotonic() + 60
    while process.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not process.exists()


def test_what_fails_or_is_no_python_is_told():
    with pytest.raises(subprocess.CalledProcessError):
        forked.run([sys.executable, "-c", "import sys; sys.exit(3)"], check=True)
    with pytest.raises(ValueError, match=r"use subprocess\.run"):
        forked.run(["ls"])


@pytest.mark.skipif(not os.environ.get("CC_KEPT"), reason="no compiler, or one that is not asked through tests/warm/cc")
def test_the_same_text_is_compiled_once_and_another_header_makes_it_another_text(tmp_path):
    def compiled(name, value):
        (tmp_path / "value.h").write_text(f"#define VALUE {value}\n")
        (tmp_path / "value.c").write_text('#include "value.h"\nint value(void) { return VALUE; }\n')
        words = [os.environ["CC"], "-shared", "-fPIC", "value.c", "-o", f"{name}.so"]
        subprocess.run(words, cwd=tmp_path, check=True, env={**os.environ, "CC_KEPT": str(kept)})
        return ctypes.CDLL(str(tmp_path / f"{name}.so")).value()

    (kept := tmp_path / "kept").mkdir()
    assert [compiled("a", 1), compiled("b", 1), len(list(kept.iterdir()))] == [1, 1, 1]
    assert [compiled("c", 2), len(list(kept.iterdir()))] == [2, 2]
    refused = subprocess.run([os.environ["CC"], "nothing.c", "-o", "d.so"], cwd=tmp_path, capture_output=True)
    assert refused.returncode != 0 and refused.stderr and len(list(kept.iterdir())) == 2
