"""Closed loops and excitations in one call, against SciPy's integrator, and what the package shows of itself."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

import dynasindy
from dynasindy.control import Controller
from dynasindy.envs import Aprbs, Channel, Multisine, Sensors
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum, Tras

POLICIES = Path(__file__).parents[1] / "docs" / "results" / "policies"


@pytest.fixture(scope="module")
def controller():
    return dynasindy.load(POLICIES / "tras")


@pytest.fixture(scope="module")
def simulation(controller):
    return dynasindy.simulate(controller, Tras(), {"alpha_a": [0.1, 0.3], "alpha_p": -0.2}, seconds=3)


def moved(plant, x, u, dt):
    """Return the state after a time under a held input, by SciPy."""
    held = torch.from_numpy(np.asarray(u, float))
    done = solve_ivp(lambda t, y: plant(torch.from_numpy(y), held).numpy(), (0, dt), x, rtol=1e-9, atol=1e-10)
    return done.y[:, -1]


def test_a_closed_loop_is_that_of_the_controller_and_another_integrator(controller, simulation):
    controller.reset()
    x, plant = np.zeros(6), Tras()
    for k in range(60):
        np.testing.assert_allclose(simulation.states[1, k], x, rtol=1e-4, atol=1e-4)
        u = controller.act(x, [0.3, -0.2])
        np.testing.assert_allclose(simulation.inputs[1, k], u, atol=1e-3)
        x = moved(plant, x, u, controller.dt)
    np.testing.assert_allclose(simulation.states[1, -1], x, rtol=1e-4, atol=1e-4)


def test_it_tells_times_targets_and_errors(simulation):
    assert simulation.states.shape == (2, 61, 6) and simulation.inputs.shape == (2, 60, 2)
    np.testing.assert_allclose(simulation.time, 0.05 * np.arange(61))
    np.testing.assert_allclose(simulation.targets, [[0.1, -0.2], [0.3, -0.2]], rtol=1e-6)
    np.testing.assert_array_equal(simulation.measurements, simulation.states[:, :-1])
    last = simulation.evaluation.steady_periods
    error = np.abs(simulation.states[:, -last - 1 : -1, :2] - simulation.targets[:, None]).mean(1)
    np.testing.assert_allclose(simulation.steady_error, error, rtol=1e-5)
    assert error.max() < 0.01


def test_it_plots_itself(simulation):
    axes = simulation.plot(run=1).axes
    for place in (0, 1):
        np.testing.assert_allclose(axes[place].lines[1].get_ydata(), simulation.states[1, :, place])
        np.testing.assert_allclose(axes[place].lines[0].get_ydata(), simulation.targets[1, place])
    assert simulation._repr_png_().startswith(b"\x89PNG")


def test_targets_by_name_or_in_order_and_a_start(controller):
    ways = (
        {"alpha_p": 0.1, "alpha_a": 0.2},
        {"alpha_p": np.array([0.1]), "alpha_a": torch.tensor(0.2, dtype=torch.float64)},
        [0.2, 0.1],
        [[0.2, 0.1]],
        np.array([0.2, 0.1]),
        torch.tensor([[0.2, 0.1]], dtype=torch.float64),
    )
    found = [dynasindy.simulate(controller, Tras(), way, 1, {"alpha_a": 0.4}).states for way in ways]
    assert found[0][0, 0].tolist() == pytest.approx([0.4, 0, 0, 0, 0, 0])
    assert np.ptp(found, 0).max() == 0


@pytest.mark.parametrize(
    "targets",
    [
        {"alpha_a": 0.1},
        {"alpha_a": 0, "alpha": 1},
        [0.1],
        [[0.1, np.nan]],
        np.array([0.1]),
        object(),
        {"alpha_a": [0.1, 0.2], "alpha_p": [0.1, 0.2, 0.3]},
    ],
)
def test_targets_that_are_none_are_refused(controller, targets):
    with pytest.raises(ValueError, match="alpha_p"):
        dynasindy.simulate(controller, Tras(), targets)
    with pytest.raises(ValueError, match="theta"):
        dynasindy.simulate(controller, Pendulum(), [0.1, 0.1])


@pytest.fixture(scope="module")
def log():
    return dynasindy.excite(Pendulum(), 4.0, 0.8, seed=3)


def test_an_excitation_is_the_signal_held_on_the_plant(log):
    signal = Multisine(1, duration=4.0, dt=0.05, amplitude=0.8, seed=3).samples(0.01)
    torch.testing.assert_close(log.training.u, signal)
    x = np.zeros(2)
    for k, u in enumerate(signal):
        np.testing.assert_allclose(log.training.x[k], x, rtol=1e-5, atol=1e-6)
        x = moved(Pendulum(), x, u, 0.01)
    assert len(log.validation) == 2000


@pytest.mark.parametrize(("wrong", "near"), [("nois", "noise"), ("harmonic", "harmonics"), ("durations", "duration")])
def test_a_misspelt_setting_of_an_excitation_or_its_signal_is_told_the_nearest(wrong, near):
    with pytest.raises(ValueError, match=f"excite has {wrong}=3; .*did you mean '{near}'"):
        dynasindy.excite(Pendulum(), **{wrong: 3})


def test_an_excitation_takes_another_signal_and_sensors():
    plain = dynasindy.excite(Pendulum(), 2.0, np.array([0.5]), np.zeros(1), dt=0.05, signal=Aprbs)
    seen = dynasindy.excite(Pendulum(), 2.0, dt=0.05, signal=Aprbs, sensors=Sensors({"theta": Channel(noise=0.01)}))
    torch.testing.assert_close(plain.training.u, Aprbs(1, duration=2.0, dt=0.25, amplitude=0.5).samples(0.05))
    assert seen.training.x[:, 1].isnan().all() and not plain.training.x.isnan().any()
    assert 0.005 < float((seen.training.x - plain.training.x)[:, 0].std()) < 0.02


def test_from_an_excitation_to_a_closed_loop_behind_sensors(log, controller):
    model = dynasindy.identify(log)
    assert str(model).splitlines() == model.equations() and len(repr(model).splitlines()) == 1
    np.testing.assert_allclose(model(torch.tensor([0.3, 0.1]), torch.tensor([0.2])), [0.1, -0.549], atol=5e-3)
    with pytest.raises(ValueError, match=r"theta, Omega and 1 .*alpha_a, alpha_p"):
        dynasindy.forecast(controller, model, log)
    controller = dynasindy.plan(model, {"theta": (-0.5, 0.5)}, updates=40)
    on_model, on_plant = (dynasindy.simulate(controller, each, {"theta": 0.3}, 5) for each in (model, Pendulum()))
    np.testing.assert_allclose(on_model.states, on_plant.states, atol=1e-3)
    sensors = Sensors({"theta": Channel(resolution=0.001)}, rates={"theta": "Omega"})
    seen = dynasindy.plan(model, {"theta": (-0.5, 0.5)}, log=log, sensors=sensors, updates=40)
    first, again = (dynasindy.simulate(seen, Pendulum(), {"theta": 0.3}, 5) for _ in range(2))
    np.testing.assert_array_equal(first.states, again.states)
    assert np.isnan(first.measurements[..., 1]).all() and np.ptp(first.measurements[..., 0] / 0.001 % 1) < 1e-3
    seen.reset()
    for k in range(20):
        np.testing.assert_allclose(seen.act(first.measurements[0, k], [0.3]), first.inputs[0, k], atol=1e-4)


def test_the_package_lists_its_public_names_and_everything_says_what_it_is(controller, simulation, log):
    assert dir(dynasindy) == sorted(dynasindy.__all__)
    assert isinstance(controller, Controller) and callable(dynasindy.simulate)
    model = SindyModel(Pendulum().signature, ["1", "u"])
    for thing in (controller, simulation, log, model, Pendulum(), Tras(), dynasindy.Progress()):
        assert repr(thing).startswith((type(thing).__name__, "Data")) and " at 0x" not in repr(thing)
