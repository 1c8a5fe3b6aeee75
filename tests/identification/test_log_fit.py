"""Candidates of a log's model are judged on data that their fits have not seen."""

import math
import warnings
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
import torch
from plants import scipy_motion
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete

from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.identification import log_fit as module
from dynasindy.identification.log_fit import HoldOut, fit_log
from dynasindy.identification.source import Source
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Pendulum, Signature
from dynasindy.systems.transitions import Transitions

AUTO = Refinement("auto", longest_delay=None)


def source_of(x, u, dt, names=("y",), units=("-",), share=0.0):
    """Return a log of samples `(N + 1, n)` and inputs `(N, m)`."""
    x, u = (torch.as_tensor(np.asarray(each), dtype=torch.float64).reshape(len(each), -1) for each in (x, u))
    signature = Signature(names, units, ("u",), tuple(x.abs().amax(0).tolist()))
    data = Transitions.from_trajectory(x, u, dt)
    early = torch.arange(len(data)) < (1 - share) * len(data)
    return Source(signature, data.select(early), data.select(~early), logged=True)


def steps(seed, count, length):
    return np.random.default_rng(seed).uniform(-1, 1, count).repeat(length)


def fitted(source, library="auto_rig", known=None, **settings):
    refinement = Refinement("auto", longest_delay=None, **settings)
    model = SindyModel(source.signature, library, Regression("bic", tolerance=1e-4), refinement, known=known)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit_log(model, source)


@pytest.fixture
def one_fold(monkeypatch):
    """Judge candidates on one part of a log alone, which takes a third of the time."""
    monkeypatch.setattr(module, "FOLDS", 1)


def coefficient(model, state, name):
    return float(model.coefficients[model.library.index(name), model.signature.state_index(state)])


@pytest.mark.parametrize("rows", [100_000, 300])
def test_exact_equations_end_the_search_at_once_and_a_long_log_is_fitted_in_stretches(rows, monkeypatch):
    monkeypatch.setattr(module, "FINAL_ROWS", rows)
    data = record_plant(Pendulum(), Multisine(1, duration=6, dt=0.05, amplitude=[0.6], seed=0).samples(0.01), 0.01)
    source = Source(Pendulum().signature, data, data.select(torch.zeros(len(data), dtype=torch.bool)), logged=True)
    words = ["1", "theta", "u", "Omega", "sin(theta)"]
    model = SindyModel(source.signature, words, Regression("bic"), AUTO, known={"theta": "Omega"})
    found = fit_log(model, source)
    findings = {each.code: each.values for each in found.report.findings}
    assert findings["fit.candidates"]["count"] == 1 and found.report.samples == (600 if rows > 600 else 294)
    assert findings.get("fit.fitted_to") == (None if rows > 600 else {"rows": 294, "total": 600, "stretches": 7})
    names = {"Omega": -0.5, "u": 12.0, "sin(theta)": -9.81}
    assert {n: coefficient(found.model, "Omega", n) for n in names} == pytest.approx(names, rel=1e-6)
    assert int((found.model.coefficients != 0).sum()) == 4


def oscillator(seed, rows, dt):
    """y'' = -100 y - 2 y' - 40 y^3 + 100 u, the input linear between samples, by SciPy; the rate is not measured."""
    u = np.random.default_rng(seed).normal(0, 0.5, rows + 1)
    time = dt * np.arange(rows + 1)

    def _rates(t, x):
        return x[1], -100 * x[0] - 2 * x[1] - 40 * x[0] ** 3 + 100 * np.interp(t, time, u)

    states = solve_ivp(_rates, (0, time[-1]), (0, 0), t_eval=time, max_step=dt / 2, rtol=1e-8, atol=1e-10).y
    return states[0], u[:-1]


