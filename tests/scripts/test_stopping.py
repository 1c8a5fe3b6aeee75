"""Runs that are killed, terminated or interrupted at random moments, and go on.

DYNASINDY_MOMENTS=50 tries as many moments of each experiment; DYNASINDY_MOMENTS_CSV names a file for the rows.
The children are forked, so that the seconds of imports are paid once; one test starts a process of its own.
"""

import csv
import hashlib
import json
import os
import random
import re
import resource
import runpy
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import forked
import pytest
import torch

from dynasindy.data.rollout_data import record_plant
from dynasindy.excitation import Multisine
from dynasindy.systems import Pendulum

ROOT = Path(__file__).resolve().parents[2]
MOMENTS = int(os.environ.get("DYNASINDY_MOMENTS", 1))
SMALL = (
    "system=xi", "env.dt=0.1", "env.substeps=3", "task.max_steps=25", "excitation.duration=2.5",
    "scenario.episodes=2", "scenario.seconds=5", "evaluation.every=2",
)  # fmt: skip
EXPERIMENTS = {
    "dyna": (
        "experiment=dyna", "evaluation.must_improve=false", "train.episodes=3",
        "train.updates_per_step=2",
        "planning.rollouts=20", "planning.horizon=20", "agent.hidden=[32,32]", "replay.capacity=10000",
        "replay.model_capacity=1500",
    ),
    "default": (
        "evaluation.must_improve=false", "planning.updates=10",
        "planning.more_updates=10", "planning.rollouts=8", "planning.window=20",
    ),
}  # fmt: skip
CODES = {"SIGKILL": -9, "SIGINT": 130, "SIGTERM": 143}


