"""Files are written whole or not at all, and never through a link, whatever a folder of others holds."""

import csv
import json
import multiprocessing
import os
import re
import sys
import time
from pathlib import Path

import forked
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, load, save
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Step, Tracking, TrackingReward
from dynasindy.safe_io import append_rows
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature

REPOSITORY = Path(__file__).parents[2]
RESOURCE = pytest.importorskip("resource", reason="limits of a process are those of POSIX")
DIARY = "my diary"
SIGNATURE = Signature(("p", "v"), ("m", "m/s"), ("force",), (2.0, 3.0))
CHECK = ("points=1", "grid=2", "draws=1", "seconds=3")


def model(spring: float = 2.0) -> SindyModel:
    made = SindyModel(SIGNATURE, ["force", "v", "p"], known={"p": "v"})
    made.set_coefficients(torch.tensor([[0.0, 1.0], [1.0, -0.5], [0.0, -spring]]))
    return made


def controller(hidden: int = 4) -> Controller:
    task = Tracking(SIGNATURE, Step([[0.0]]), ("p",), ("v",), TrackingReward((1.0,)))
    policy = actor(task.n_o, 1, (hidden,)).requires_grad_(False)
    for weight in policy.parameters():
        weight *= 1e-3
    return Controller(policy, ControlSetup(task, 0.1))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return the folder of a finished run of a cart at a spring, beside a diary of the user."""
    folder = tmp_path / "run"
    save(controller(), folder / "controller.json")
    model().save(folder / "model.json")
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


def test_a_link_in_the_place_of_a_file_is_refused(run, tmp_path):
    os.replace(run / "metrics.json", tmp_path / "mine.json")
    (run / "metrics.json").symlink_to(tmp_path / "mine.json")
    refused(script("check", "run=run", *CHECK, cwd=tmp_path), "run/metrics.json")
    assert (tmp_path / "mine.json").read_text() == '{"episodes": 3}'


@pytest.mark.parametrize("place", ["check", "check/steps.png"])
def test_links_on_the_way_are_refused(run, tmp_path, place):
    (run / place).parent.mkdir(exist_ok=True)
    mine = tmp_path / "mine"
    mine.mkdir()
    (run / place).symlink_to(mine if place == "check" else tmp_path / "diary")
    refused(script("check", "run=run", *CHECK, cwd=tmp_path), f"run/{place}")
    assert (tmp_path / "diary").read_text() == DIARY and not any(mine.iterdir())


def test_an_export_stays_in_its_folder(run, tmp_path):
    (tmp_path / "mine").mkdir()
    (run / "export").symlink_to(tmp_path / "mine")
    before = contents(tmp_path)
    refused(script("export", "run=run", "formats=[c]", cwd=tmp_path), "run/export")
    assert contents(tmp_path) == before


IDENTIFY = ("system=pendulum", "excitation.duration=2", "data.validation_seconds=1", "hydra.run.dir=found")


@pytest.mark.parametrize("name", ["report.txt", "prediction.png"])
def test_an_identification_writes_through_no_link(tmp_path, name):
    (tmp_path / "diary").write_text(DIARY)
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / name).symlink_to(tmp_path / "diary")
    refused(script("identify", *IDENTIFY, cwd=tmp_path), f"found/{name}")
    assert (tmp_path / "diary").read_text() == DIARY


def test_a_run_in_a_folder_of_others_writes_through_no_link(tmp_path):
    mine, folder = tmp_path / "mine", tmp_path / "run"
    mine.mkdir()
    folder.mkdir()
    (folder / "progress.csv").symlink_to(mine / "diary")
    refused(script("train", "experiment=smoke", "hydra.run.dir=run", cwd=tmp_path), "run/progress.csv")
    assert not any(mine.iterdir())


def test_a_sweep_writes_through_no_link(tmp_path):
    (tmp_path / "diary").write_text(DIARY)
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "multirun.yaml").symlink_to(tmp_path / "diary")
    words = ("-m", "seed=0,1", "experiment=smoke", "hydra.sweep.dir=sweep")
    refused(script("train", *words, cwd=tmp_path), "sweep/multirun.yaml")
    assert (tmp_path / "diary").read_text() == DIARY


def test_a_rig_does_not_move_for_figures_that_would_lie_elsewhere(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "figures").symlink_to(tmp_path / "mine")
    refused(script("rig", "system=xi", "folder=session", "hydra.run.dir=session", cwd=tmp_path), "session/figures")
    assert not any((tmp_path / "mine").iterdir()) and not list((tmp_path / "session").glob("*.csv"))


def test_a_log_of_rows_is_not_appended_to_through_a_link(tmp_path):
    (tmp_path / "diary").write_text(DIARY)
    (tmp_path / "rows.csv").symlink_to(tmp_path / "diary")
    with pytest.raises(ValueError, match=r"rows\.csv"):
        append_rows(tmp_path / "rows.csv", ("a",), [{"a": 1}])
    assert (tmp_path / "diary").read_text() == DIARY


def test_a_device_keeps_its_place(tmp_path):
    os.mkfifo(tmp_path / "model.json")
    with pytest.raises(ValueError, match=r"model\.json"):
        model().save(tmp_path / "model.json")
    assert (tmp_path / "model.json").is_fifo()


def _write_for(seconds: float, path: str, spring: float, said) -> None:
    ready, failed, number = model(spring), 0, 0
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
    model().save(path)
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


def test_a_full_disk_leaves_an_earlier_identification_as_it_was(tmp_path):
    done = script("identify", *IDENTIFY, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    before = contents(tmp_path / "found")
    assert len(before["report.txt"]) > 600
    small = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))"
    refused(script("identify", *IDENTIFY, cwd=tmp_path, before=small), "found/")
    assert {name: data for name, data in contents(tmp_path / "found").items() if name != "error.txt"} == before


@pytest.fixture
def full_disk(monkeypatch):
    """Let a disk be full where a file is to reach it."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)


def test_a_full_disk_leaves_a_model_and_a_controller_as_they_were(run, full_disk):
    before = contents(run)
    with pytest.raises(OSError, match=r"model\.json"):
        model(7.0).save(run / "model.json")
    with pytest.raises(OSError, match=r"controller\.json"):
        save(controller(hidden=5), run / "controller.json")
    assert contents(run) == before
    assert load(run).policy is not None


def test_rows_are_appended_whole_or_not_at_all(tmp_path):
    """The disk of a process of its own is full after 100 bytes."""
    path = tmp_path / "rows.csv"
    append_rows(path, ("name", "value"), [{"name": "a", "value": 1}])
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
        "from pathlib import Path; from dynasindy.safe_io import append_rows\n"
        f"path = Path({str(path)!r})\n"
        "try: append_rows(path, ('name', 'value'), [{'name': 'b' * 30, 'value': k} for k in range(9)])\n"
        "except OSError as error: print(error.filename)"
    )
    done = forked.run([sys.executable, "-c", code], cwd=tmp_path)
    assert done.stdout.strip() == str(path), done.stderr
    with path.open(newline="") as file:
        assert list(csv.reader(file)) == [["name", "value"], ["a", "1"]]


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