@pytest.mark.usefixtures("one_fold")
def test_rate_hold_and_cubic_are_found_where_nobody_told_them(tmp_path):
    y, u = oscillator(0, 500, 0.05)
    source = source_of(y, u, 0.05, share=0.1)
    found = fitted(source)
    found.model.save(tmp_path / "model.json")
    model = SindyModel.load(tmp_path / "model.json")
    data = source.with_states_of(model)
    assert bool(data.training.linear_inputs.all()) and bool(data.validation.linear_inputs.all())
    assert torch.equal(data.training.u_end, found.source.training.u_end)
    assert model.signature.state_names == ("y", "y_rate")
    names = {"y": -100.0, "y_rate": -2.0, "y^3": -40.0, "u": 100.0}
    assert {name: coefficient(model, "y_rate", name) for name in names} == pytest.approx(names, rel=0.02)


@pytest.mark.usefixtures("one_fold")
def test_the_law_of_a_fan_is_found_where_nobody_named_it():
    """y'' = -9 sin(y) - y' + 20 u |u| of an angle alone, read with noise: thrust turns its sign with the input."""
    u, dt = steps(3, 100, 15), 0.02
    rates = lambda _, x, u: (x[1], -9 * np.sin(x[0]) - x[1] + 20 * u * abs(u))  # noqa: E731
    y = scipy_motion(rates, [0, 0], u, dt, 1e-8, 1e-6)[:, 0] + np.random.default_rng(4).normal(0, 0.002, len(u) + 1)
    model = fitted(source_of(y, u, dt, ("angle",), ("rad",))).model
    names = {"angle_rate": -1.0, "sin(angle)": -9.0, "u |u|": 20.0}
    assert {name: coefficient(model, "angle_rate", name) for name in names} == pytest.approx(names, rel=0.1)


@pytest.mark.usefixtures("one_fold")
def test_every_place_has_its_rate_where_one_lacks_it():
    """Two masses, a'' = -4 a + 3 u and b'' = -25 b + a, of which the places alone are measured."""
    u, dt = steps(5, 30, 12), 0.05
    rates = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-4, 0, -0.4, 0], [1, -25, 0, -1.0]])
    a, b, *_ = cont2discrete((rates, np.array([[0], [0], [3.0], [0]]), np.eye(4), 0), dt)
    x = [np.zeros(4)]
    for held in u:
        x.append(a @ x[-1] + b[:, 0] * held)
    y = np.stack(x)[:, :2] + np.random.default_rng(6).normal(0, 0.001, (len(x), 2))
    source, known = source_of(y, u, dt, ("a", "b"), ("m", "m")), {"b": "b_rate"}
    found = fitted(source.with_rates(known), known=known, seconds=2)
    assert set(found.model.signature.state_names) == {"a", "b", "a_rate", "b_rate"}
    assert source.with_states_of(found.model).signature.state_names == found.source.signature.state_names
    names = {("a_rate", "a"): -4.0, ("a_rate", "u"): 3.0, ("b_rate", "a"): 1.0, ("b_rate", "b"): -25.0}
    assert {key: coefficient(found.model, *key) for key in names} == pytest.approx(names, rel=0.1)


@pytest.mark.usefixtures("one_fold")
def test_what_pushes_the_plant_does_not_bias_its_equations():
    """x[k+1] = A x[k] + B u[k] + w[k] of y'' = -4 y - y' + 3 u with random pushes, y measured with noise."""
    dt, rng = 0.05, np.random.default_rng(1)
    u = steps(2, 80, 8)
    a, b, *_ = cont2discrete((np.array([[0, 1], [-4.0, -1]]), np.array([[0], [3.0]]), np.eye(2), 0), dt)
    x = [np.zeros(2)]
    for held in u:
        x.append(a @ x[-1] + b[:, 0] * held + rng.normal(0, [0.0, 0.02]))
    y = np.stack(x)[:, 0] + rng.normal(0, 0.005, len(x))
    model = fitted(source_of(y, u, dt)).model
    names = {"y": -4.0, "y_rate": -1.0, "u": 3.0}
    assert {name: coefficient(model, "y_rate", name) for name in names} == pytest.approx(names, rel=0.15)


