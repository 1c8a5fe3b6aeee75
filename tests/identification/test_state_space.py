"""Linear models with hidden states, of plants that SciPy moves exactly."""

import numpy as np
import pytest
import torch
from plants import scipy_motion
from scipy.signal import cont2discrete, dlsim

from dynasindy.identification.state_space import (
    chain_candidates,
    state_space_candidates,
    with_disturbance,
)
from dynasindy.sindy import Refinement, SindyModel
from dynasindy.sindy.reconstruction import disturbance_states
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from tests.identification.test_log_fit import fitted, one_fold, source_of, steps  # noqa: F401

DT = 0.01
SOFT_SHAFT = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-600, 600, -2, 0], [400, -440, 0, -1.0]])
"""Angles of two inertias and their rates: a soft shaft between them, a spring at the far end."""
DRIVE = np.array([[0.0], [0.0], [20.0], [0.0]])
ANGLE, ACCELERATION = np.eye(4)[:1], SOFT_SHAFT[2:3]


def measured(reads, direct, u, method):
    """Return what a sensor shows under inputs that are held or move evenly, with some noise."""
    *matrices, dt = cont2discrete((SOFT_SHAFT, DRIVE, reads, np.array([[direct]])), DT, method)
    y = dlsim((*matrices, dt), u)[1]
    return y + 1e-3 * y.std() * np.random.default_rng(1).standard_normal(y.shape)


def smooth(count):
    noise = np.random.default_rng(0).standard_normal(count + 7)
    return np.convolve(noise, np.hanning(8) / 2, "valid")


def poles(model):
    """Return the eigenvalues of the linear part of a model, whose first functions are one and its states."""
    names, xi = model.library.names, model.coefficients
    rows = [names.index(name) for name in model.signature.state_names]
    return np.linalg.eigvals(xi[rows].numpy().T)


def distance(found, real):
    """Return how far the nearest of some poles is from each real one, in parts of that."""
    return max(np.abs(found - pole).min() / abs(pole) for pole in real)


def test_a_candidate_begins_at_the_poles_of_a_soft_shaft_of_which_one_angle_is_measured():
    u = steps(0, 300, 10)
    y = torch.from_numpy(measured(ANGLE, 0.0, u, "zoh"))
    data = Transitions.from_trajectory(y, torch.from_numpy(u[:-1, None]), DT)
    plant = SindyModel(Signature(("angle",), ("rad",), ("u",), (1.0,)), ["1", "angle", "u"])
    sizes = list(state_space_candidates(plant, data))
    for model in sizes[2]:
        model.set_coefficients(torch.where(model.constraints.free, model.initial, model.constraints.offset))
    assert min(distance(poles(model), np.linalg.eigvals(SOFT_SHAFT)) for model in sizes[2]) < 0.05