def fork(words, cwd, script="train"):
    """Start a script in a forked child that writes its output to `cwd/output`; return its process id."""
    import hydra  # noqa: F401 - before the fork

    import dynasindy.dyna.run
    import dynasindy.viz.run

    cwd.mkdir(parents=True, exist_ok=True)
    if pid := os.fork():
        return pid
    code = 1
    try:
        os.chdir(cwd)
        # Figures are drawn from the tables that are compared, and take as long as the run; but for their legend.
        dynasindy.viz.run.draw_run = lambda folder, signature, controller: (folder / "legend").write_text(controller)
        with open("output", "w") as file:
            for descriptor in (1, 2):
                os.dup2(file.fileno(), descriptor)
        sys.stdout, sys.stderr = (os.fdopen(d, "w", buffering=1, closefd=False) for d in (1, 2))
        sys.argv = [f"{script}.py", *words]
        sys.path.insert(0, str(ROOT / "scripts"))
        runpy.run_path(str(ROOT / "scripts" / f"{script}.py"), run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def wait(pid):
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def kept(folder):
    """Return a digest of each file that a run left, without the times it took."""
    found = {}
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        name, raw = str(file.relative_to(folder)), file.read_bytes()
        if "wall_seconds" in name or name == "origin.json":
            continue
        if file.suffix == ".csv":
            rows = list(csv.reader(raw.decode().splitlines()))
            drop = [i for i, cell in enumerate(rows[0]) if cell == "wall_seconds"]
            raw = repr([[cell for i, cell in enumerate(row) if i not in drop] for row in rows]).encode()
        elif file.suffix == ".pt":
            raw = repr({key: value.tolist() for key, value in torch.load(file).items()}).encode()
        elif name == "metrics.json":
            record_plant = json.loads(raw)
            del record_plant["cost"]["wall_seconds"], record_plant["checkpoint"]
            raw = json.dumps(record_plant).encode()
        elif name == "config.yaml":
            raw = re.sub(rb"folder: .*", b"", raw)
        elif file.suffix == ".txt":
            raw = re.sub(rb"[0-9.e-]+ s\b", b"", raw)
        found[name] = hashlib.sha256(raw).hexdigest()
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return, once for each experiment, what the run that nobody stops leaves, and how long it takes [s]."""
    found = {}

    def make(name):
        if name not in found:
            home, start = tmp_path_factory.mktemp(name), time.perf_counter()
            assert wait(fork([*EXPERIMENTS[name], *SMALL, "hydra.run.dir=run"], home)) == 0, (
                home / "output"
            ).read_text()
            found[name] = kept(home / "run"), time.perf_counter() - start
        return found[name]

    return make


@pytest.mark.slow
@pytest.mark.parametrize("number", range(MOMENTS))
@pytest.mark.parametrize("name", EXPERIMENTS)
@pytest.mark.parametrize("how", CODES)
def test_a_run_stopped_at_a_random_moment_ends_as_the_one_that_was_not(tmp_path, whole, how, name, number):
    expected, seconds = whole(name)
    moment = random.Random(f"{how} {name} {number}").uniform(0.0, 1.0)
    command = [*EXPERIMENTS[name], *SMALL, "hydra.run.dir=run"]
    pid = fork(command, tmp_path)
    time.sleep(moment * seconds)
    os.kill(pid, getattr(signal, how))
    code, output = wait(pid), (tmp_path / "output").read_text()
    stopped = code != 0  # it may have ended before
    if stopped:
        assert code == CODES[how], output
    if stopped and how != "SIGKILL":
        assert "Traceback" not in output and "Exception ignored" not in output, output
        assert len(re.findall(r"(?:^|[\r\n])stopped", output)) == 1, output
    begun = (tmp_path / "run" / "config.yaml").is_file()
    line = re.findall(r"up to the end of ([^:]*):", output)
    assert wait(fork(["resume=run"] if begun else command, tmp_path)) == 0, (tmp_path / "output").read_text()
    found = kept(tmp_path / "run")
    if file := os.environ.get("DYNASINDY_MOMENTS_CSV"):
        place = line[0] if line else ""
        row = [how, name, number, f"{moment:.3f}", int(stopped), code, place, int(found == expected)]
        with Path(file).open("a") as table:
            csv.writer(table, lineterminator="\n").writerow(row)
    assert found == expected


SWEEP = ("-m", *EXPERIMENTS["default"][1:3], *SMALL, "planning.window=20", "train.episodes=1", "planning.rollouts=-5,4")


def test_a_job_that_fails_ends_no_sweep_and_what_is_finished_is_not_repeated(tmp_path):
    assert wait(fork(SWEEP, tmp_path)) == 2
    output = (tmp_path / "output").read_text()
    assert "error: 1 jobs failed" in output and "Traceback" not in output
    (done,) = (tmp_path / "runs").glob("*/*/metrics.json")
    (failed,) = (tmp_path / "runs").glob("*/*/error.txt")
    assert "rollouts=-5" in failed.read_text() and "rollouts-4" in done.parent.name
    before = done.stat().st_mtime_ns
    assert wait(fork(SWEEP, tmp_path)) == 2
    assert done.stat().st_mtime_ns == before
    assert f"finished before: {done.parent}" in (tmp_path / "output").read_text()


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        ("level.error=-1", "level has error=-1"),
        ("results=output", "output"),  # a file, and no folder for tables
        ("threads=1000000", "threads is 1000000"),
    ],
)
def test_what_all_jobs_of_an_ablation_share_is_checked_before_the_first(tmp_path, mistake, words):
    assert wait(fork(["experiment=smoke", "hydra/launcher=basic", mistake], tmp_path, "ablation")) == 2
    lines = (tmp_path / "output").read_text().strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ") and words in lines[0], lines
    assert not list(tmp_path.rglob("config.yaml"))


def test_a_task_that_no_job_of_a_sweep_could_build_is_told_before_the_first(tmp_path):
    box = ("plant.outputs=[alpha_a,omega_a]", "plant.low=[-1,-1]", "plant.high=[1,1]")
    assert wait(fork(["-m", "seed=1,2", *SMALL[1:], "system=tras", *box, "plant.rates=[Omega_a]"], tmp_path)) == 2
    lines = (tmp_path / "output").read_text().strip().splitlines()
    assert len(lines) == 1 and "null stands for the rate of an output that has none" in lines[0], lines
    assert not list(tmp_path.rglob("config.yaml")) and not list(tmp_path.rglob("error.txt"))


def test_a_sweep_in_which_tasks_differ_leaves_each_to_its_job(tmp_path):
    given = (
        "plant.outputs=[alpha_a,omega_a]",
        "plant.low=[-1,-1]",
        "plant.high=[1,1]",
        "plant.rates=[Omega_a],[Omega_p]",
    )
    assert wait(fork(["-m", "system=tras", *given], tmp_path)) == 2
    assert "error: 2 jobs failed" in (tmp_path / "output").read_text()


def workers(folder):
    """Return the processes that work below a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder) in str((process / "cwd").resolve()) and b"python" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.parametrize("how", CODES)
