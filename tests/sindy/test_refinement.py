"""Refinement beyond the trapezoidal rule: single steps as in the exact discrete form, a criterion by the errors."""

import math

import numpy as np
import pytest
import torch
from benchmarks.identify import TEXTBOOK
from first_order import LIBRARY, A, B, column, motion
from plants import held_motion
from scipy.linalg import expm
from scipy.optimize import least_squares

from dynasindy.sindy import Library, Refinement, Regression, SindyModel, shooting
from dynasindy.sindy.library import Constraints, variable
from dynasindy.sindy.reconstruction import RegressionData
from dynasindy.sindy.refinement import looks_noisy
from dynasindy.sindy.regression import TriangularFactor, integral_form
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

FREE = Constraints.build(LIBRARY, {}, {}, {})


def recording(dt: float, noise: float = 0.0, n: int = 150) -> Transitions:
    """Exact motion of y' = A y + B u under held inputs, with white noise on the states."""
    generator = np.random.default_rng(3)
    u = generator.uniform(-1, 1, n)
    x = torch.from_numpy(motion(A, B, 0.3, u, dt) + noise * generator.normal(size=n + 1))
    return Transitions.from_trajectory(x.unsqueeze(-1), torch.from_numpy(u).unsqueeze(-1), dt)


def first(data: Transitions) -> torch.Tensor:
    return Regression("bic").solve(TriangularFactor(integral_form(LIBRARY, data)), FREE.free, FREE.offset)


def error(xi: torch.Tensor) -> float:
    return float((xi.flatten() - torch.tensor([A, B, 0, 0])).abs().max())


def test_each_method_is_nearer_to_the_plant_than_the_one_before():
    data = recording(0.05)
    start = first(data)
    once = Refinement("integral", rounds=1).run((LIBRARY, start), FREE, RegressionData.of(data, {}))[1]
    twice = Refinement("integral", rounds=2).run((LIBRARY, start), FREE, RegressionData.of(data, {}))[1]
    exact = Refinement("one_step", tolerance=1e-9).run((LIBRARY, start), FREE, RegressionData.of(data, {}))[1]
    errors = [error(xi) for xi in (start, once, twice, exact)]
    assert errors[1] < 0.2 * errors[0] and errors[2] <= errors[1] and errors[3] < 0.1 * errors[2]
    assert errors[3] < 1e-7


def test_what_is_given_stays_in_every_method():
    constraints = Constraints.build(LIBRARY, {}, {"y": ["y"]}, {"y": {"u": 2.9}})
    data = recording(0.02)
    for method in ("integral", "one_step", "trajectory", "auto"):
        found = Refinement(method, window=10).run(
            (LIBRARY, column(A, 2.9, 0, 0)), constraints, RegressionData.of(data, {})
        )[1]
        assert found[1, 0] == 2.9 and found[2:].flatten().tolist() == [0, 0] and found[0, 0].item() != A


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


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize(("push", "noise", "error"), [(0.05, 0.01, "prediction"), (0.0, 0.05, "simulation")])
def test_a_pushed_plant_is_fitted_by_predictions_and_noise_of_sensors_by_simulation(push, noise, error, hidden):
    refinement = Refinement("trajectory", error=error)
    model = SindyModel(OSCILLATOR, WORDS, Regression("bic"), refinement, known={"y": "w"})
    model.fit(oscillator(push, noise, hidden, 2))
    assert model.coefficients[:3, 1].tolist() == pytest.approx([-4.0, -0.8, 3.0], rel=0.15 if push else 0.05)


def test_trajectories_that_may_not_choose_begin_with_the_functions_that_smoothed_samples_tell():
    """Noise of sensors hides the damping from the steps of samples as they are."""
    model = SindyModel(OSCILLATOR, WORDS, Regression("bic"), Refinement("trajectory", select=False), known={"y": "w"})
    model.fit(oscillator(0.0, 0.2, False, 3))
    assert model.coefficients[:3, 1].tolist() == pytest.approx([-4.0, -0.8, 3.0], rel=0.05)


def test_a_long_delay_is_told_where_single_steps_are_mostly_noise():
    """A store of 40 s is read every second, 14 s late; its noise is three times what it moves in a second."""
    generator, phi, late, y = np.random.default_rng(0), math.exp(-1 / 40), 14, [0.0]
    u = np.repeat(generator.uniform(-1, 1, 60), 30)
    for k in range(len(u)):
        y.append(phi * y[-1] + (1 - phi) * u[max(k - late, 0)])
    moved = np.diff(y)
    x = np.array(y) + 3 * moved.std() * generator.normal(size=len(y))
    data = Transitions.from_trajectory(torch.from_numpy(x)[:, None], torch.from_numpy(u)[:, None], 1.0)
    found = Refinement("auto", longest_delay=None).run((LIBRARY, first(data)), FREE, RegressionData.of(data, {}))
    assert found.delay == pytest.approx(late, abs=1.0)
    assert found.coefficients[:2, 0].numpy() == pytest.approx([-1 / 40, 1 / 40], rel=0.1)


