"""An input behind a lag is told from one that acts at once, and its time is that of the plant that made the log."""

import math
from dataclasses import replace

import pytest
import torch

from dynasindy.systems.base import Signature
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models import Refinement, Regression, SindyModel
from dynasindy.world_models.models.follower import (
    TIMES,
    completed,
    lag_of,
    lagged,
    lagging,
    lags,
    widened,
    with_follower,
)

SIGNATURE = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 3.0))
DT, STEP = 0.02, 2 * math.pi / 4096
WORDS = ["1", "q", "w", "u", "sin(q)", "u^2"]


def logged(lag):
    """An arm that hangs, moved by a motor whose speed follows its command; the angle is read by an encoder."""
    rng = torch.Generator().manual_seed(0)
    u = (2 * torch.rand(50, generator=rng).double() - 1).repeat_interleave(25)

    def field(x, u):
        acting = x[2] if lag else u[0]
        rate = (u[0] - x[2]) / lag if lag else torch.zeros_like(x[2])
        return torch.stack([x[1], 8 * acting - 0.5 * x[1] - 9 * torch.sin(x[0]), rate])

    x = [torch.zeros(3, dtype=torch.float64)]
    for held in u:
        now = x[-1]
        for _ in range(4):
            now = rk4(field, now, held[None], DT / 4)
        x.append(now)
    angle = (torch.stack(x)[:, :1] / STEP).round() * STEP
    return Transitions.from_trajectory(torch.cat([angle, torch.full_like(angle, torch.nan)], -1), u[:, None], DT)


def made(known=None):
    known = {"q": "w"} if known is None else known
    return SindyModel(SIGNATURE, WORDS, Regression("bic"), Refinement("trajectory", longest_delay=0.05), known=known)


def test_the_time_of_a_lag_is_found_and_one_that_is_not_there_is_not():
    data, model = logged(0.15), made()
    model.fit(data)
    guess = lag_of(model, data, 0)
    near = min(TIMES, key=lambda n: abs(n * DT - 0.15)) * DT
    assert guess == pytest.approx(near)
    wide = with_follower(model, data, 0, guess)
    assert wide.signature.state_names == ("q", "w", "u_lagging") and wide.signature.state_units[-1] == "1"
    wide.fit(widened(data))
    assert 1 / float(wide.coefficients[-1, 2]) == pytest.approx(0.15, rel=0.02)
    assert wide.library.names[-1] == "(u - u_lagging)" and wide.delay < 0.005
    found = dict(zip(wide.library.names, wide.coefficients[:, 1].tolist(), strict=True))
    assert {name: value for name, value in found.items() if value} == {
        "u_lagging": pytest.approx(8, rel=0.02),
        "w": pytest.approx(-0.5, rel=0.05),
        "sin(q)": pytest.approx(-9, rel=0.02),
    }
    assert wide.coefficients[:, 0].tolist() == [float(name == "w") for name in wide.library.names]


def test_a_plant_without_a_lag_has_none():
    data, model = logged(0.0), made()
    model.fit(data)
    assert lag_of(model, data, 0) == 0.0


def test_equations_that_are_known_beyond_rates_are_left_alone():
    data = logged(0.15)
    fixed = SindyModel(
        SIGNATURE, WORDS, Regression("bic"), Refinement("trajectory"), {"q": "w"}, fixed={"w": {"u": 8.0}}
    )
    assert with_follower(fixed, data, 0, 0.15) is None


def test_one_state_more_is_seen_by_no_sensor():
    data = logged(0.0)
    wide = widened(data)
    assert wide.x.shape[-1] == 3 and bool(wide.x[:, 2].isnan().all() and wide.x_next[:, 2].isnan().all())
    assert torch.equal(wide.x[:, 0], data.x[:, 0]) and wide.dt == data.dt
    assert lagging("u") == "u_lagging"


def test_what_comes_through_a_lag_is_the_mean_over_each_interval():
    """After a step from 0 to 1 the lag has 1 - exp(-t/T), whose mean over dt is 1 - T/dt (1 - exp(-dt/T))."""
    u = torch.cat([torch.zeros(400, 1), torch.ones(100, 1)]).double()
    data = Transitions.from_trajectory(torch.zeros(501, 1).double(), u, DT)
    acts, known = lagged(data, 0, 0.1)
    mean = 1 - 0.1 / DT * (1 - math.exp(-DT / 0.1))
    assert float(acts.u[400]) == pytest.approx(mean, abs=1e-3) and bool(known[400])
    same, all_known = lagged(data, 0, 0.0)
    assert same is data and bool(all_known.all())


@pytest.mark.parametrize(("rows", "stretches"), [(100, 1), (180, 1), (100, 5), (12, 1)])
def test_a_log_too_short_for_a_lag_has_none_and_one_of_many_stretches_tries_short_ones(rows, stretches):
    data, model = logged(0.15), made()
    model.fit(data)
    short = data.select(torch.arange(len(data)) < rows * stretches)
    cut = replace(short, segment=torch.arange(len(short)) // rows)
    assert lag_of(model, cut, 0) in [0.0, *(n * DT for n in TIMES)]
    if rows == 12:
        assert lag_of(model, cut, 0) == 0.0


def test_a_recording_gets_the_states_that_its_model_has_and_no_others():
    data, wide = logged(0.0), Signature(("q", "w", "u_lagging"), ("rad", "rad/s", "1"), ("u",), (1.0, 3.0, 1.0))
    assert completed(data, ("q", "w"), wide).x.shape[-1] == 3
    assert completed(data, ("q", "w"), SIGNATURE) is data
    for names, other in ((("q", "v"), wide), (("q",), SIGNATURE)):
        with pytest.raises(ValueError, match="give a model of the plant that the log is of"):
            completed(data, names, other)


def test_a_lag_lies_between_the_commands_of_its_input_and_zero_where_it_began():
    names, units, ranges = ("q", "v_lagging", "u_lagging"), ("rad", "1", "1"), (1.0, 1.0, 1.0)
    wide, logged_inputs = (
        Signature(names, units, ("u", "v", "w"), ranges),
        torch.tensor([[0.25, -0.5, 1.0], [0.75, 0.5, 0.0]]),
    )
    assert lags(wide, logged_inputs) == {"u_lagging": (0.0, 0.75), "v_lagging": (-0.5, 0.5)}