def test_an_ablation_that_is_stopped_leaves_no_workers_and_goes_on(tmp_path, how):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    words = (
        "experiment=smoke", *SMALL, "train.episodes=1", "setting=direct,rollouts_400", "planning.rollouts=10",
        "seed=1,2", "results=results", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2",
    )  # fmt: skip
    command = [sys.executable, str(ROOT / "scripts" / "ablation.py"), *words]
    child = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    while not (done := sorted(tmp_path.rglob("metrics.json"))) and child.poll() is None:
        time.sleep(0.1)
    child.send_signal(getattr(signal, how))
    _, error = child.communicate(timeout=60)
    assert child.returncode == CODES[how], error
    if how != "SIGKILL":
        *shown, last = error.splitlines()
        assert last.startswith("stopped; the finished jobs are kept in ")
        assert all(line.startswith("sweep: ") for line in shown)
    deadline = time.monotonic() + 30
    while workers(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not workers(tmp_path)
    before = done[0].stat().st_mtime_ns
    again = forked.run(command, cwd=tmp_path, timeout=600)
    assert again.returncode == 0, again.stderr
    assert done[0].stat().st_mtime_ns == before
    assert len(sorted((tmp_path / "runs").rglob("metrics.json"))) == 4
    assert (tmp_path / "results" / "ablation.md").is_file()


@pytest.mark.parametrize("size", [20_000, 100_000])
def test_a_full_disk_costs_one_line_and_no_good_checkpoint(tmp_path, size, whole):
    expected, _ = whole("dyna")
    command = [*EXPERIMENTS["dyna"], *SMALL, "hydra.run.dir=run"]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))  # as a full disk, larger files cannot be written
    try:
        pid = fork(command, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert wait(pid) == 2
    output = (tmp_path / "output").read_text()
    assert "Traceback" not in output
    assert re.search(r"error: .*checkpoints/.*File too large.*\n$", output), output
    assert wait(fork(["resume=run"], tmp_path)) == 0
    assert kept(tmp_path / "run") == expected


FICKLE = """
import os, signal
from pathlib import Path
from dynasindy.systems import Xi
class Fickle(Xi):
    def forward(self, x, u):
        if any(Path("run").glob("checkpoints/*.pt")) and not Path("stopped").exists():
            Path("stopped").touch()
            os.kill(os.getpid(), signal.SIGINT)
        return super().forward(x, u)
"""


def test_a_run_with_a_class_of_the_user_s_own_goes_on_by_the_command_that_is_printed(tmp_path, monkeypatch):
    (tmp_path / "fickle.py").write_text(FICKLE)
    monkeypatch.syspath_prepend(tmp_path)
    words = [*EXPERIMENTS["default"], *SMALL, "system._target_=fickle.Fickle", "hydra.run.dir=run"]
    assert wait(fork(words, tmp_path)) == 130, (tmp_path / "output").read_text()
    (command,) = re.findall(r"go on with (.*) \(with finish=true", (tmp_path / "output").read_text())
    python, script, *again = shlex.split(command)
    assert (python, script) == ("python", "scripts/train.py") and "plugins=[fickle]" in again
    assert wait(fork(again, tmp_path)) == 0, (tmp_path / "output").read_text()
    assert wait(fork([word for word in again if "plugins" not in word], tmp_path)) == 2


def test_a_signal_during_the_imports_costs_one_line(tmp_path):
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), "experiment=smoke"]
    child = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while "/torch/lib/" not in Path(f"/proc/{child.pid}/maps").read_text() and time.monotonic() < deadline:
        time.sleep(0.01)
    child.send_signal(signal.SIGINT)
    _, error = child.communicate(timeout=60)
    assert child.returncode == 130
    assert error in ("stopped\n", "stopped; nothing is kept, the same command begins anew\n")  # of torch, or before
    assert not any(tmp_path.iterdir())


