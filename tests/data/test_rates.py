"""A rate in other units than its angle is told; one in the same units, however noisy, is not."""

import math
from dataclasses import replace

import pytest
import torch

from dynasindy.data.columns import Column
from dynasindy.data.rates import check_rates, require_consistent_rates
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Chirp, Multisine
from dynasindy.findings import LogError, weak
from dynasindy.systems import Pendulum, Signature, Tras, Xi
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("angle", "rate"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def swing(angle_unit: float = 1.0, rate_unit: float = 1.0, noise: float = 0.0, n: int = 2000) -> Transitions:
    """A swing of two frequencies [rad], sampled every 0.01 s, its rate by hand, both in other units."""
    t = 0.01 * torch.arange(n + 1, dtype=torch.float64)
    x = torch.stack([torch.sin(2 * t) + 0.3 * torch.sin(7 * t), 2 * torch.cos(2 * t) + 2.1 * torch.cos(7 * t)], -1)
    x = x + noise * x.std(0) * torch.randn(x.shape, generator=torch.Generator().manual_seed(0), dtype=x.dtype)
    return Transitions.from_trajectory(x * torch.tensor([angle_unit, rate_unit]), torch.zeros(n, 1), 0.01)


def mismatched(data, signature, known=None):
    """Return the facts of rates in other units."""
    return [f.values for f in check_rates(data, signature, known or {}) if f.code == "log.rate_units"]


def contradicted(data, known):
    return [f for f in check_rates(data, SIGNATURE, known) if f.code != "log.rate_units"]


def refused(data, known):
    with pytest.raises(LogError) as error:
        require_consistent_rates(data, SIGNATURE, known, {name: Column(name) for name in SIGNATURE.state_names})
    return error.value.finding


@pytest.mark.parametrize(
    ("angle", "rate", "factor"),
    [
        (180 / math.pi, 1.0, 57.3),
        (1.0, 180 / math.pi, 0.01745),
        (1e3, 1.0, 1000.0),
        (1.0, 1e3, 0.001),
        (1.0, 30 / math.pi, 0.1047),
        (-1.0, 1.0, -1.0),
        (17.0, 1.0, 17.0),
        (-180 / math.pi, 1.0, -57.3),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_factor_is_told(angle, rate, factor, noise):
    (found,) = check_rates(swing(angle, rate, noise), SIGNATURE, {})
    factor = pytest.approx(factor, rel=0.03)
    assert found.code == "log.rate_units" and found.severity == "weak"
    assert found.values == {"state": "angle", "rate": "rate", "factor": factor, "guessed": True}


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3, 1.0])
@pytest.mark.parametrize("scale", [1.0, 2.5, 0.4])
def test_a_rate_that_fits_is_not_told_however_noisy(noise, scale):
    assert mismatched(swing(1.0, scale, noise), SIGNATURE) == []


@pytest.mark.parametrize(
    ("names", "units", "known", "told"),
    [
        (("q", "w"), ("-", "-"), {"q": "w"}, True),
        (("q", "w"), ("-", "-"), {}, False),
        (("q", "q_dot"), ("-", "-"), {}, True),
        (("angle", "rate"), ("-", "-"), {}, True),
        (("q", "w"), ("deg", "deg/s"), {}, True),
        (("q", "w"), ("V", "rad/s"), {}, False),
        (("q", "w"), ("V", "V/s"), None, True),
    ],
)
def test_what_is_known_or_called_so_or_has_the_unit_is_the_rate(names, units, known, told):
    found = mismatched(swing(57.3), Signature(names, units, ("u",), (1.0, 1.0)), known)
    assert bool(found) == told


@pytest.mark.parametrize(
    ("names", "units", "told"),
    [
        (("theta_load", "omega_motor"), ("rad", "rad/s"), True),
        (("theta_load", "omega_motor"), ("rad", "motor rad/s"), False),
        (("theta_load", "omega_motor"), ("rad", "rpm"), False),
        (("angle", "speed"), ("rad", "motor rpm"), False),
        (("position", "speed"), ("m", "rpm"), False),
        (("position", "speed"), ("m", "rad/s"), False),
        (("position", "speed"), ("m", "-"), False),
        (("position", "position_speed"), ("m", "rpm"), True),
    ],
)
def test_a_pair_behind_a_gear_of_70_is_told_only_if_the_units_fit_and_then_as_a_guess(names, units, told):
    data, signature = swing(1.0, 70.0), Signature(names, units, ("u",), (1.0, 1.0))
    found = mismatched(data, signature)
    assert [one["factor"] for one in found] == ([pytest.approx(1 / 70, rel=0.03)] if told else [])
    named = names[1] == f"{names[0]}_speed"
    assert all(one["guessed"] != named for one in found)
    (known,) = mismatched(data, signature, {names[0]: names[1]})
    assert not known["guessed"]


def without(data: Transitions, lost: torch.Tensor) -> Transitions:
    """The same recording without the samples that are lost, bool `(T + 1, n_x)`."""
    x = torch.cat([data.x, data.x_next[-1:]]).masked_fill(lost, math.nan)
    return Transitions.from_trajectory(x, data.u, data.dt)


@pytest.mark.parametrize("angle", [57.3, -1.0])
@pytest.mark.parametrize(
    "lost",
    [
        (range(0, 2001, 3), []),
        ([], [k for k in range(2001) if k % 5]),
        (range(300, 600), range(900, 1300)),
    ],
)
def test_lost_samples_do_not_switch_the_check_off(angle, lost):
    gone = torch.zeros(2001, 2, dtype=torch.bool)
    for column, rows in enumerate(lost):
        gone[list(rows), column] = True
    (found,) = mismatched(without(swing(angle, 1.0, 0.02), gone), SIGNATURE)
    assert found["factor"] == pytest.approx(angle, rel=0.05)
    assert mismatched(without(swing(1.0, 1.0, 0.02), gone), SIGNATURE) == []


def test_neither_a_long_gap_nor_a_break_between_recordings_is_bridged():
    """A rate that lies elsewhere in each stretch would tell nonsense between them, as would the jump of the angle."""
    data, gone = swing(), torch.zeros(2001, 2, dtype=torch.bool)
    gone[[k for k in range(2001) if 20 <= k % 200 < 180], 1] = True
    assert mismatched(without(data, gone), SIGNATURE, {"angle": "rate"}) == []
    gone[:, 1] = torch.arange(2001) % 18 >= 3
    fast = 2 * math.pi / 0.2 * 0.01 * torch.arange(2001).double()
    fast = Transitions.from_trajectory(torch.stack([fast.sin(), 10 * math.pi * fast.cos()], -1), data.u, 0.01)
    assert check_rates(without(fast, gone), SIGNATURE, {"angle": "rate"}) == []
    parts = [
        data.select(
            (torch.arange(len(data)) >= len(data) - 40 * k) & (torch.arange(len(data)) < len(data) - 40 * k + 40)
        )
        for k in range(1, 51)
    ]
    jumps = [replace(p, x=p.x + 500.0 * k, x_next=p.x_next + 500.0 * k) for k, p in enumerate(parts)]
    for part in jumps:
        part.x[-1, 1] = part.x_next[-1, 1] = math.nan
    assert mismatched(Transitions.cat(jumps), SIGNATURE) == []


def test_an_axis_that_moves_almost_like_another_one_is_not_taken_for_it():
    """As of a balanced pendulum on an arm: the arm moves against the pendulum's rate, with little apart."""
    data = swing()
    other = -1.3 * data.x[1:, 1:] + 0.8 * (3 * 0.01 * torch.arange(len(data) - 1)).sin().unsqueeze(-1)
    mixed = Transitions.from_trajectory(torch.cat([data.x[1:, :1], other], -1), data.u[2:], 0.01)
    assert mismatched(mixed, SIGNATURE) == []
    assert mismatched(mixed, SIGNATURE, {"angle": "rate"})[0]["factor"] == pytest.approx(-1 / 1.3, rel=0.05)


@pytest.mark.parametrize("plant", [Tras, Xi, Pendulum])
def test_no_simulated_plant_is_told(plant):
    system = plant()
    for signal in (
        Chirp(system.signature.n_u, duration=10.0),
        Multisine(system.signature.n_u, duration=10.0, dt=0.05, seed=1),
    ):
        exact = record_plant(system, signal.samples(0.01), 0.01, substeps=2)
        for noise in (0.0, 0.02, 0.2):
            assert mismatched(exact.disturbed(noise, 0), system.signature) == []


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.2])
def test_a_rate_and_its_state_that_were_exchanged_are_told_with_what_mends_it(noise):
    told = contradicted(swing(noise=noise), {"rate": "angle"})
    assert told == [weak("log.rate_exchanged", state="rate", rate="angle", known={"angle": "rate"})]