@pytest.mark.usefixtures("one_fold")
def test_an_input_that_acts_late_and_through_a_lag_is_found():
    """a' = (u - a) / 0.5 s and y' = -y + 2 a, the input 0.12 s late."""
    dt, late = 0.04, 3
    u = steps(0, 40, 12)
    a, b, *_ = cont2discrete((np.array([[-1, 2.0], [0, -2]]), np.array([[0], [2.0]]), np.eye(2), 0), dt)
    x = [np.zeros(2)]
    for k in range(len(u)):
        x.append(a @ x[-1] + b[:, 0] * u[max(k - late, 0)])
    y = np.stack(x)[:, 0] + np.random.default_rng(1).normal(0, 0.003, len(x))
    model = fitted(source_of(y, u, dt), ["1", "y", "u"]).model
    ahead = 0.5 * dt * len(model.linear_inputs)  # of an input that moves evenly the steps come half a sample sooner
    assert model.followed == {"u_lagging": "u"} and model.delay == pytest.approx(late * dt + ahead, abs=dt / 4)
    rates = sorted([float(model.coefficients[-1, -1]), -coefficient(model, "y", "y")])
    assert rates == pytest.approx([1.0, 2.0], rel=0.1), "which of both is the lag no output tells"


@pytest.mark.usefixtures("one_fold")
def test_a_motor_that_acts_late_in_closed_loop_is_found():
    """r' = -7 a - r + 100 m of an angle a and its rate r, m' = (u - m) / 0.055 s, two samples late, kept at targets."""
    rng, dt, x, late, rows = np.random.default_rng(1), 0.01, np.zeros(3), [0.0] * 3, []
    targets, added = rng.uniform(-0.4, 0.4, 12).repeat(200), rng.choice([-0.1, 0.1], 480).repeat(5)
    for target, more in zip(targets, added, strict=True):
        y = x[:2] + rng.normal(0, [0.001, 0.006])
        rows.append((*y, 0.35 * (target - y[0]) - 0.09 * y[1] + more))
        late = [*late, rows[-1][2]][-3:]
        for _ in range(4):
            x = x + dt / 4 * np.array([x[1], -7 * x[0] - x[1] + 100 * x[2], (late[0] - x[2]) / 0.055])
    data = np.array(rows)
    source = source_of(data[:, :2], data[:-1, 2], dt, ("a", "r"), ("rad", "rad/s"))
    model = fitted(source, ["1", "a", "r", "u"], {"a": "r"}).model
    assert model.followed == {"u_lagging": "u"} and model.delay == pytest.approx(2 * dt, abs=dt / 4)
    assert coefficient(model, "u_lagging", "(u - u_lagging)") == pytest.approx(1 / 0.055, rel=0.05)
    names = {"a": -7.0, "r": -1.0, "u_lagging": 100.0}
    assert {name: coefficient(model, "r", name) for name in names} == pytest.approx(names, rel=0.05)


