"""From a log to a controller to a C file, by commands and by the library, and closed loops of both compared."""

import ctypes
import json
import math
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from plants import pendulum_rates, scipy_motion

import dynasindy
from dynasindy.control import save
from dynasindy.workbench import tracking_task

CC = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
WRAP = """
#include "controller.h"
static controller_state state;
void reset(void) { controller_reset(&state); }
int act(const double *y, const double *r, const double *rate, double *u)
{ return controller_act(&state, y, r, rate, u); }
"""


def compiled(folder):
    """Compile the files that the command wrote, as another program would, and return what calls them."""
    (folder / "wrap.c").write_text(WRAP)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-shared", "-fPIC"]
    subprocess.run([CC, *flags, "wrap.c", "controller.c", "-lm", "-o", "c.so"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "c.so"))

    def act(y, r):
        u = (ctypes.c_double * 1)()
        code = library.act((ctypes.c_double * 2)(*y), (ctypes.c_double * 1)(*r), None, u)
        assert code == 0
        return np.array(u)

    library.reset()
    act.reset = library.reset
    return act


def flight(act, seconds=8.0, dt=0.05):
    """Angles and inputs of a pendulum that is to be held at 0.4 rad, then at -0.3 rad; some samples are lost."""
    rng, x, found = np.random.default_rng(0), np.zeros(2), []
    for k in range(round(seconds / dt)):
        y = np.array([math.nan, math.nan]) if k % 17 == 5 else x + [0.0, 1e-3] * rng.standard_normal(2)
        u = float(act(y, [0.4 if k * dt < seconds / 2 else -0.3])[0])
        found.append((x[0], u))
        x = scipy_motion(pendulum_rates, x, [u], dt)[-1]
    return np.array(found).T


def test_the_command_finds_the_equations_and_plans_a_controller_that_holds_the_plant(planned):
    metrics = json.loads((planned / "metrics.json").read_text())
    model = json.loads((planned / "model.json").read_text())["coefficients"]["Omega"]
    assert {name: value for name, value in model.items() if value} == pytest.approx(
        {"u": 12.0, "Omega": -0.5, "sin(theta)": -9.81}, rel=0.02
    )
    assert metrics["prediction"]["promised"] and metrics["prediction"]["models"] == 3
    controller = dynasindy.load(planned)
    angle, u = flight(controller.act, dt=controller.dt)
    n = len(angle)
    assert np.abs(angle[3 * n // 8 : n // 2] - 0.4).max() < 0.03 and np.abs(angle[7 * n // 8 :] + 0.3).max() < 0.03
    assert np.abs(u).max() <= 1 and controller.observer is not None


@pytest.mark.skipif(CC is None, reason="there is no C compiler on this computer")
def test_the_c_file_flies_the_plant_as_python_does(command, planned, tmp_path):
    """Each in a closed loop of its own, so that any difference would grow."""
    done = command("export", f"run={planned}", "formats=[c]", f"folder={tmp_path}/c", cwd=tmp_path)
    assert done.code == 0, done
    assert sorted(file.name for file in (tmp_path / "c").iterdir()) == ["controller.c", "controller.h"]
    controller, act = dynasindy.load(planned), compiled(tmp_path / "c")
    expected = flight(controller.act, dt=controller.dt)
    for _ in range(2):  # a reset forgets the flight before
        act.reset()
        np.testing.assert_allclose(flight(act, dt=controller.dt), expected, atol=1e-5)
    assert expected[1].std() > 0.05


def test_the_library_does_what_the_command_does(log, tmp_path):
    """And does it twice alike; what is saved is what is loaded."""
    read = dynasindy.read(log)
    words = ["1", "u", "theta", "Omega", "sin(theta)", "Omega^2"]
    model = dynasindy.identify(read, words, {"theta": "Omega"}, "trajectory", longest_delay=0.0)
    found = dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True))
    assert {name: value for name, value in found.items() if value} == pytest.approx(
        {"u": 12.0, "Omega": -0.5, "sin(theta)": -9.81}, rel=0.02
    )
    task, settings = tracking_task(model, {"theta": (-0.6, 0.6)}), {"updates": 40, "rollouts": 16, "window": 30}
    task.max_steps = 80
    controllers = [dynasindy.plan(model, task, read, seed=3, **settings) for _ in range(2)]
    save(controllers[0], tmp_path / "controller.json")
    flights = [flight(each.act) for each in (*controllers, dynasindy.load(tmp_path))]
    assert np.array_equal(flights[0], flights[1]) and np.array_equal(flights[0], flights[2])
    assert np.abs(flights[0][0][-20:] + 0.3).max() < 0.03
    forecast = dynasindy.forecast(controllers[0], model, read, within=0.05)
    assert forecast.controlled and forecast.promised and not replace(forecast, within=1e-9).controlled


@pytest.mark.parametrize(("within", "code"), [("0.9", 0), ("1e-9", 1)])
def test_a_plan_on_a_model_alone_is_judged_by_its_exit_code(command, planned, tmp_path, within, code):
    words = ("plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]", "planning.updates=2")
    words += ("planning.rollouts=8", "planning.window=10", "scenario.reference.number=4", "scenario.episodes=4")
    words += ("task.max_steps=80",)
    model = f"model={planned / 'model.json'}"
    done = command("train", model, *words, f"evaluation.within={within}", "folder=run", cwd=tmp_path)
    assert done.code == code, done
    found = json.loads((tmp_path / "run" / "metrics.json").read_text())["prediction"]
    assert (found["controlled"], found["promised"]) == (code == 0, False)
    assert (tmp_path / "run" / "controller.json").is_file()
