"""Files are written whole or not at all, and never through a link, whatever a folder of others holds."""

import json
import multiprocessing
import os
import re
import time
from pathlib import Path

import forked
import pytest
from carts import make_cart, make_idle_controller, save_run

from dynasindy.control import load, save

DIARY = "my diary"
CHECK = ("points=1", "grid=2", "draws=1", "seconds=3")
IDENTIFY = ("system=pendulum", "excitation.duration=2", "data.validation_seconds=1", "hydra.run.dir=found")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return the folder of a finished run of a cart at a spring, beside a diary of the user."""
    folder = tmp_path / "run"
    save_run(folder)
    (folder / "config.yaml").write_text("plant: {low: [-0.1], high: [0.1]}\n")
    (folder / "metrics.json").write_text('{"episodes": 3}')
    (tmp_path / "diary").write_text(DIARY)
    return folder


def script(name: str, *words: str, cwd: Path, before: str = "", timeout: float = 300):
    """Run a command as a user does, after a line of Python of its own."""
    return forked.run(forked.script(name, *words, before=before), cwd=cwd, timeout=timeout)


def refused(done, path: Path | str) -> None:
    """Assert that a command ended with one line that names a file."""
    assert done.returncode == 2, done.stderr
    *progress, last = done.stderr.strip().splitlines()  # a busy computer says how long it takes
    assert last.startswith("error: ") and str(path) in last, done.stderr
    assert not any(re.match(r"error|Traceback|\s", line) for line in progress), done.stderr


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_link_at_a_name_that_can_be_foretold_leads_nowhere(run, tmp_path):
    for name in (".metrics.json.tmp", "metrics.tmp", "metrics.json.tmp"):
        (run / name).symlink_to(tmp_path / "diary")
    done = script("check", "run=run", *CHECK, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "diary").read_text() == DIARY
    assert not (run / "metrics.json").is_symlink() and "check" in json.loads((run / "metrics.json").read_text())


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("run/metrics.json", ("check", "run=run", *CHECK)),
        ("run/check", ("check", "run=run", *CHECK)),
        ("run/check/steps.png", ("check", "run=run", *CHECK)),
        ("run/export", ("export", "run=run", "formats=[c]")),
        ("found/report.txt", ("identify", *IDENTIFY)),
        ("new/progress.csv", ("train", "experiment=smoke", "hydra.run.dir=new")),
        ("sweep/multirun.yaml", ("train", "-m", "seed=0,1", "experiment=smoke", "hydra.sweep.dir=sweep")),
        ("session/figures", ("rig", "system=xi", "folder=session", "hydra.run.dir=session")),
    ],
)
def test_no_command_writes_through_a_link(run, tmp_path, place, words):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "file").write_text('{"episodes": 3}')
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).unlink(missing_ok=True)
    (tmp_path / place).symlink_to(mine / "file" if "." in place else mine)
    refused(script(*words, cwd=tmp_path), place)
    assert contents(mine) == {"file": b'{"episodes": 3}'}
    assert not list((tmp_path / place).parent.glob("log*.csv"))  # a rig did not move


def test_a_device_keeps_its_place(tmp_path):
    os.mkfifo(tmp_path / "model.json")
    with pytest.raises(ValueError, match=r"model\.json"):
        make_cart().save(tmp_path / "model.json")
    assert (tmp_path / "model.json").is_fifo()


def _write_for(seconds: float, path: str, spring: float, said) -> None:
    ready, failed, number = make_cart(spring=spring), 0, 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        number += 1
        try:
            ready.save(path)
        except OSError:
            failed += 1
    said.put((number, failed))


def test_two_writers_and_a_reader_meet_whole_files_only(tmp_path):
    path, context = tmp_path / "model.json", multiprocessing.get_context("fork")
    make_cart(spring=2.0).save(path)
    said = context.Queue()
    writers = [context.Process(target=_write_for, args=(1.5, str(path), spring, said)) for spring in (2.0, 3.0)]
    for writer in writers:
        writer.start()
    read = 0
    while any(writer.is_alive() for writer in writers):
        record = json.loads(path.read_text())
        assert record["coefficients"]["v"]["p"] in (-2.0, -3.0)
        read += 1
    counts = [said.get(timeout=30) for _ in writers]
    for writer in writers:
        writer.join()
    assert read and all(number > 1 and failed == 0 for number, failed in counts), counts
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture
def full_disk(monkeypatch):
    """Let a disk be full where a file is to reach it."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)


def test_a_full_disk_leaves_a_model_and_a_controller_as_they_were(run, full_disk):
    before = contents(run)
    with pytest.raises(OSError, match=r"model\.json"):
        make_cart(spring=7.0).save(run / "model.json")
    with pytest.raises(OSError, match=r"controller\.json"):
        save(make_idle_controller(hidden=5), run / "controller.json")
    assert contents(run) == before
    assert load(run).policy is not None


WATCHED = """
import os, sys
def _opened(event, words):
    if event != "open" or not isinstance(words[0], (str, bytes, os.PathLike)):
        return
    path, flags = os.path.abspath(os.fsdecode(words[0])), words[2]
    writes = flags & (os.O_WRONLY | os.O_RDWR) and not os.path.isdir(path)  # a file without a name has its folder's
    safe = flags & os.O_EXCL or (flags & os.O_APPEND and flags & os.O_NOFOLLOW)
    if writes and not safe and path.startswith(os.getcwd() + os.sep):
        print("UNSAFE", path, flush=True)
sys.addaudithook(_opened)
"""
"""Tells of files in the present folder that are opened for writing where something may already lie."""


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("identify", IDENTIFY),
        ("check", ("run=run", *CHECK)),
        ("export", ("run=run", "formats=[c,onnx,fmu,model]")),
        pytest.param(
            "train",
            ("experiment=gradient_smoke", "env.substeps=1", "excitation.duration=3", "hydra.run.dir=new"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_every_file_is_begun_where_nothing_lies(run, tmp_path, name, words):
    if name == "export":
        pytest.importorskip("onnx")
    done = script(name, *words, cwd=tmp_path, before=WATCHED)
    assert done.returncode == 0, done.stderr
    unsafe = [line for line in done.stdout.splitlines() if line.startswith("UNSAFE")]
    assert unsafe == []
    assert not list(tmp_path.rglob(".*.tmp"))
