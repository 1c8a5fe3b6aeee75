"""Refinement goes beyond the trapezoidal rule, and chooses its criterion by what the errors look like."""

import math

import numpy as np
import pytest
import torch
from benchmarks.textbook_systems import CASES
from scipy.linalg import expm

from dynasindy.data.rollout_data import disturb
from dynasindy.sindy import SindyModel
from dynasindy.sindy import refinement as refine
from dynasindy.sindy.constraints import Constraints
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.one_step_fit import refine_one_step
from dynasindy.sindy.reconstruction import DelayedRecording, reconstruct
from dynasindy.sindy.refinement import METHODS, Refinement
from dynasindy.sindy.regression import Regression, RunningSums, integral_form, simpson_form
from dynasindy.sindy.shooting import Descent, RunsAway
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B = -2.0, 3.0
FREE = Constraints.build(LIBRARY, {}, {}, {})


def recording(dt: float, noise: float = 0.0, n: int = 150) -> Transitions:
    """Exact motion of y' = A y + B u under held inputs, with white noise on the states."""
    generator, phi, y = np.random.default_rng(3), math.exp(A * dt), [0.3]
    u = generator.uniform(-1, 1, n)
    for held in u:
        y.append(phi * y[-1] + B * (phi - 1) / A * held)
    x = torch.tensor(y, dtype=torch.float64) + noise * torch.from_numpy(generator.normal(size=n + 1))
    return Transitions.from_trajectory(x.unsqueeze(-1), torch.from_numpy(u).unsqueeze(-1), dt)


def first(data: Transitions) -> torch.Tensor:
    sums = RunningSums(4, 1)
    sums.add(integral_form(LIBRARY, data))
    return Regression("bic").solve(sums, FREE.free, FREE.offset)


def error(xi: torch.Tensor) -> float:
    return float((xi.flatten() - torch.tensor([A, B, 0, 0])).abs().max())


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(-1)


def test_each_method_is_nearer_to_the_plant_than_the_one_before():
    data = recording(0.05)
    start = first(data)
    once = Refinement("integral", rounds=1).run(LIBRARY, start, FREE, data)[1]
    twice = Refinement("integral", rounds=2).run(LIBRARY, start, FREE, data)[1]
    exact = Refinement("one_step", tolerance=1e-9).run(LIBRARY, start, FREE, data)[1]
    errors = [error(xi) for xi in (start, once, twice, exact)]
    assert errors[1] < 0.2 * errors[0] and errors[2] <= errors[1] and errors[3] < 0.1 * errors[2]
    assert errors[3] < 1e-7


def test_no_rounds_of_the_integral_form_change_nothing():
    data = recording(0.05)
    assert torch.equal(Refinement(rounds=0).run(LIBRARY, column(1, 2, 3, 4), FREE, data)[1], column(1, 2, 3, 4))


def test_what_is_given_stays_in_every_method():
    constraints = Constraints.build(LIBRARY, {}, {"y": ["y"]}, {"y": {"u": 2.9}})
    data = recording(0.02)
    for method in METHODS:
        found = Refinement(method, window=10).run(LIBRARY, column(A, 2.9, 0, 0), constraints, data)[1]
        assert found[1, 0] == 2.9 and found[2:].flatten().tolist() == [0, 0] and found[0, 0].item() != A


def test_auto_takes_trajectories_for_noise_and_single_steps_without():
    auto = Refinement("auto", rounds=0, window=10)
    noisy, clean, start = recording(0.02, 0.03), recording(0.02), column(-1.9, 2.8, 0, 0)
    smooth = reconstruct(noisy, {}, True).x
    assert not torch.equal(smooth, noisy.x)
    wanted = refine_trajectory(LIBRARY, start, FREE.free, noisy, Descent(10), smooth)[1]
    assert torch.equal(auto.run(LIBRARY, start, FREE, noisy)[1], wanted)
    wanted = refine_one_step(LIBRARY, start, FREE.free, clean, auto.tolerance)[1]
    assert torch.equal(auto.run(LIBRARY, start, FREE, clean)[1], wanted)