def test_functions_that_noise_hides_from_single_steps_are_found():
    """A fifth of each state is noise, beside which no function explains a single step of 20 ms."""
    case = TEXTBOOK["van_der_pol"]
    data, library = case.clean(1)[0].disturbed(0.2, 1000), case.library()
    first = library, case.truth()
    alone = Refinement("one_step").run(first, Constraints.build(library, {}, {}, {}), RegressionData.of(data, {}))
    assert not alone.coefficients.any()
    model = SindyModel(library.signature, library, Regression("bic"), Refinement("auto"))
    model.fit(data)
    assert torch.equal(model.coefficients != 0, case.truth() != 0)
    torch.testing.assert_close(model.coefficients, case.truth(), rtol=0.05, atol=0.0)


N = 20_000


def noisy(*errors: np.ndarray, segments: np.ndarray | None = None) -> bool:
    """What is said of a model that says that nothing moves, where states move by these errors at each step."""
    n, n_x = len(errors[0]), len(errors)
    names = tuple(f"y{k}" for k in range(n_x))
    library = Library(Signature(names, ("-",) * n_x, ("u",), (1.0,) * n_x), [variable(names[0])])
    x = torch.zeros(n, n_x, dtype=torch.float64)
    labels = torch.zeros(n, dtype=torch.int64) if segments is None else torch.from_numpy(segments)
    moved = torch.from_numpy(np.stack(errors, -1))
    data = Transitions(x, torch.zeros(n, 1, dtype=torch.float64), moved, 0.1, labels)
    return looks_noisy(library, torch.zeros(1, n_x, dtype=torch.float64), data)


def white(seed: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n)


def sensor(seed: int, n: int = N) -> np.ndarray:
    """Errors of single steps that white noise of a sensor makes, of variance 1."""
    return np.diff(white(seed, n + 1))


def test_noise_of_a_sensor_is_told_from_errors_that_last_and_from_random_pushes():
    lasting = 20 * np.sin(np.arange(N) / 50)
    assert noisy(sensor(0))
    assert not noisy(lasting) and not noisy(np.full(N, 0.5)) and not noisy(white(1))


def test_changes_across_two_segments_are_none():
    errors = np.tile([1.0, 1.0, 1.0, -2.0, -2.0, -2.0], 10)  # within each segment nothing changes
    assert not noisy(errors, segments=np.arange(60) // 3)
    alternating = np.tile([1.0, -1.0], 30)
    assert noisy(alternating) and not noisy(alternating, segments=np.arange(60))


@pytest.mark.parametrize(("w", "damping", "dt"), [(8.0, 0.4, 0.25), (8.0, 0.7, 0.1875), (8.0, 0.4, 0.05)])
def test_a_clean_log_with_long_steps_and_an_input_that_jumps_at_each_is_not_noisy(w, damping, dt):
    """The motion is that of a'' = w^2 (u - a) - 2 damping w a', by its matrix exponential."""
    u = np.random.default_rng(0).uniform(-1, 1, 600)
    x = held_motion([[0, 1], [-(w**2), -2 * damping * w]], [[0], [w**2]], [0, 0], u, dt)
    signature = Signature(("a", "b"), ("m", "m/s"), ("u",), (1.0, w))
    model = SindyModel(signature, ["a", "b", "u"], Regression("bic"), Refinement("auto"), known={"a": "b"})
    found = model.fit(Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u)[:, None], dt))
    assert model.delay == 0 and "fit.single_steps" in [each.code for each in found.findings]
    assert model.coefficients[:, 1].tolist() == pytest.approx([-(w**2), -2 * damping * w, w**2], rel=1e-5)


PERIOD = 0.05


def refined(xi, free, data, tolerance):
    """What single steps tell, from a first model on."""
    constraints = Constraints(free, torch.where(free, 0.0, xi))
    return Refinement("one_step", rounds=0, tolerance=tolerance).run(
        (LIBRARY, xi), constraints, RegressionData.of(data, {})
    )


def discrete(noise: float = 0.0, n: int = 400, seed: int = 0) -> Transitions:
    """y' = A y + B u in discrete form y+ = phi y + gamma u + noise."""
    generator = np.random.default_rng(seed)
    phi = math.exp(A * PERIOD)
    u, y = generator.uniform(-1, 1, n), [0.3]
    for held, e in zip(u, noise * generator.normal(size=n)):
        y.append(phi * y[-1] + B * (phi - 1) / A * held + e)
    return Transitions.from_trajectory(
        torch.tensor(y).double().unsqueeze(-1), torch.from_numpy(u).unsqueeze(-1), PERIOD
    )


