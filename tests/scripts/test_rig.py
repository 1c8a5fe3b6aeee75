"""The command that flies a rig finds mistakes before anything moves, and says how it was stopped."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import forked
import numpy as np
import pytest
import torch

from dynasindy.sindy import SindyModel

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def command(*words):
    return [sys.executable, str(ROOT / "scripts" / "rig.py"), "system=pendulum", *words]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("targets=[[1,2,3]]", "targets has [1, 2, 3]; give one number for each of theta"),
        ("targets=[[30.0]]", "within plant.low="),
        ("seconds=-1", "fly nothing; give seconds > 0"),
        ("seconds=null", "fly nothing; give seconds > 0"),
        ("flights=0", "fly nothing; give seconds > 0"),
        ("guard.late=-1", "give numbers >= 0"),
        ("guard.low={thta: -1}", "a guard has a range of 'thta', which is not measured; allowed are theta"),
        ("planner={update: 100}", "'update' is no setting of the planning; allowed are check_every, "),
    ],
)
def test_a_mistake_costs_one_line_and_nothing_moves(tmp_path, word, message):
    done = forked.run(command(word, f"folder={tmp_path}/run"), env=ENVIRONMENT)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.rglob("*.csv"))


def test_the_file_of_the_page_is_a_rig_that_only_a_connection_is_missing_of(tmp_path):
    page = (ROOT / "docs" / "rig.md").read_text()
    (block,) = re.findall(r"```yaml\n# my_rig/system/arm.yaml\n(.*?)```", page, re.S)
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text(block)
    words = ["--config-dir", str(tmp_path), "system=arm", f"folder={tmp_path}/run"]
    words = [sys.executable, str(ROOT / "scripts" / "rig.py"), *words]
    done = forked.run(words, env=ENVIRONMENT, timeout=200)
    assert done.returncode == 2
    assert done.stdout == "A flight goes on with angle within -1.5 to 1.5 rad\n"
    assert "nobody knows of this one; give rig=udp" in done.stderr


def test_a_slip_in_a_file_of_a_user_costs_one_line_with_its_place(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text("# @package _global_\nplant: {low: [0.1}\n")
    words = ["--config-dir", str(tmp_path), "system=arm", f"folder={tmp_path}/run"]
    done = forked.run([sys.executable, str(ROOT / "scripts" / "rig.py"), *words], env=ENVIRONMENT)
    assert done.returncode == 2 and "arm.yaml, line 2: expected ',' or ']', but got '}'; mend the file" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_plant_of_a_user_without_known_equations_is_rehearsed(tmp_path):
    (tmp_path / "conf" / "system").mkdir(parents=True)
    (tmp_path / "user_tank.py").write_text(
        "from dynasindy.systems import Signature, System\n\n\n"
        "class Tank(System):\n"
        "    def __init__(self):\n"
        "        super().__init__(Signature(('h',), ('m',), ('pump',), (1.0,)))\n\n"
        "    def forward(self, x, u):\n"
        "        return 0.2 * (1.0 + u) - 0.2 * x\n"
    )
    (tmp_path / "conf" / "system" / "tank.yaml").write_text(
        "# @package _global_\n"
        "system: {_target_: user_tank.Tank}\n"
        "plant: {outputs: [h], low: [0.2], high: [0.8], library: polynomial, amplitude: [0.5], offset: [0.0],\n"
        "  sensors: {h: {noise: 0.002}}}\n"
    )
    words = ["--config-dir", str(tmp_path / "conf"), "system=tank", "sensors=bench", f"folder={tmp_path}/run"]
    words += ["excitation.duration=10", "seconds=0.5", "planner={updates: 2}", "guard.late=50", "guard.lost=100"]
    environment = ENVIRONMENT | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    words = [sys.executable, str(ROOT / "scripts" / "rig.py"), *words]
    done = forked.run(words, env=environment, timeout=300)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    # What was identified is dh/dt = 0.2 + 0.2 pump - 0.2 h.
    model = SindyModel.load(str(tmp_path / "run" / "model.json"))
    rates = model(torch.tensor([[0.0], [1.0]], dtype=torch.float64), torch.tensor([[0.0], [0.5]], dtype=torch.float64))
    torch.testing.assert_close(rates, torch.tensor([[0.2], [0.1]], dtype=torch.float64), atol=0.02, rtol=0)


@pytest.mark.slow
def test_ctrl_c_says_that_the_rig_rests_and_where_its_logs_are(tmp_path):
    words = command(f"folder={tmp_path}/run", "guard.late=50")
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT) as flying:
        assert "No state has a range" in flying.stdout.readline()
        assert "excitation" in flying.stdout.readline()
        while not list(tmp_path.rglob("excitation.csv")):
            pass
        flying.send_signal(signal.SIGINT)
        _, said = flying.communicate(timeout=100)
    assert flying.returncode == 130
    assert "the rig was asked for its safe input, its logs are in" in said


@pytest.mark.slow
def test_a_rig_in_another_process_is_excited_identified_planned_for_flown_and_refined(tmp_path):
    """The pendulum behind its encoder, over UDP in real time: Omega' = 12 u - 9.81 sin(theta) - 0.5 Omega."""
    small = ["plant.amplitude=[0.25]", "planner={updates: 150}"]  # with more the pendulum goes over the top
    given = ["flights=2", "seconds=5", "targets=[[0.5],[-0.4]]", *small]
    patient = ["guard.late=20", "guard.lost=100"]  # other jobs may hold the cores; nothing here can be damaged
    words = command(f"folder={tmp_path}/run", "sensors=bench", *given, *patient)
    done = forked.run(words, env=ENVIRONMENT, timeout=1500)
    assert done.returncode == 0, done.stdout + done.stderr
    said = [line.split(":")[0] for line in done.stdout.splitlines() if not line.startswith(" ")]
    assert said[0].startswith("No state has a range that ends a flight")
    assert said[1:5] == ["excitation", "planning while the rig rests", "flight 1", "planning while the rig rests"]
    check, export, again = done.stdout.strip().splitlines()[-3:]
    assert "export.py run=" in export and "rig.py system=pendulum sensors=bench flights=2 seconds=5" in again
    words = [sys.executable, str(ROOT / "scripts" / "check.py"), *shlex.split(check, comments=True)[2:]]
    words += ["points=3", "draws=2", "grid=3", "seconds=5"]
    looked = forked.run(words, env=ENVIRONMENT, timeout=300)
    assert looked.returncode == 0, looked.stdout + looked.stderr
    files = [tmp_path / "run" / f"{name}.csv" for name in ("excitation", "flight_1", "flight_2")]
    # The encoder measures the angle alone.
    assert {file.read_text().splitlines()[0] for file in files} == {"time [s],theta [rad],u [-]"}
    drawn = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert drawn == {"excitation.png", "flight_1.png", "flight_2.png"}
    excited, first, second = (np.genfromtxt(file, delimiter=",", skip_header=1).T for file in files)
    for time, *_ in (excited, first, second):
        assert np.allclose(np.diff(time), 0.05)
    assert np.nanmax(excited[1]) - np.nanmin(excited[1]) > 0.2
    # While it planned, the rig swung freely at its safe input, and half its damping of 0.5/s takes a swing down. How
    # long that took is the machine's affair: it is told by when the logs were written last, and by their lengths.
    for last, now, before, after in zip((excited, first), (first, second), files, files[1:], strict=False):
        planned = after.stat().st_mtime - 0.05 * now.shape[1] - before.stat().st_mtime
        assert planned > 1.0
        assert abs(now[1, 0]) < 2 * np.nanmax(np.abs(last[1])) * np.exp(-0.25 * planned) + 0.005
    end = second[1].reshape(2, -1)[:, -20:]
    assert np.nanmean(np.abs(end - [[0.5], [-0.4]])) < 0.1
    model = SindyModel.load(tmp_path / "run" / "model.json")
    theta, omega, u = (torch.linspace(-1, 1, 9).double() * k for k in (0.6, 1.0, 0.5))
    found = model(torch.stack([theta, omega], -1), u.unsqueeze(-1))[:, 1]
    torch.testing.assert_close(found, 12 * u - 9.81 * theta.sin() - 0.5 * omega, atol=0.3, rtol=0.02)
