"""The unit of a hidden state: changing it changes nothing that is measured, and what holds it is told."""

from functools import partial

import numpy as np
import pytest
import torch

from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.named_libraries import build_library, polynomial
from dynasindy.sindy.shooting import free_scales, scale_constraints, states_without_scale
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

TANKS = Signature(("upper", "lower"), ("m", "m"), ("u",), (1.0, 1.0))
FILL, OUT, IN, DRAIN = 0.30, 0.20, 0.25, 0.10
"""upper' = FILL u - OUT upper, lower' = IN upper - DRAIN lower [1/s]."""
HIDDEN = torch.tensor([True, False])


def table(library, given):
    """Return coefficients `(n_features, n_x)` of equations by state and function."""
    xi = torch.zeros(len(library), library.signature.n_x, dtype=torch.float64)
    for state, terms in given.items():
        for name, size in terms.items():
            xi[library.index(name), library.signature.state_index(state)] = size
    return xi


def levels(u, dt, fine=50):
    """Levels of the two tanks under a held flow, by many small steps of Euler and their midpoint."""
    x, path = np.array([0.4, 0.3]), []
    for held in u:
        path.append(x.copy())
        for _ in range(fine):
            middle = x + 0.5 * dt / fine * np.array([FILL * held - OUT * x[0], IN * x[0] - DRAIN * x[1]])
            slope = np.array([FILL * held - OUT * middle[0], IN * middle[0] - DRAIN * middle[1]])
            x = x + dt / fine * slope
    return np.array([*path, x])