ALL = torch.ones(4, 1, dtype=torch.bool)


def test_the_part_of_the_changes_that_steps_miss_is_that_of_the_closed_form():
    """y' = a y changes y by (exp(a dt) - 1) y over a step; the best a is that of the regression of all steps."""
    x = torch.tensor([[0.3], [-1.0], [2.0]], dtype=torch.float64)
    after = math.exp(A * PERIOD) * x + torch.tensor([[0.01], [0.0], [0.0]])
    moved = Transitions(x, 0 * x, after, PERIOD, torch.zeros(3, dtype=torch.long))
    phi = float((x * after).sum() / x.square().sum())
    wanted = float((after - phi * x).norm() / (after - x).norm())
    found = refined(column(A, 0.0, 0.0, 0.0), torch.tensor([[True], [False], [False], [False]]), moved, 1e-9)
    assert found.missed == {"y": pytest.approx(wanted, rel=1e-6)}


def test_from_a_poor_first_model_the_plant_is_found_to_nine_digits():
    found = refined(column(-1.0, 2.0, 0.5, 0.2), ALL, discrete(), 1e-9).coefficients
    assert found[2:].flatten().tolist() == [0.0, 0.0]
    assert found[:2].flatten().tolist() == pytest.approx([A, B], rel=1e-8)


def test_with_process_noise_it_is_the_least_squares_fit_of_the_discrete_form():
    data = discrete(0.05)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = np.linalg.lstsq(rows, data.x_next.numpy().ravel(), rcond=None)[0]
    a = math.log(phi) / PERIOD
    found = refined(column(A, B, 0.0, 0.0), torch.tensor([[True], [True], [False], [False]]), data, 1e-9).coefficients
    assert found[:2].flatten().tolist() == pytest.approx([a, gamma * a / (phi - 1)], rel=1e-6)
    assert abs(a - A) > 1e-3  # the noise does move the estimate


def test_a_recording_is_fitted_block_by_block_as_it_is_at_once(monkeypatch):
    data, xi = discrete(0.05), column(-1.0, 2.0, 0.0, 0.0)
    whole = refined(xi, ALL, data, 1e-9)
    monkeypatch.setattr(shooting, "MOST_SLOPES", 40)
    monkeypatch.setattr(shooting, "CHUNK", 40)
    found = refined(xi, ALL, data, 1e-9)
    torch.testing.assert_close(found.coefficients, whole.coefficients, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.covariance.factor, whole.covariance.factor, rtol=1e-6, atol=1e-9)


def test_coefficients_that_are_not_free_stay():
    free = torch.tensor([[True], [False], [False], [False]])
    found = refined(column(-1.0, 2.5, 0.0, 0.0), free, discrete(), 1e-6).coefficients
    assert found[1, 0] == 2.5 and found[2:].flatten().tolist() == [0.0, 0.0]

    def errors(a):
        phi, data = math.exp(a[0] * PERIOD), discrete()
        return (phi * data.x + 2.5 * (phi - 1) / a[0] * data.u - data.x_next).numpy().ravel()

    assert found[0, 0].item() == pytest.approx(least_squares(errors, [-1.0], xtol=1e-12, ftol=1e-12).x[0], rel=1e-5)


def test_standard_errors_are_those_of_the_discrete_form_and_of_the_scatter():
    """phi and gamma are a linear regression; a = log(phi) / dt and b = a gamma / (phi - 1) follow by their slopes."""
    fits, stated, support = [], [], torch.tensor([[True], [True], [False], [False]])
    for seed in range(40):
        data = discrete(0.02, 400, seed)
        found = refined(column(A, B, 0.0, 0.0), support, data, 1e-9)
        known = found.covariance
        assert (known.features.tolist(), known.states.tolist()) == ([0, 1], [0, 0])
        fits.append(found.coefficients[:2, 0])
        stated.append(known.errors)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = math.exp(A * PERIOD), B * (math.exp(A * PERIOD) - 1) / A
    slope = np.array([[1 / (phi * PERIOD), 0.0], [0.0, A / (phi - 1)]])
    slope[1, 0] = gamma * (1 / (phi * PERIOD) / (phi - 1) - A / (phi - 1) ** 2)
    closed = np.sqrt(np.diag(slope @ (0.02**2 * np.linalg.inv(rows.T @ rows)) @ slope.T))
    told = torch.stack(stated).square().mean(0).sqrt()
    np.testing.assert_allclose(told, closed, rtol=0.25)
    np.testing.assert_allclose(told, torch.stack(fits).std(0), rtol=0.35)