@pytest.fixture(scope="module")
def log(tmp_path_factory, write_log):
    data = record_plant(Pendulum(), Multisine(1, duration=10, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    return write_log(tmp_path_factory.mktemp("log") / "log.csv", ["theta [rad]", "u"], data.x[:, :1], data.u)


def stopped_at(phase, log, tmp_path):
    """Stop a plan from a log as soon as it tells a phase; return its exit code and its last line."""
    words = ["data=csv", f"data.path={log}", "plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]
    words += ["plant.known={theta: rate}", "plant.library=[rate,u,'sin(theta)']", "planning.rollouts=8", "folder=run"]
    stopper = f"""
import os, runpy, signal, sys
sys.path.insert(0, {str(ROOT / "scripts")!r})
sys.argv = ["scripts/train.py", *{words!r}]
import command
from dynasindy import told
def stop(what):
    if what.phase.startswith({phase!r}):
        told._hearers.remove(stop)
        os.kill(os.getpid(), signal.SIGTERM)
told._hearers.append(stop)
runpy.run_path({str(ROOT / "scripts" / "train.py")!r}, run_name="__main__")
"""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", stopper]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stderr.strip().splitlines()[-1]


def test_a_plan_from_a_log_that_is_stopped_in_its_fit_keeps_nothing_and_says_so(log, tmp_path):
    code, line = stopped_at("fit", log, tmp_path)
    assert code == 143
    assert line == "stopped; the fit was not finished and nothing is kept in run; the same command begins anew"
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_a_plan_from_a_log_that_is_stopped_keeps_its_equations_and_goes_on_without_a_fit(log, tmp_path):
    code, line = stopped_at("planning", log, tmp_path)
    assert code == 143
    said, _, again = line.partition(" plan on them without a new fit: ")
    assert said == "stopped; the equations are kept in run/model.json, but no controller yet;"
    assert {"config.yaml", "model.json", "origin.json"} == {file.name for file in (tmp_path / "run").iterdir()}
    python, script, *words = shlex.split(again)
    assert (python, script) == ("python", "scripts/train.py")
    assert "plant.known={theta: rate}" in words and words[-1] == "model=run/model.json"
    words += ["planning.updates=1", "evaluation.must_control=false"]
    assert wait(fork(words, tmp_path)) == 0, (tmp_path / "output").read_text()
    assert "fit of" not in (tmp_path / "output").read_text()
    assert (tmp_path / "run" / "controller.json").is_file()


def test_a_run_goes_on_with_its_own_settings_only(tmp_path):
    assert wait(fork(["resume=nowhere"], tmp_path)) == 2
    assert "resume=nowhere is no run folder" in (tmp_path / "output").read_text()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("seed: 1\n")
    assert wait(fork(["resume=run", "system=xi"], tmp_path)) == 2
    assert "goes on with the run's own settings; leave out system=xi" in (tmp_path / "output").read_text()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["output", "run"]
