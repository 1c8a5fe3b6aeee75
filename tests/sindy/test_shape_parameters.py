"""Numbers inside functions are found from plants in which they are known."""

import numpy as np
import pytest
import torch
from plants import scipy_motion

from dynasindy.findings import weak
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.library import Library, parse
from dynasindy.sindy.shape_parameters import fit_shapes
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

DT = 0.02
CART = Signature(("v",), ("m/s",), ("u",), (1.0,))
ARM = Signature(("a", "w"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def recording(rate, start: list[float], n: int = 400, seed: int = 0) -> Transitions:
    """States of an equation under random inputs, each held for five samples, by scipy."""
    u = np.random.default_rng(seed).uniform(-3, 3, n // 5).repeat(5)
    x = scipy_motion(lambda _, z, v: rate(z, v), start, u, DT, 1e-10, 1e-12)
    return Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u)[:, None], DT)


def cart(z: np.ndarray, u: float) -> list[float]:
    return [-0.4 * z[0] - 1.2 * np.tanh(6.5 * z[0]) + 2.0 * u]


def arm(z: np.ndarray, u: float) -> list[float]:
    return [z[1], (3.0 * u - 0.8 * z[1]) / (1 + 1.7 * np.cos(z[0]) ** 2)]


def found(model: SindyModel) -> dict[tuple[str, str], float]:
    """Coefficients by state and function, the numbers inside the functions left out of the names."""
    names = [" ".join(f"{f.function}({f.variables[0]})" for f in feature.factors) for feature in model.library.features]
    states = model.signature.state_names
    return {(states[i], names[k]): float(model.coefficients[k, i]) for k, i in model.coefficients.nonzero().tolist()}


@pytest.mark.parametrize("guess", [2.0, 20.0])
def test_the_width_of_dry_friction_is_found(guess):
    words = ["v", f"tanh(~{guess:g} v)", "u", "1"]
    model = SindyModel(CART, words, Regression("bic"), Refinement("integral", rounds=4))
    model.fit(recording(cart, [0.0]))
    assert model.library.shapes[0].frequency == pytest.approx(6.5, rel=0.02)
    expected = {("v", "id(v)"): -0.4, ("v", "tanh(v)"): -1.2, ("v", "id(u)"): 2.0}
    assert found(model) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("guess", [3.0, 12.0])
def test_trajectories_alone_find_the_width_of_dry_friction(guess):
    """No regression moves it before."""
    words = ["v", f"tanh(~{guess:g} v)", "u"]
    model = SindyModel(CART, words, Regression("bic"), Refinement("trajectory", rounds=0))
    model.fit(recording(cart, [0.0], n=200))
    assert model.library.shapes[0].frequency == pytest.approx(6.5, rel=1e-3)
    expected = {("v", "id(v)"): -0.4, ("v", "tanh(v)"): -1.2, ("v", "id(u)"): 2.0}
    assert found(model) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("guess", [0.5, 6.0])
def test_the_inertia_of_an_arm_is_found_with_its_torques(guess):
    words = ["w", f"w per_cos2(~{guess:g} a)", f"u per_cos2(~{guess:g} a)", "u"]
    model = SindyModel(ARM, words, Regression("bic"), Refinement("integral", rounds=4), known={"a": "w"})
    model.fit(recording(arm, [0.3, 0.0]))
    assert model.library.shapes[0].frequency == pytest.approx(1.7, rel=1e-3)
    expected = {("a", "id(w)"): 1.0, ("w", "id(w) per_cos2(a)"): -0.8, ("w", "id(u) per_cos2(a)"): 3.0}
    assert found(model) == pytest.approx(expected, rel=1e-3)


def exact(number: float, n: int = 200):
    """Rates of v' = -0.4 v - 1.2 tanh(number v) + 2 u at random points, as a row per point."""
    rng = np.random.default_rng(4)
    v, u = rng.uniform(-1, 1, (n, 1)), rng.uniform(-1, 1, (n, 1))
    dx = torch.from_numpy(-0.4 * v - 1.2 * np.tanh(number * v) + 2 * u)
    x, held = torch.from_numpy(v), torch.from_numpy(u)
    return lambda theta, field: (theta(x, held), dx)


def library(guess: float) -> Library:
    return Library(CART, map(parse, ["v", f"tanh(~{guess:g} v)", "u"]))


def fitted(guess: float, rows, start=(-1.0, -1.0, 1.0), free=(True, True, True), **more) -> tuple[float, list[float]]:
    xi, may = torch.tensor(start, dtype=torch.float64)[:, None], torch.tensor(free)[:, None]
    shaped, xi = fit_shapes(library(guess), xi, may, rows, 1e-9, **more)
    return shaped.shapes[0].frequency, xi.flatten().tolist()


@pytest.mark.parametrize("guess", [1.0, 4.0, 30.0])
def test_exact_rates_give_exact_numbers(guess):
    number, xi = fitted(guess, exact(5.0), rounds=30)
    assert number == pytest.approx(5.0, rel=1e-5) and xi == pytest.approx([-0.4, -1.2, 2.0], rel=1e-4)


def test_a_fit_says_that_a_number_inside_a_function_means_nothing():
    """Of dry friction that is full throughout no data tell the width."""
    u, v = np.random.default_rng(0).uniform(1, 2, 80).repeat(5), [3.0]
    for held in u:  # v' = 2 u - 0.4 v - 1.2, and v > 0.1
        rest = (2 * held - 1.2) / 0.4
        v.append(rest + (v[-1] - rest) * np.exp(-0.4 * DT))
    assert min(v) > 0.1
    full = Transitions.from_trajectory(torch.tensor(v).double()[:, None], torch.from_numpy(u)[:, None], DT)
    for data, guess, silent in ((full, 1000, False), (recording(cart, [0.0]), 20, True)):
        model = SindyModel(CART, ["v", "u", f"tanh(~{guess} v)"], Regression("bic"), Refinement("integral", rounds=4))
        told = weak("fit.shape", function=f"tanh({guess} v)", guess=guess) in model.fit(data).findings
        assert told != silent