def log(noise, seed=0, samples=300, dt=0.5):
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.uniform(0, 1, samples // 10), 10)
    seen = levels(u, dt) + noise * generator.normal(size=(len(u) + 1, 2))
    seen[:, 0] = np.nan
    return Transitions.from_trajectory(torch.from_numpy(seen), torch.from_numpy(u[:, None]), dt)


def test_in_another_unit_the_lower_level_moves_as_before():
    words = ["u", "upper", "lower", "upper^2", "upper |upper| u", "sqrt(upper) lower"]
    given = {
        "upper": {"u": 0.3, "upper": -0.2, "upper^2": -0.05, "sqrt(upper) lower": -0.1},
        "lower": {"upper": 0.25, "lower": -0.1, "upper^2": 0.02, "upper |upper| u": 0.03},
    }
    model = SindyModel(TANKS, words)
    xi, c = table(model.library, given), 2.5
    scales, exponents = free_scales(model.library, xi, torch.ones_like(xi, dtype=torch.bool), HIDDEN)
    assert scales.shape == (1, 2) and float(scales[0, 0].abs()) == pytest.approx(1.0) and scales[0, 1] == 0
    power = exponents[0] / scales[0, 0]
    assert power[model.library.index("upper^2"), 1] == -2 and power[model.library.index("upper^2"), 0] == -1
    u = torch.from_numpy(np.random.default_rng(0).uniform(0, 1, (40, 1)))
    paths = []
    for size in (1.0, c):
        model.set_coefficients(xi * size**power)
        start = torch.tensor([0.5 * size, 0.3], dtype=torch.float64)
        paths.append(model.simulate(start, u, 0.5, 4))
    torch.testing.assert_close(paths[0] * torch.tensor([c, 1.0]), paths[1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("words", "given", "fixed", "hidden", "free"),
    [
        (["u", "upper", "lower"], {"upper": {"u": 1.0}, "lower": {"upper": 1.0}}, (), (True, False), True),
        (["u", "upper", "lower"], {"upper": {"u": 1.0}, "lower": {"upper": 1.0}}, (), (False, False), False),
        # A coefficient that is given holds the unit of what it multiplies, and of what it fills.
        (
            ["u", "upper", "lower"],
            {"upper": {"u": 1.0}, "lower": {"upper": 1.0}},
            (("upper", 1),),
            (True, False),
            False,
        ),
        (["u", "upper", "lower"], {"upper": {"u": 1.0}, "lower": {"upper": 1.0}}, (("u", 0),), (True, False), False),
        # One that drains it does not: it is a rate in any unit.
        (["u", "upper", "lower"], {"upper": {"u": 1.0, "upper": -1.0}}, (("upper", 0),), (True, False), True),
        # So do a sine and a bend at a level.
        (["u", "sin(upper)"], {"upper": {"u": 1.0}, "lower": {"sin(upper)": 1.0}}, (), (True, False), False),
        (
            ["u", "max(0, upper - 0.5)"],
            {"upper": {"u": 1.0}, "lower": {"max(0, upper - 0.5)": 1.0}},
            (),
            (True, False),
            False,
        ),
        # Of a state in no equation there is nothing to say.
        (["u", "upper", "lower"], {"lower": {"u": 1.0}}, (), (True, False), False),
        # Two hidden states, one of which is by a given equation the rate of the other, have one unit together.
        (["u", "upper", "lower"], {"upper": {"lower": 1.0}, "lower": {"u": 1.0}}, (("lower", 0),), (True, True), True),
    ],
)
def test_what_holds_the_unit_of_a_hidden_state(words, given, fixed, hidden, free):
    library = build_library(words, TANKS)
    xi = table(library, given)
    may = torch.ones_like(xi, dtype=torch.bool)
    for name, state in fixed:
        may[library.index(name if name in library.names else words[1]), state] = False
    scales, exponents = free_scales(library, xi, may, torch.tensor(hidden))
    assert len(scales) == len(exponents) == int(free)
    if all(hidden):
        assert float(scales[0, 0]) == pytest.approx(float(scales[0, 1]))
    nan = torch.where(torch.tensor(hidden), torch.nan, 1.0).double().expand(5, 2)
    data = Transitions.from_trajectory(nan, torch.zeros(4, 1).double(), 0.1)
    names = {n for n, h in zip(TANKS.state_names, hidden, strict=True) if h} if free else set()
    assert set(states_without_scale(library, xi, may, data)) == names


def test_the_unit_is_held_where_the_errors_do_not_change_and_nothing_else():
    """Rows that do not depend on the change of the unit have it as their only direction without length."""
    library = build_library(["u", "upper", "lower"], TANKS)
    xi = table(library, {"upper": {"u": FILL, "upper": -OUT}, "lower": {"upper": IN, "lower": -DRAIN}})
    exponents = free_scales(library, xi, xi != 0, HIDDEN)[1]
    states, features = (xi != 0).mT.nonzero(as_tuple=True)
    lost = (exponents[0] * xi)[features, states]
    generator = torch.Generator().manual_seed(0)
    slopes = torch.randn(50, 4, generator=generator, dtype=torch.float64)
    slopes -= (slopes @ lost).outer(lost) / lost.square().sum()
    rows = torch.cat([slopes, torch.randn(50, 1, generator=generator, dtype=torch.float64)], -1)
    held = torch.cat([rows, scale_constraints(exponents, xi, rows, (features, states))])
    assert int(torch.linalg.matrix_rank(rows[:, :4])) == 3 and int(torch.linalg.matrix_rank(held[:, :4])) == 4
    best = torch.linalg.lstsq(held[:, :4], held[:, 4:]).solution
    least = torch.linalg.lstsq(rows[:, :4], rows[:, 4:], driver="gelsd").solution
    torch.testing.assert_close(rows[:, :4] @ best, rows[:, :4] @ least)


def fit(data, unit, fixed=None):
    initial = {"upper": {"u": 0.2 * unit, "upper": -0.1}, "lower": {"upper": 0.3 / unit, "lower": -0.2}}
    allowed = {"upper": ["u", "upper"], "lower": ["upper", "lower"]}
    refinement = Refinement("trajectory", error="simulation", rounds=0)
    model = SindyModel(
        TANKS,
        partial(polynomial, degree=1),
        Regression("bic"),
        refinement,
        allowed=allowed,
        fixed=fixed,
        initial=initial,
    )
    return model, model.fit(data)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_two_tanks_are_found_in_the_unit_of_the_first_guess(unit):
    """The oracle are the coefficients that moved the tanks; of two of them the data tell the product alone."""
    model, report = fit(log(0.01), unit)
    at = {(model.library.names[f], s): k for k, (f, s) in enumerate(zip(*model.covariance[:2], strict=True))}
    at = {(name, int(s)): k for (name, s), k in at.items()}
    size = model.coefficients[model.covariance.features, model.covariance.states]
    share = model.covariance.shares(model.coefficients)
    # Which tank is the faster one the lower level does not tell.
    drains = sorted((at["upper", 0], at["lower", 1]), key=lambda k: float(size[k]))
    for k, real in zip(drains, (-OUT, -DRAIN), strict=True):
        assert abs(float(size[k]) - real) < 4 * float(share[k] * size[k].abs()) < 0.3 * abs(real)
    fill, drip = at["u", 0], at["upper", 1]
    assert float(size[fill] * size[drip]) == pytest.approx(FILL * IN, rel=0.1)
    assert 0.3 < float(size[fill]) / (0.2 * unit) < 3, "about the unit of the guess"
    assert float(share.max()) < 0.1
    assert report.unscaled == ("upper",) and "sees" in report.to_text()


def test_standard_errors_of_what_the_data_tell_do_not_depend_on_what_holds_the_unit():
    """With one of the two factors given the other one is known as well as their product is without."""
    data = log(0.01, seed=1)
    free, _ = fit(data, 1.0)
    drip = float(free.coefficients[free.library.index("upper"), 1])
    held, report = fit(data, 1.0, {"lower": {"upper": drip}})
    assert report.unscaled == ()

    def logarithms(model):
        known = model.covariance
        return {
            (model.library.names[f], s): row / model.coefficients[f, s]
            for f, s, row in zip(known.features.tolist(), known.states.tolist(), known.factor, strict=True)
        }

    ours, theirs = logarithms(free), logarithms(held)
    product = ours["u", 0] + ours["upper", 1]
    assert float(product.norm()) == pytest.approx(float(theirs["u", 0].norm()), rel=0.02)
    assert float(ours["upper", 0].norm()) == pytest.approx(float(theirs["upper", 0].norm()), rel=0.02)