def test_a_rate_that_a_user_named_stays_the_rate_where_the_far_end_is_hidden():
    u = steps(0, 300, 10)
    y = torch.from_numpy(np.pad(measured(ANGLE, 0.0, u, "zoh"), ((0, 0), (0, 1)), constant_values=np.nan))
    data = Transitions.from_trajectory(y, torch.from_numpy(u[:-1, None]), DT)
    signature = Signature(("angle", "speed"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
    motor = SindyModel(signature, ["1", "angle", "speed", "u"], known={"angle": "speed"})
    found = list(chain_candidates(motor, data, "angle", signature.state_names))[2]
    for model in found:
        model.set_coefficients(torch.where(model.constraints.free, model.initial, model.constraints.offset))
        assert model.equations()[0] == "angle' = speed"
    names = ("angle", "speed", "hidden_2", "hidden_3")
    assert all(model.signature.state_names == names and not model.constraints.free[:, 0].any() for model in found)
    assert min(distance(poles(model), np.linalg.eigvals(SOFT_SHAFT)) for model in found) < 0.05
    known = Transitions.from_trajectory(y.nan_to_num(0.5), torch.from_numpy(u[:-1, None]), DT)
    assert not list(chain_candidates(motor, known, "angle", signature.state_names))  # nothing is sought of a place


@pytest.mark.parametrize("blind", [0, 1])
@pytest.mark.parametrize("count", [30, 300])
def test_short_recordings_and_inputs_that_stand_still_are_no_error(count, blind):
    u = np.stack([steps(0, count // 10, 10), np.zeros(count)], -1)[:, : 1 + blind]
    y = torch.from_numpy(measured(ANGLE, 0.0, u[:, 0], "zoh"))
    data = Transitions.from_trajectory(y, torch.from_numpy(u[:-1]), DT)
    names = ("u", "still")[: 1 + blind]
    sizes = list(state_space_candidates(SindyModel(Signature(("y",), ("m",), names, (1.0,)), ["1", "y", "u"]), data))
    assert bool(sizes[2]) == (count == 300)


def test_a_place_behind_a_late_sensor_gets_hidden_states_beside_a_motor_with_friction():
    u = steps(0, 200, 10)
    behind = np.array([[-20.0, 20.0, 0.0], [0.0, 0.0, 1.0], [0.0, -100.0, -2.0]])  # sensor, place, its speed

    def moves(now, x, force):
        return [3 * force - 2 * x[0] - np.tanh(10 * x[0]), *behind @ x[1:] + [0.0, 0.0, 50 * x[0]]]

    x = scipy_motion(moves, np.zeros(4), u[:-1], DT, atol=1e-10)
    seen = torch.from_numpy(x[:, :2] + 1e-4 * np.random.default_rng(0).standard_normal((len(x), 2)))
    signature = Signature(("speed", "place"), ("rad/s", "m"), ("force",), (1.0, 1.0))
    motor = SindyModel(signature, ["speed", "force", "tanh(10 speed)", "place"])
    motor.set_coefficients(torch.tensor([[-2.0, 0.0], [3.0, 0.0], [-1.0, 0.0], [0.0, -1.0]], dtype=torch.float64))
    data = Transitions.from_trajectory(seen, torch.from_numpy(u[:-1, None]), DT)
    found = list(chain_candidates(motor, data, "place"))[1]
    for model in found:
        assert model.signature.state_names == ("speed", "place", "hidden_1", "hidden_2")
        model.set_coefficients(torch.where(model.constraints.free, model.initial, model.constraints.offset))
        equation = dict(zip(model.library.names, model.coefficients[:, 0].tolist(), strict=True))
        assert (equation["force"], equation["tanh(10 speed)"], equation["place"]) == (3.0, -1.0, 0.0)
    chains = [
        model.coefficients[[model.library.names.index(n) for n in model.signature.state_names[1:]], 1:]
        for model in found
    ]
    assert min(distance(np.linalg.eigvals(chain.T.numpy()), np.linalg.eigvals(behind)) for chain in chains) < 0.1


def pushed_oscillator():
    """Return places of an oscillator and held inputs; it is pushed by what fades within half a second."""
    a, b = np.array([[0.0, 1.0, 0.0], [-4.0, -0.4, 1.0], [0.0, 0.0, -2.0]]), np.array([[0.0], [3.0], [0.0]])
    a, b, *_ = cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), 0.05)
    random, u, x = np.random.default_rng(1), steps(0, 100, 20), [np.zeros(3)]
    for held in u:
        x.append(a @ x[-1] + b[:, 0] * held + [0, 0, 0.45 * random.standard_normal()])
    return np.array(x)[:, :1] + 1e-3 * random.standard_normal((len(x), 1)), u


def test_a_push_that_fades_is_told_by_the_equations_of_what_it_pushes():
    y, u = pushed_oscillator()
    seen = torch.from_numpy(np.concatenate([y, np.full((len(y), 2), np.nan)], 1))
    data = Transitions.from_trajectory(seen, torch.from_numpy(u[:, None]), 0.05)
    plant = SindyModel(Signature(("y", "v"), ("m", "m/s"), ("u",), (2.0, 4.0)), ["y", "v", "u"], known={"y": "v"})
    plant.set_coefficients(torch.tensor([[0.0, -3.0], [1.0, -0.8], [0.0, 2.0]], dtype=torch.float64))
    model = with_disturbance(plant, "u", 5.0)
    model.refinement = Refinement("trajectory", error="innovation", rounds=0, select=False, longest_delay=0.0)
    model.fit(data)
    assert model.signature.state_names[2] == "u_disturbance" and disturbance_states(
        model.library, model.coefficients
    ) == [2]
    assert -1 / float(model.coefficients[:, 2].sum()) == pytest.approx(0.5, rel=0.2)
    acceleration = dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True))
    assert [acceleration[name] for name in ("y", "v", "u")] == pytest.approx([-4.0, -0.4, 3.0], rel=0.1)


@pytest.mark.slow
def test_a_push_that_fades_is_found_by_default(one_fold):  # noqa: F811
    y, u = pushed_oscillator()
    found = fitted(source_of(y, u, 0.05, units=("m",)), seconds=60.0)
    (push,) = [each.values for each in found.report.findings if each.code == "fit.disturbance"]
    assert push["seconds"] == pytest.approx(0.5, rel=0.2)


@pytest.mark.slow
def test_the_far_end_of_a_soft_shaft_is_found_by_its_motor_alone(one_fold):  # noqa: F811
    u = steps(0, 150, 10)
    found = fitted(source_of(measured(ANGLE, 0.0, u, "zoh"), u[:-1], DT, units=("rad",)), seconds=40.0)
    assert distance(poles(found.model), np.linalg.eigvals(SOFT_SHAFT)) < 0.03
    assert "fit.behind" not in {finding.code for finding in found.report.findings}


@pytest.mark.slow
def test_dry_friction_of_a_motor_is_found_beside_the_hidden_far_end_of_its_shaft(one_fold):  # noqa: F811
    u = 2 * steps(0, 150, 10)

    def moves(now, x, force):
        return [*SOFT_SHAFT @ x + DRIVE[:, 0] * force - [0, 0, 4 * np.tanh(20 * x[2]), 0]]

    y = scipy_motion(moves, np.zeros(4), u[:-1], DT, rtol=1e-6, atol=1e-8)[:, :1]
    y += 1e-3 * y.std() * np.random.default_rng(1).standard_normal(y.shape)
    model = fitted(source_of(y, u[:-1], DT, units=("rad",)), seconds=60.0).model
    assert model.signature.state_units[:3] == ("rad", "rad/s", "rad/s^2")
    acceleration = zip(model.library.features, model.coefficients[:, 1].tolist(), strict=True)
    (friction,) = [
        c for f, c in acceleration if c and [(a.function, *a.variables) for a in f.factors] == [("tanh", "hidden_1")]
    ]
    assert friction == pytest.approx(-4.0, rel=0.1)


def test_nothing_hidden_is_added_where_nothing_is_to_be_known(one_fold):  # noqa: F811
    u = steps(0, 60, 10)
    found = fitted(source_of(measured(ANGLE, 0.0, u, "zoh"), u[:-1], DT, units=("rad",)), known={}, seconds=5.0)
    assert found.model.signature.state_names == ("y",)


@pytest.mark.slow
def test_an_acceleration_shows_its_force_at_once(one_fold):  # noqa: F811
    u = smooth(1500)
    found = fitted(source_of(measured(ACCELERATION, 20.0, u, "foh"), u[:-1], DT, units=("m/s^2",)), seconds=15.0)
    model = found.model
    place = model.library.names.index("(u - u_lagging)")
    rate = float(model.coefficients[place, model.signature.state_index("u_lagging")])
    assert float(model.coefficients[place, 0]) / rate == pytest.approx(20.0, rel=0.1)
