"""Memory that runs out is one line, which says what to lower; nothing that was kept is lost for it."""

import sys
from pathlib import Path

import forked
import numpy as np
import pytest
import torch

from dynasindy.dyna.run import Checkpoints
from dynasindy.limits import check_memory, memory, memory_wanted

REPOSITORY = Path(__file__).parents[2]
RESOURCE = pytest.importorskip("resource", reason="limits of a process are those of POSIX")
ENOUGH = """
import resource
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + {more}, size + {more}))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not say what a process has")
@pytest.mark.parametrize(
    ("more", "words", "key"),
    [
        (
            700_000_000,
            ("replay.capacity=4000000",),
            "replay.capacity",
        ),  # beside torch there is no room
        (700_000_000, ("replay.capacity=900000000",), "replay.capacity"),
        (2_000_000_000, ("task.max_steps=900000000",), "task.max_steps"),
        (2_000_000_000, ("scenario.seconds=1e8",), "scenario.seconds"),
    ],
)
def test_a_command_that_wants_more_than_it_may_have_ends_in_one_line(tmp_path, more, words, key):
    given = ("experiment=smoke", "env.substeps=1", "hydra.run.dir=run", *words)
    done = forked.run(forked.script("train", *given, before=ENOUGH.format(more=more)), cwd=tmp_path, timeout=500)
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2, done.stderr
    assert lines[-1].startswith("error: ") and key in lines[-1], done.stderr
    assert "Traceback" not in done.stderr and sum(line.startswith("error") for line in lines) == 1


def errors() -> list[BaseException]:
    """Return what the libraries raise where memory runs out."""
    found: list[BaseException] = []
    for ask in (
        lambda: bytes(1 << 60),
        lambda: np.empty(1 << 57),
        lambda: torch.empty(1 << 55),
    ):
        with pytest.raises((MemoryError, RuntimeError)) as raised:
            ask()
        found.append(raised.value)
    return [*found, RuntimeError("std::bad_alloc"), OSError(12, "Cannot allocate memory")]


def test_every_library_is_understood():
    assert None not in map(memory_wanted, errors())
    others = (ValueError("out of memory"), RuntimeError("shapes differ"), OSError(28, "No space left"), KeyError("a"))
    assert {*map(memory_wanted, others)} == {None}
    wanted = [memory_wanted(error) for error in errors()[1:3]]
    assert wanted[0].endswith("iB") and float(wanted[1].split()[0]) == pytest.approx(4 * 2**55 / 1e9, rel=0.01)


def test_a_limit_of_the_user_counts_as_the_memory_that_is_there(tmp_path):
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))\n"
        "from dynasindy.limits import memory; print(memory())"
    )
    done = forked.run([sys.executable, "-c", code], cwd=tmp_path)
    assert float(done.stdout) == min(memory(), 2**33), done.stderr
    with pytest.raises(ValueError, match="rows=3"):
        check_memory(memory() + 1, "rows=3")


def test_a_checkpoint_that_does_not_fit_is_not_taken_for_a_damaged_one(tmp_path, monkeypatch):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"number": 1})

    def exhausted(*_: object, **__: object) -> None:
        raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes.")

    monkeypatch.setattr(torch, "load", exhausted)
    with pytest.raises(RuntimeError, match="allocate"):
        checkpoints.newest()
    monkeypatch.undo()
    assert checkpoints.newest() == {"number": 1}