def test_a_state_that_moves_by_something_else_contradicts_its_rate():
    data = swing()
    other = torch.randn(len(data), 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64).cumsum(0)
    mixed = Transitions.from_trajectory(torch.cat([data.x[:, :1], other], -1), data.u[1:], 0.01)
    (told,) = contradicted(mixed, {"angle": "rate"})
    assert (told.code, told.values["state"]) == ("log.rate_contradicted", "angle")
    assert abs(told.values["correlation"]) < 0.5


def test_a_rate_that_was_exchanged_with_its_state_has_no_factor_and_one_per_minute_has():
    """A pure sine is its own second derivative but for the factor of -4, which is no matter of units."""
    t = 0.01 * torch.arange(2001, dtype=torch.float64)
    x = torch.stack([torch.sin(2 * t), 2 * torch.cos(2 * t)], -1)
    data = Transitions.from_trajectory(x, torch.zeros(2000, 1), 0.01)
    assert refused(data, {"rate": "angle"}).code == "log.rate_exchanged"
    minutes = swing(1.0, 30 / math.pi, 0.1)
    assert refused(minutes, {"angle": "rate"}).values["states"]["rate"]["scale"] == pytest.approx(2 * math.pi / 60)
    assert refused(swing(-17.0), {"angle": "rate"}).values["states"]["rate"]["scale"] == -17.0


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_known_rate_that_is_wrong_by_two_is_told_and_one_that_is_right_is_not(factor, noise):
    """It is exact in the model, so twice the slope is twice the gain; filters and noise make less of a difference."""
    (found,) = mismatched(swing(1.0, factor, noise), SIGNATURE, {"angle": "rate"})
    assert found["factor"] == pytest.approx(1 / factor, rel=0.05)
    require_consistent_rates(swing(1.0, factor, noise), SIGNATURE, {"angle": "rate"}, {})
    assert mismatched(swing(1.0, factor, noise), SIGNATURE) == []
    for level in (noise, 0.2, 1.0):
        assert mismatched(swing(noise=level), SIGNATURE, {"angle": "rate"}) == []


def test_what_cannot_be_a_known_rate_is_refused_with_what_mends_it():
    require_consistent_rates(swing(), SIGNATURE, {"angle": "rate", "rate": "-angle"}, {})
    told = refused(swing(180 / math.pi), {"angle": "rate"})
    assert told.code == "log.rate_units" and told.values["unit"] == "rad/s"
    scale = pytest.approx(180 / math.pi)
    assert told.values["states"] == {"angle": "angle", "rate": {"name": "rate", "unit": "rad/s", "scale": scale}}
    assert refused(swing(), {"rate": "angle"}).code == "log.rate_exchanged"
