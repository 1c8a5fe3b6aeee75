"""Lag states are told from none, and their times and effects are those of the plant of the log."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from dynasindy.findings import note
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.lag_states import (
    TIMES,
    has_clear_lags,
    lag_state_candidates,
    lag_state_findings,
    lag_state_ranges,
    widened,
    with_lag_state,
)
from dynasindy.systems.base import Signature
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 3.0))
DT, STEP = 0.02, 2 * math.pi / 4096
WORDS = ["1", "q", "w", "u", "sin(q)", "u^2"]
OVEN = Signature(("T",), ("degC",), ("u",), (120.0,))
MINUTE = 10.0
"""Sampling time of the oven [s]."""


def levels(count, each, seed=0):
    """Random levels of an input, each held for some samples, `(count * each, 1)`."""
    rng = torch.Generator().manual_seed(seed)
    return (2 * torch.rand(count, generator=rng).double() - 1).repeat_interleave(each)[:, None]


def moved(field, start, u, dt):
    """The states of a plant under held inputs, `(N + 1, n)`."""
    x = [torch.tensor(start, dtype=torch.float64)]
    for held in u:
        now = x[-1]
        for _ in range(2):
            now = rk4(field, now, held, dt / 2)
        x.append(now)
    return torch.stack(x)


@cache
def arm(lag=0.0):
    """An arm that hangs, read by an encoder, whose motor may lag."""

    def field(x, u):
        acting = x[2] if lag else u[0]
        rates = [(u[0] - x[2]) / (lag or 1), (x[0] - x[3]) / 0.4]
        return torch.stack([x[1], 8 * acting - 0.5 * x[1] - 9 * torch.sin(x[0]), *rates])

    u = levels(36, 25)
    angle = (moved(field, [0.0] * 4, u, DT)[:, :1] / STEP).round() * STEP
    return Transitions.from_trajectory(torch.cat([angle, torch.full_like(angle, math.nan)], -1), u, DT)


def oven(noise=0.0, start=(80.0, 20.0), wall=1 / 200):
    """An oven of 2 heat stores, air and wall, of which the air alone is measured; by the matrix exponential."""
    u = levels(12, 40, seed=1)
    a = torch.tensor([[-wall - 1 / 500 * (wall == 0), wall], [1 / 600, -1 / 600 - 1 / 900]], dtype=torch.float64)
    b = torch.tensor([[0.12, 0.12], [0.0, 20 / 900]], dtype=torch.float64)
    whole = torch.linalg.matrix_exp(MINUTE * torch.cat([torch.cat([a, b], 1), torch.zeros(2, 4).double()]))
    x = [torch.tensor(start, dtype=torch.float64)]
    for held in u:
        x.append(whole[:2, :2] @ x[-1] + whole[:2, 2:] @ torch.cat([held, torch.ones(1).double()]))
    air = torch.stack(x)[:, :1]
    air += noise * torch.randn(air.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return Transitions.from_trajectory(air, u, MINUTE)


def made(signature=SIGNATURE, words=WORDS, known=None, method="trajectory"):
    known = {"q": "w"} if known is None else known
    return SindyModel(signature, words, Regression("bic"), Refinement(method, longest_delay=2.5 * DT), known=known)


def of_oven(data, method="auto"):
    model = made(OVEN, ["1", "T", "u", "T^2", "T u"], {}, method)
    model.fit(data)
    return model


def terms(model, state):
    column = model.coefficients[:, model.signature.state_index(state)].tolist()
    return {name: value for name, value in zip(model.library.names, column, strict=True) if abs(value) > 1e-12}


def test_the_time_of_a_lag_is_found_and_one_that_is_not_there_is_not():
    data, model = arm(lag=0.15), made()
    model.fit(data)
    best = lag_state_candidates(model, data)[0]
    near = min(TIMES, key=lambda n: abs(n * DT - 0.15)) * DT
    wide = best
    assert "u" in best.followed.values() and 1 / float(wide.initial[-1, -1]) == pytest.approx(near)
    assert wide.signature.state_names == ("q", "w", "u_lagging") and wide.signature.state_units[-1] == "1"
    assert wide.followed == {"u_lagging": "u"} and wide.followers == {}
    assert lag_state_findings(best) == []  # nothing is fitted yet
    wide.fit(widened(data))
    assert 1 / float(wide.coefficients[-1, 2]) == pytest.approx(0.15, rel=0.02)
    assert wide.library.names[-1] == "(u - u_lagging)" and wide.delay < 0.005
    found = {"signal": "u", "seconds": pytest.approx(0.15, rel=0.02), "is_input": True, "state": "u_lagging"}
    assert lag_state_findings(best) == [note("model.lag_state", **found)]
    assert terms(wide, "w") == {
        "u_lagging": pytest.approx(8, rel=0.02),
        "w": pytest.approx(-0.5, rel=0.05),
        "sin(q)": pytest.approx(-9, rel=0.02),
    }
    assert wide.coefficients[:, 0].tolist() == [float(name == "w") for name in wide.library.names]


def test_actuators_that_lag_alike_are_found_together():
    """A body with two rotors: w' = 8 (a_1 - a_2) - 0.5 w; v' = 5 (a_1 + a_2) - v, a_i' = (u_i - a_i) / 0.12."""
    u = torch.cat([levels(40, 15, seed) for seed in (0, 1)], -1)

    def field(x, u):
        a = x[2:]
        return torch.stack([8 * (a[0] - a[1]) - 0.5 * x[0], 5 * a.sum() - x[1], *(u - a) / 0.12])

    x = moved(field, [0.0] * 4, u, DT)[:, :2]
    x += 1e-2 * torch.randn(x.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    data = Transitions.from_trajectory(x, u, DT)
    signature = Signature(("w", "v"), ("rad/s", "m/s"), ("u_1", "u_2"), (3.0, 3.0))
    model = made(signature, ["1", "w", "v", "u_1", "u_2"], {})
    model.fit(data)
    best = lag_state_candidates(model, data)[0]
    assert best.followed == {"u_1_lagging": "u_1", "u_2_lagging": "u_2"}
    best.fit(widened(data, 2))
    found = [(each.values["signal"], each.values["seconds"]) for each in lag_state_findings(best)]
    assert found == [("u_1", pytest.approx(0.12, rel=0.1)), ("u_2", pytest.approx(0.12, rel=0.1))]
    assert terms(best, "w")["u_1_lagging"] == pytest.approx(8, rel=0.05)
    assert terms(best, "v")["u_2_lagging"] == pytest.approx(5, rel=0.05)


def test_an_input_acts_late_on_what_a_camera_sees_late_and_at_once_on_the_rest():
    """A cart, v' = 8 u - 2 v, and what hangs from it, w' = -9 q - 0.5 w - 4 u, seen two samples late."""
    u = levels(60, 15)

    def field(x, u):
        return torch.stack([8 * u[0] - 2 * x[0], x[2], -9 * x[1] - 0.5 * x[2] - 4 * u[0]])

    x = moved(field, [0.0] * 3, u, DT)
    x += 1e-3 * torch.randn(x.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    seen = torch.stack([x[2:, 0], x[:-2, 1], torch.full_like(x[2:, 0], math.nan)], -1)
    data = Transitions.from_trajectory(seen, u[2:], DT)
    signature = Signature(("v", "q", "w"), ("m/s", "rad", "rad/s"), ("u",), (4.0, 1.0, 2.0))
    model = made(signature, ["1", "v", "q", "w", "u"], {"q": "w"})
    model.fit(data)
    best = lag_state_candidates(model, data)[0]
    assert best.followed == {"u_lagging": "u"} and "u" in best.library.names
    best.fit(widened(data))
    assert terms(best, "v") == {"v": pytest.approx(-2, rel=0.05), "u": pytest.approx(8, rel=0.05)}
    late, at_once = (terms(best, "w").get(name, 0.0) for name in ("u_lagging", "u"))
    assert late + at_once == pytest.approx(-4, rel=0.05)
    mean = lag_state_findings(best)[0].values["seconds"] * late / (late + at_once)
    assert mean == pytest.approx(2 * DT, rel=0.25)  # by how much it acts late in the mean


def test_a_state_that_follows_an_input_and_tells_nothing_is_not_clear():
    """An encoder's arm without a lag, and one whose motor lags; both are fitted with a lag beside their input."""
    clear = []
    for lag in (0.0, 0.15):
        wide = with_lag_state(made(words=["1", "q", "w", "u", "sin(q)"]), "u", beside=True)
        wide.initial, wide.initial_delay = torch.zeros(len(wide.library), 3, dtype=torch.float64), 0.0
        wide.initial[-1, -1] = 1 / 0.2  # where the fit of the lag begins
        wide.initial[wide.library.names.index("u_lagging"), 1] = 1.0
        wide.refinement = replace(wide.refinement, select=False)
        wide.fit(widened(arm(lag=lag)))
        clear.append(has_clear_lags(wide))
    assert clear == [False, True]


def test_a_second_heat_store_is_found_from_the_temperature_of_the_first():
    """With a = (W - 8) / 0.6 the wall's W' = (T - W) / 600 + (20 - W) / 900 is a' = (T - a) / 360, and T' as below."""
    data = oven()
    model = of_oven(data)
    best = lag_state_candidates(model, data)[0]
    assert best.followed == {"T_lagging": "T"} and best.followers == {1: 0}
    assert best.signature.state_units == ("degC", "degC") and best.signature.x_scale == (120.0, 120.0)
    best.fit(widened(data))
    found = {"1": 0.16, "T": -0.002, "u": 0.12, "(T - T_lagging)": -0.003}
    assert terms(best, "T") == {name: pytest.approx(value, rel=1e-4) for name, value in found.items()}
    assert terms(best, "T_lagging") == {"(T - T_lagging)": pytest.approx(1 / 360, rel=1e-4)}
    found = {"signal": "T", "seconds": pytest.approx(360, rel=1e-4), "is_input": False, "state": "T_lagging"}
    assert lag_state_findings(best) == [note("model.lag_state", **found)]
    more = lag_state_candidates(best, widened(data))
    assert all(sorted(each.followed.values()) == ["T", "u"] for each in more), "T is followed already"


def commanded(data, samples):
    """Return a recording whose inputs were commanded so many samples before they acted."""
    rows = len(data) - samples
    return replace(data.select(torch.arange(len(data)) < rows), u=data.u[samples:])


def test_a_delay_alone_is_no_lag():
    data, model = commanded(arm(), 3), made()
    model.refinement = replace(model.refinement, longest_delay=8 * DT)
    model.fit(data)
    assert model.delay == pytest.approx(3 * DT, abs=0.02 * DT) and lag_state_candidates(model, data) == []


def test_a_delay_is_told_from_a_lag_where_both_were_taken_for_one_delay():
    """A wheel, w' = 8 a - 0.5 w, whose motor a lags its commands by 0.15 s, which come five samples late."""
    shown = levels(24, 20, seed=3)
    acting = torch.cat([shown[:1].expand(5, 1), shown])[: len(shown)]

    def field(x, u):
        return torch.stack([8 * x[1] - 0.5 * x[0], (u[0] - x[1]) / 0.15])

    data = Transitions.from_trajectory(moved(field, [0.0, 0.0], acting, DT)[:, :1], shown, DT)
    model = made(Signature(("w",), ("rad/s",), ("u",), (3.0,)), ["1", "w", "u", "w^2"], {}, "auto")
    model.refinement = replace(model.refinement, longest_delay=None)
    model.delay = 10 * DT
    best = lag_state_candidates(model, data)[0]
    assert "u" in best.followed.values() and best.initial_delay == pytest.approx(5 * DT)
    best.fit(widened(data))
    assert best.delay == pytest.approx(5 * DT, abs=0.02 * DT)
    assert terms(best, "u_lagging") == {"(u - u_lagging)": pytest.approx(1 / 0.15, rel=0.01)}
    assert terms(best, "w") == {"u_lagging": pytest.approx(8, rel=0.01), "w": pytest.approx(-0.5, rel=0.02)}


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_an_oven_of_one_store_has_no_second_one(noise):
    data = oven(noise=noise, wall=0.0)
    assert lag_state_candidates(of_oven(data), data) == []


def test_states_that_follow_begin_where_the_log_had_them():
    """Those of inputs between the commands and zero; one of a state by as much beside it as there.

    What follows a ramp of 0.5 K/s with 20 s is 10 K behind in the end.
    """
    names = Signature(("T", "v_lagging", "T_lagging"), ("K", "1", "K"), ("u", "v"), (1.0, 1.0, 1.0))
    own = {"v_lagging": ["(v - v_lagging)"], "T_lagging": ["(T - T_lagging)"]}
    model = SindyModel(names, ["T", "v_lagging", "(v - v_lagging)", "(T - T_lagging)"], allowed=own)
    model.set_coefficients(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 1 / 20]]).double())
    x = torch.full((401, 3), math.nan).double()
    x[:, 0] = 80 + 0.5 * torch.arange(401)
    data = Transitions.from_trajectory(x, torch.tensor([[-0.5, 0.25], [0.5, 0.75]]).double().repeat(200, 1), 1.0)
    found = lag_state_ranges(model, data)
    assert found[1] == (0.0, 0.75)
    assert found[2] == (pytest.approx(-10, rel=0.03), pytest.approx(0.0, abs=0.3))