@pytest.mark.parametrize("longest", [0.0, 0.03])
def test_noisy_samples_are_smoothed_under_every_delay_that_is_tried(longest, monkeypatch):
    true, noisy, errors = recording(0.01, n=300).x[round(longest / 0.01) :], recording(0.01, 0.03, 300), []

    def kept(function):
        def called(library, xi, free, data, descent, start):
            errors.append(float((start - true).square().mean().sqrt()))
            return function(library, xi, free, data, descent, start)

        return called

    for name in ("refine_trajectory", "few_steps"):
        monkeypatch.setattr(refine, name, kept(getattr(refine, name)))
    refinement = Refinement("trajectory", window=10, longest_delay=longest)
    found = refinement.run(LIBRARY, column(A, B, 0, 0), FREE, noisy)
    assert len(errors) >= (5 if longest else 1) and max(errors) < 0.7 * 0.03
    assert error(found.coefficients) < 0.4 and found.delay == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize(
    "wrong", [{"method": "newton"}, {"rounds": -1}, {"tolerance": 0.0}, {"window": 0}, {"error": "both"}]
)
def test_settings_that_are_not_allowed_are_refused(wrong):
    with pytest.raises(ValueError, match="allowed") as refused:
        Refinement(**wrong)
    assert "\n" not in str(refused.value)