@pytest.mark.usefixtures("one_fold")
def test_two_days_whose_sensor_has_other_zeros_have_no_constant_in_their_equations():
    """y' = -y + 2 u, of which the sensor reads .1 more on one day and .1 less on another."""
    dt, rng = 0.05, np.random.default_rng(0)
    u, (a, b) = steps(0, 80, 15), (math.exp(-0.05), 2 - 2 * math.exp(-0.05))
    y = [0.0]
    for held in u:
        y.append(a * y[-1] + b * held)
    source = source_of(np.array(y) + rng.normal(0, 0.01, len(y)), u, dt)
    data, day = source.training, (torch.arange(len(u)) >= len(u) // 2).long()
    zero = 0.1 - 0.2 * day.unsqueeze(-1)
    days = replace(source, training=replace(data, x=data.x + zero, x_next=data.x_next + zero, segment=day))
    model = fitted(days, ["1", "y", "u"], seconds=5).model
    assert coefficient(model, "y", "1") == 0.0
    names = {"y": -1.0, "u": 2.0}
    assert {name: coefficient(model, "y", name) for name in names} == pytest.approx(names, rel=0.1)


def noisy_tank(rows=600, pushes=0.01):
    u, y, rng = steps(0, rows // 10, 10), [0.0], np.random.default_rng(0)
    for held in u:
        y.append(y[-1] * math.exp(-0.05) + (1 - math.exp(-0.05)) * held + rng.normal(0, pushes))
    return source_of(y + rng.normal(0, 0.02, rows + 1), u, 0.1)


def test_process_noise_is_found_of_an_oscillator_that_is_pushed_at_random(one_fold):
    u, rng, noises = steps(0, 60, 10), np.random.default_rng(0), []
    e = expm(0.05 * np.array([[0, 1, 0], [-9, -0.6, 9], [0, 0, 0]]))
    for push in (0.0, 1.0):
        x, y = np.zeros(2), [0.0]
        for held in u:
            x = e[:2, :2] @ x + e[:2, 2] * held + [0.0, push * math.sqrt(0.05) * rng.normal()]
            y.append(x[0])
        noises.append(fitted(source_of(y + rng.normal(0, 0.01, len(y)), u, 0.05), seconds=5.0).model.process_noise)
    assert noises[1] > 10 * noises[0]


def test_a_search_without_time_keeps_its_first_candidate():
    found = fitted(noisy_tank(), seconds=1e-9)
    codes = {each.code: each.values for each in found.report.findings}
    assert codes["fit.candidates"]["count"] == 1 and codes["fit.budget"]["stopped"] is False
    assert coefficient(found.model, "y", "u") == pytest.approx(0.5, rel=0.3)


def test_a_search_that_is_interrupted_keeps_the_best_candidate(monkeypatch):
    plain, count = module.HoldOut.errors, []

    def _errors(self, *given, **how):
        count.append(1)
        if len(count) == 6:
            raise KeyboardInterrupt
        return plain(self, *given, **how)

    monkeypatch.setattr(module.HoldOut, "errors", _errors)
    found = fitted(noisy_tank())
    codes = {each.code: each.values for each in found.report.findings}
    assert codes["fit.budget"]["stopped"] is True and bool(found.model.coefficients.any())


def test_what_was_chosen_by_hand_is_fitted_as_it_is():
    source = noisy_tank()
    for refinement in (None, Refinement("integral"), Refinement("trajectory", window=20)):
        model = SindyModel(source.signature, ["1", "y", "u"], Regression("bic"), refinement)
        found = fit_log(model, source)
        assert found.model is model and found.source is source and found.model.refinement == refinement
    simulated = Source(source.signature, source.training, source.validation)
    model = SindyModel(source.signature, ["1", "y", "u"], Regression("bic"), AUTO)
    assert fit_log(model, simulated).model is model


@pytest.mark.usefixtures("one_fold")
@pytest.mark.parametrize("method", ["integral", "one_step", "trajectory"])
def test_a_rate_that_a_log_lacks_is_added_whatever_fits_it_unless_it_is_said_to_have_none(method):
    """a'' = -6 a - a' + 4 u, 10 s of the place alone at 20 Hz; v' = -v + u has no rate that is a state."""
    u, dt, noise = steps(3, 20, 10), 0.05, np.random.default_rng(1).normal(0, 0.001, (201, 1))
    for rates, column, added in (([[0, 1], [-6, -1]], [[0], [4]], True), ([[-1]], [[1]], False)):
        n = len(rates)
        a, b, *_ = cont2discrete((np.array(rates), np.array(column), np.eye(n), 0), dt)
        x = [np.zeros(n)]
        for held in u:
            x.append(a @ x[-1] + b[:, 0] * held)
        source = source_of(np.stack(x)[:, :1] + noise, u, dt, ("a",))
        for known, names in ((None, ("a", "a_rate")[: 1 + added]), ({}, ("a",))):
            model = SindyModel(source.signature, "auto_rig", Regression("bic"), Refinement(method), known=known)
            assert fit_log(model, source).model.signature.state_names == names


def test_one_sample_in_four_tells_the_same_equation():
    """v' = -2 v + 3 u, exact at each sample, under inputs that jump every eighth one."""
    u, (a, b) = steps(3, 40, 8), (math.exp(-0.02), 1.5 * (1 - math.exp(-0.02)))
    v = list(accumulate(u, lambda last, held: a * last + b * held, initial=0.0))
    source = replace(source_of(v, u, 0.01, ("v",)), stride=4)
    model = SindyModel(source.signature, ["v", "u"], Regression("bic"), Refinement("one_step"))
    report = model.fit(source.fit_data(torch.ones(len(u), dtype=torch.bool)))
    assert report.samples == 80 and model.coefficients.flatten().tolist() == pytest.approx([-2, 3], rel=1e-6)


def test_candidates_are_judged_on_rows_that_none_was_fitted_to():
    source = noisy_tank(1200)
    folds = HoldOut.folds(source)
    assert len(folds) == module.FOLDS
    for fold in folds:
        assert len(fold.kept) == 300 and int(fold.early.sum()) == 900
        assert torch.equal(fold.kept.x, source.training.x[~fold.early])
    assert int(torch.stack([~fold.early for fold in folds]).sum(0).max()) == 1, "each row is kept once at most"
    long = noisy_tank(8000)
    assert len(HoldOut.folds(long)) == 1
    data = source.training
    days = replace(source, training=replace(data, segment=(torch.arange(len(data)) >= 500).long()))
    kept = [(~fold.early).nonzero().flatten() for fold in HoldOut.folds(days)]
    assert [(int(rows[0]), len(rows)) for rows in kept] == [(900, 300), (600, 300), (300, 300)]
    days = replace(source, training=replace(data, segment=(torch.arange(len(data)) // 400).long()))
    kept = [(~fold.early).nonzero().flatten() for fold in HoldOut.folds(days)]
    assert [(int(rows[0]), len(rows)) for rows in kept] == [(800, 400), (400, 400), (0, 400)]


def test_a_balanced_pole_is_judged_no_farther_ahead_than_it_can_be_predicted():
    rng, dt, noise = np.random.default_rng(0), 0.01, 1e-4
    x, last, rate, rows = np.zeros(2), 0.0, 0.0, []
    for push in np.repeat(rng.uniform(-0.6, 0.6, 250), 10):
        y = x[0] + noise * rng.normal()
        rate, last = 0.8 * rate + 0.2 * (y - last) / dt, y
        u = push - 3 * y - 0.4 * rate
        rows.append((y, u))
        for _ in range(10):
            x = x + dt / 10 * np.array([x[1], 30 * np.sin(x[0]) - 0.2 * x[1] + 20 * u])
    y, u = np.array(rows)[:, :1], np.array(rows)[:-1, 1:]
    # What a sensor does not resolve grows by exp(sqrt(30) t), until it is as large as what the pole does.
    blind = math.log(y.std() / noise) / math.sqrt(30)
    for fold in HoldOut.folds(source_of(y, u / abs(u).max(), dt, ("a",))):
        assert blind / 4 < fold.steps[-1] * dt < blind


def test_a_score_tells_how_far_errors_are_beyond_those_of_the_best_simple_model():
    fold = HoldOut.folds(noisy_tank(1200))[0]
    assert fold.score(fold.simple) == pytest.approx(0.0, abs=1e-12)
    assert fold.score(2 * fold.simple.maximum(fold.floor)) == pytest.approx((1 + module.BEHIND) * math.log(2))
    tiny = torch.zeros_like(fold.simple)
    assert fold.exact(tiny) and fold.score(tiny) <= 0
    assert math.isfinite(fold.score(torch.full_like(tiny, math.inf)))


def test_two_stores_whose_levels_are_read_need_roots_and_no_rates(one_fold):
    """a' = 0.6 u - 0.18 sqrt(a) and b' = 0.225 sqrt(a) - 0.2 sqrt(b), as of Torricelli, u from .2 to .8."""
    u, dt = 0.5 + 0.3 * steps(4, 25, 40), 1.0

    def slope(t, x, pump):
        a, b = np.sqrt(x)
        return [0.6 * pump - 0.18 * a, 0.225 * a - 0.2 * b]

    x = scipy_motion(slope, [2.8, 3.5], u, dt, 1e-8, 1e-6)
    noise = np.random.default_rng(2).normal(0, 0.02, x.shape)
    found = fitted(source_of(x + noise, u, dt, ("a", "b"), ("cm", "cm"))).model
    assert found.signature.state_names == ("a", "b")
    names = {("a", "u"): 0.6, ("a", "sqrt(a)"): -0.18, ("b", "sqrt(a)"): 0.225, ("b", "sqrt(b)"): -0.2}
    assert {key: coefficient(found, *key) for key in names} == pytest.approx(names, rel=0.03)


def test_equations_that_explode_under_inputs_that_were_seen_are_none(one_fold):
    """y' = 1.98 u - 2 sin(y) comes to rest at y = 1.43 where u = 1 lasts; the cubic that fits pulses of it to none."""
    u, dt, pushes = steps(4, 120, 10), 0.05, 0.08 * steps(5, 400, 3)
    x = scipy_motion(lambda t, x, u: [1.98 * u - 2 * np.sin(x[0])], [0.0], u + pushes, dt, 1e-8, 1e-10)
    assert np.abs(x).max() < 1
    x += np.random.default_rng(0).normal(0, 0.002, x.shape)
    found = fitted(source_of(x, u[:, None], dt), ["1", "y", "u", "y^3"]).model
    path = found.simulate(torch.zeros(1), torch.ones(len(u), 1), dt)
    assert float(path.abs().max()) < 2


def test_a_log_without_inputs_is_identified(one_fold):
    """a' = a - a b, b' = a b - b: hares and foxes (Lotka and Volterra), counted with errors."""
    rates = lambda t, x, u: [x[0] * (1 - x[1]), x[1] * (x[0] - 1)]  # noqa: E731
    x = scipy_motion(rates, [2.0, 1.0], np.zeros(600), 0.05, 1e-8, 1e-8)
    x += np.random.default_rng(0).normal(0, 0.01, x.shape)
    signature, no = Signature(("a", "b"), ("-", "-"), (), (2.0, 2.0)), torch.zeros(600, dtype=torch.bool)
    data = Transitions.from_trajectory(torch.from_numpy(x), torch.zeros(600, 0, dtype=torch.float64), 0.05)
    found = fitted(Source(signature, data, data.select(no), logged=True), ["1", "a", "b", "a b"]).model
    assert [coefficient(found, "a", "a b"), coefficient(found, "b", "a b")] == pytest.approx([-1, 1], abs=0.05)


@pytest.mark.slow
def test_the_inertia_that_an_angle_changes_is_found_among_those_of_all_angles(one_fold):
    """A rotary pendulum, driven at its arm: M(alpha) (theta'', alpha'') = torques, by Lagrange's equations."""
    arm, pole, coupling, weight, dt = 7.6e-4, 1.33e-4, 2e-4, 0.0152, 0.01
    swing = 1e-4  # by which the arm's inertia grows where the pole stands out, times sin(alpha)^2
    u = steps(3, 60, 25) * 6

    def slope(t, x, volts):
        _, alpha, omega, rate = x
        s, c = np.sin(alpha), np.cos(alpha)
        inertia = np.array([[arm + swing * s * s, coupling * c], [coupling * c, pole]])
        drive = 0.005 * volts - 7e-4 * omega
        left = drive - 2 * swing * s * c * omega * rate + coupling * s * rate**2
        right = swing * s * c * omega**2 - weight * s - 1e-5 * rate
        return [omega, rate, *np.linalg.solve(inertia, [left, right])]

    x = scipy_motion(slope, np.zeros(4), u, dt, 1e-8, 1e-10)
    angles = np.round(x[:, :2] / (2 * np.pi / 4096)) * (2 * np.pi / 4096)
    found = fitted(source_of(angles, u[:, None], dt, ("theta", "alpha"), ("rad", "rad"))).model
    # det M = (arm + swing) pole (1 + p cos(alpha)^2)
    p = -(swing * pole + coupling**2) / ((arm + swing) * pole)
    used = {f for k in found.coefficients.any(-1).nonzero() for f in found.library.features[int(k)].factors if f.fitted}
    (quotient,) = [f for f in used if f.function.startswith("per_cos2")]
    assert quotient.variables == ("alpha",)
    assert quotient.frequency == pytest.approx(p, rel=0.05)