def test_each_round_is_a_simpson_regression_with_the_model_of_the_round_before():
    data, xi = recording(0.05), first(recording(0.05))
    for rounds in (1, 2):
        coefficients = xi
        for _ in range(rounds):
            theta, dx = simpson_form(LIBRARY, lambda x, u, c=coefficients: LIBRARY(x, u) @ c, data)
            sums = RunningSums(4, 1)
            sums.add((theta, dx))
            coefficients = Regression("bic", tolerance=1e-3).solve(sums, FREE.free, FREE.offset)
        found = Refinement("integral", rounds=rounds, tolerance=1e-3).run(LIBRARY, xi, FREE, data)[1]
        torch.testing.assert_close(found, coefficients, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_the_play_of_a_sensor_is_found_from_what_it_reads():
    n, dt, fine = 200, 0.1, 20
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, n // 10), 10)
    level, reading, seen = 0.0, 0.0, [0.0]
    for k in range(n):
        for _ in range(fine):  # by Euler's steps; the play as it is, without a rate
            level += dt / fine * (u[k] - 0.5 * level)
            reading = min(max(reading, level - 0.1), level + 0.1)
        seen.append(reading)
    y = torch.full((n + 1, 2), torch.nan, dtype=torch.float64)
    y[:, 1] = torch.tensor(seen)
    model = SindyModel(
        Signature(("level", "reading"), ("-", "-"), ("u",), (1.0, 1.0)),
        ["u", "level", "slack(level, reading; ~0.2)"],
        Regression("bic"),
        Refinement("trajectory", rounds=0),
        allowed={"level": ["level"], "reading": []},
        fixed={"level": {"u": 1.0}, "reading": {"slack(level, reading; 0.2)": 60.0}},
        initial={"level": {"level": -0.3}},
    )
    model.fit(Transitions.from_trajectory(y, torch.from_numpy(u)[:, None], dt))
    assert float(model.coefficients[1, 0]) == pytest.approx(-0.5, rel=0.05)
    assert model.library.shapes[0].frequency == pytest.approx(0.1, rel=0.1)


OSCILLATOR = Signature(("y", "w"), ("m", "m/s"), ("u",), (1.0, 1.0))
WORDS = Library(OSCILLATOR, [variable("y"), variable("w"), variable("u"), variable("y", 2)])


def oscillator(push: float, noise: float, hidden: bool, seed: int) -> Transitions:
    """Exact motion of y'' = -4 y - 0.8 y' + 3 u, a random push on y' in each sample, and noise of the sensors."""
    step = expm(0.05 * np.array([[0.0, 1.0, 0.0], [-4.0, -0.8, 3.0], [0.0, 0.0, 0.0]]))
    rng = np.random.default_rng(seed)
    u, x = rng.uniform(-1, 1, 60).repeat(10), [np.zeros(2)]
    for held in u:
        x.append((step @ [*x[-1], held])[:2] + np.array([0.0, push * rng.normal()]))
    seen = np.array(x) + noise * rng.normal(size=(601, 2))
    if hidden:
        seen[:, 1] = np.nan
    return Transitions.from_trajectory(torch.from_numpy(seen), torch.from_numpy(u)[:, None], 0.05)


def fitted(data: Transitions, **settings) -> tuple[SindyModel, str]:
    refinement = Refinement("trajectory", **settings)
    model = SindyModel(OSCILLATOR, WORDS, Regression("bic"), refinement, known={"y": "w"})
    return model, " ".join(model.fit(data).notes)


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize(("push", "noise", "chosen"), [(0.05, 0.01, "prediction"), (0.0, 0.05, "simulation")])
def test_a_plant_that_is_pushed_is_fitted_by_predictions_and_noise_of_sensors_by_simulation(
    push, noise, chosen, hidden
):
    data = oscillator(push, noise, hidden, 2)
    model, note = fitted(data, error="auto")
    assert f"error={chosen}" in note and ("pushes the plant" in note) == (chosen == "prediction")
    told, _ = fitted(data, error=chosen)
    assert torch.equal(model.coefficients, told.coefficients)
    assert model.coefficients[:3, 1].tolist() == pytest.approx([-4.0, -0.8, 3.0], rel=0.15 if push else 0.05)


def test_a_trajectory_that_no_function_or_no_number_survives_is_no_choice(monkeypatch):
    data, through = oscillator(0.0, 0.05, False, 2), refine.refine_trajectory

    def emptied(library, xi, free, data, descent, start):
        found = through(library, xi, free, data, descent, start)
        return found._replace(coefficients=torch.where(free, 0.0, found[1])) if descent.joined is None else found

    def lost(library, xi, free, data, descent, start):
        if descent.joined is None:
            raise RunsAway("it runs away")
        return through(library, xi, free, data, descent, start)

    told = fitted(data, error="prediction")[0].coefficients
    for spoilt, said in ((emptied, "leaves no function"), (lost, "runs away")):
        monkeypatch.setattr(refine, "refine_trajectory", spoilt)
        model, note = fitted(data, error="auto")
        assert torch.equal(model.coefficients, told) and "error=prediction" in note and said in note


def test_only_the_method_auto_chooses_the_error_unasked():
    data = oscillator(0.05, 0.01, True, 2)
    for settings, chosen in (({}, False), ({"error": "simulation"}, False), ({"error": "auto"}, True)):
        assert ("error=" in fitted(data, **settings)[1]) == chosen
    model = SindyModel(OSCILLATOR, WORDS, Regression("bic"), Refinement("auto"), known={"y": "w"})
    report = model.fit(data)
    assert "error=prediction" in " ".join(report.notes) and report.in_pieces
    report = model.fit(oscillator(0.0, 0.01, True, 2))  # nothing pushes it
    assert "error=simulation" in " ".join(report.notes) and not report.in_pieces


def test_a_long_delay_is_told_where_single_steps_are_mostly_noise():
    """A store of 40 s is read every second, 14 s late; its noise is three times what it moves in a second."""
    generator, phi, late, y = np.random.default_rng(0), math.exp(-1 / 40), 14, [0.0]
    u = np.repeat(generator.uniform(-1, 1, 60), 30)
    for k in range(len(u)):
        y.append(phi * y[-1] + (1 - phi) * u[max(k - late, 0)])
    moved = np.diff(y)
    x = np.array(y) + 3 * moved.std() * generator.normal(size=len(y))
    data = Transitions.from_trajectory(torch.from_numpy(x)[:, None], torch.from_numpy(u)[:, None], 1.0)
    found = Refinement("auto", longest_delay=None).run(LIBRARY, first(data), FREE, data)
    assert found.delay == pytest.approx(late, abs=1.0)
    assert found.coefficients[:2, 0].numpy() == pytest.approx([-1 / 40, 1 / 40], rel=0.1)


@pytest.mark.parametrize("method", ["auto", "trajectory"])
def test_functions_that_noise_hides_from_single_steps_are_found(method):
    """A fifth of each state is noise, beside which no function explains a single step of 20 ms."""
    case = CASES["van_der_pol"]
    data, library = disturb(case.clean(1)[0], 0.2, 1000), case.library()
    alone = Refinement("one_step").run(library, case.truth(), Constraints.build(library, {}, {}, {}), data)
    assert not alone.coefficients.any()
    model = SindyModel(library.signature, library, Regression("bic"), Refinement(method))
    model.fit(data)
    assert torch.equal(model.coefficients != 0, case.truth() != 0)
    torch.testing.assert_close(model.coefficients, case.truth(), rtol=0.05, atol=0.0)


@pytest.mark.parametrize(("push", "noise", "turns"), [(0.05, 0.01, [2, 4]), (0.0, 0.05, [4])])
def test_one_trajectory_is_not_fitted_again_and_again_through_what_is_pushed(push, noise, turns, monkeypatch):
    """The delay that is told changes each time, so that delay and equations are fitted in turn as often as may be.

    That is once before the first fit and three times after it; of one trajectory that strays, once after it.
    """
    told = {"trajectory": 0, "windows": 0}

    def restless(self, delay, found, free, recording, descent):
        told["trajectory" if descent.joined is None else "windows"] += 1
        return 0.0 if delay else 0.05

    monkeypatch.setattr(Refinement, "_fine", restless)
    note = fitted(oscillator(push, noise, False, 2), error="auto", longest_delay=0.1)[1]
    assert [count for count in told.values() if count] == turns and ("error=prediction" in note) == (push > 0)


def test_a_delay_of_the_first_estimate_is_looked_for_though_no_regression_tells_it():
    """A store of 0.5 s, 8 samples late, that moves within -1.5 and 1.5; the noise of its sensor is 0.8."""
    generator, dt, late, y = np.random.default_rng(0), 0.05, 8, [0.0]
    u, phi = np.repeat(generator.uniform(-1, 1, 30), 20), math.exp(A * dt)
    for k in range(len(u)):
        y.append(phi * y[-1] + B * (phi - 1) / A * u[max(k - late, 0)])
    x = np.array(y) + 0.8 * generator.normal(size=len(y))
    data = Transitions.from_trajectory(torch.from_numpy(x)[:, None], torch.from_numpy(u)[:, None], dt)
    refinement = Refinement("trajectory", longest_delay=None)
    assert refinement.run(LIBRARY, first(data), FREE, data).delay < 3 * dt  # two control periods are looked through
    found = refinement.run(LIBRARY, column(A, B, 0, 0), FREE, data, late=late * dt)
    assert found.delay == pytest.approx(late * dt, abs=dt)
    assert found.coefficients[:2, 0].tolist() == pytest.approx([A, B], rel=0.15)


def test_a_model_without_functions_tells_no_delay():
    data, none = recording(0.05), torch.zeros(4, 1, dtype=torch.float64)
    settings, whole = Refinement("trajectory", longest_delay=0.2), DelayedRecording.of(data, data, {}, 0.2)
    assert settings._fine(0.05, (LIBRARY, none), FREE.free, whole, Descent(20)) == 0.05


@pytest.mark.parametrize(
    ("error", "given", "lasting"),
    [
        ("simulation", None, False),
        ("simulation", True, True),
        ("prediction", None, True),
        ("prediction", False, False),
        ("coloured", None, False),
    ],
)
def test_errors_may_last_by_default_in_windows_that_begin_anew_only(monkeypatch, error, given, lasting):
    seen = []

    def _refine(library, xi, free, data, descent, start):
        seen.append(descent.correlated)
        return refine_trajectory(library, xi, free, data, descent, start)

    monkeypatch.setattr(refine, "refine_trajectory", _refine)
    data = recording(0.05, 0.01)
    SindyModel(
        SIGNATURE, ["y", "u"], Regression("bic"), Refinement("trajectory", rounds=0, error=error, correlated=given)
    ).fit(data)
    assert set(seen) == {lasting}
