"""Control periods of a mass on a spring, whose frequency and damping are known."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

import dynasindy
from dynasindy.control.period import as_planned, suited_period
from dynasindy.data.recording import Recording
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.findings import Finding, note
from dynasindy.identification.source import Source, closest_period
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.workbench import tracking_task

NAMES = ["p", "v", "u"]
SIGNATURE = Signature(("p", "v"), ("m", "m/s"), ("u",), (1.0, 60.0))


def known(hertz, damping):
    """Return a model of a spring, p' = v, v' = w^2 (u - p) - 2 z w v."""
    model, w = SindyModel(SIGNATURE, library=NAMES), 2 * math.pi * hertz
    rows = {"p": (0.0, -w * w), "v": (1.0, -2 * damping * w), "u": (0.0, w * w)}
    model.coefficients = torch.tensor([rows[name] for name in model.library.names], dtype=torch.float64)
    return model


@cache
def recorded():
    """Return four seconds of a spring."""
    u = Multisine(1, duration=4, dt=0.05, amplitude=[0.8], seed=0).samples(0.01)
    return record_plant(known(2.0, 0.2), u, 0.01)


def logged(dt, signature):
    """Return a log with a sampling time."""
    return Source.of(Recording(replace(recorded(), dt=dt), signature))


def suited(hertz, damping, dt):
    model = known(hertz, damping)
    log = None if dt is None else logged(dt, model.signature)
    return suited_period(model, tracking_task(model, {"p": (-0.5, 0.5)}), log)


@pytest.mark.parametrize(
    ("hertz", "dt", "seconds"),
    [
        (9.4, 0.005, 0.02),  # 0.107 s are 21.5 ms five times, which are four samples
        (9.4, 0.02, 0.02),  # 40 ms by the log alone
        (4.0, 0.01, 0.05),  # 0.25 s are five times 50 ms
        (50.0, 0.01, 0.01),  # a fifth is less than a sample
        (0.5, 0.001, 0.01),  # slow: ten samples
        (9.4, None, 0.021),
    ],
)
def test_a_period_is_a_fifth_of_the_swing_of_a_spring_in_whole_samples(hertz, dt, seconds):
    found = suited(hertz, 0.1, dt)
    assert found[0] == pytest.approx(seconds)
    if dt is not None:
        assert found[0] / dt == pytest.approx(round(found[0] / dt))
        longest = 1 / (5 * hertz * math.sqrt(1 - 0.1**2))
        assert found[0] <= max(longest, dt) * (1 + 1e-6)


def chosen(seconds, cause, value) -> Finding:
    return note(
        "control.period",
        seconds=pytest.approx(seconds),
        cause=cause,
        value=pytest.approx(value, rel=5e-3),
        ahead=80,
    )


def test_an_overdamped_spring_keeps_ten_samples():
    found = suited(9.4, 2.0, 0.002)
    assert found[0] == pytest.approx(0.02)
    assert found[1] == chosen(0.02, "samples", 0)
    assert suited(9.4, 2.0, 0.005)[0] == pytest.approx(0.05)
    assert suited(9.4, 2.0, None)[0] == 0.05


def test_a_plan_takes_the_period_that_suits_unless_another_one_is_given():
    model, short = known(9.4, 0.1), {"updates": 1, "rollouts": 4, "window": 5}
    log = logged(0.005, model.signature)
    assert dynasindy.plan(model, {"p": (-0.5, 0.5)}, log, **short).dt == pytest.approx(0.02)
    assert dynasindy.plan(model, {"p": (-0.5, 0.5)}, log, dt=0.05, **short).dt == 0.05


@pytest.mark.parametrize(("step", "period"), [(0.001, 0.01), (0.03, 0.06), (0.2, 0.2)])
def test_a_control_period_is_never_shorter_than_a_sample(step, period):
    assert closest_period(logged(step, known(1.0, 0.1).signature)) == pytest.approx(period)


def rubbing(hertz, damping, friction):
    """Return a spring that dry friction holds, v' = w^2 (u - p) - 2 z w v - friction tanh(200 v)."""
    smooth = known(hertz, damping)
    model = SindyModel(smooth.signature, library=[*NAMES, "tanh(200 v)"], known={"p": "v"})
    last = torch.tensor([[0.0, -friction]], dtype=torch.float64)
    model.coefficients = torch.cat([smooth.coefficients, last])
    return model


def blind(log):
    """Return a log without its rate, as an encoder gives it."""
    unseen = torch.full_like(log.training.x[:, 1], torch.nan)

    def _without(data):
        x, x_next = (torch.stack([given[:, 0], unseen[: len(data)]], -1) for given in (data.x, data.x_next))
        return replace(data, x=x, x_next=x_next)

    return replace(log, training=_without(log.training), validation=_without(log.validation))


@pytest.mark.parametrize("seen", [True, False])
def test_a_swing_that_friction_hides_at_rest_counts_where_the_log_moves(seen):
    """At rest 200 * 40 of damping leave two real poles; in motion T = 1 / (f sqrt(1 - z^2)) = 0.10692 s is left."""
    model = rubbing(9.4, 0.1, 40.0)
    log = logged(0.005, model.signature)
    found = suited_period(model, tracking_task(model, {"p": (-0.5, 0.5)}), log if seen else blind(log))
    assert found[0] == pytest.approx(0.02) and found[1] == chosen(0.02, "oscillation", 0.10692)


NAMES_OF_TANK = ["h", "p", "v", "u"]


def tank(slow, hertz=None):
    """Return h' = (u - h) / slow, beside a spring that the input moves if there is a frequency."""
    signature = Signature(("h", "p", "v"), ("m", "m", "m/s"), ("u",), (1.0, 1.0, 1.0))
    model, w = SindyModel(signature, library=NAMES_OF_TANK), 2 * math.pi * (hertz or 0.0)
    z = 0.1 if hertz else 0.0
    rows = [[-1 / slow, 0, 0], [0, 0, -w * w], [0, 1.0 if hertz else 0.0, -2 * z * w], [1 / slow, 0, w * w]]
    model.coefficients = torch.tensor(rows, dtype=torch.float64)
    return model


def tank_log(dt, model):
    plain = logged(dt, known(1.0, 0.1).signature)

    def _wide(data):
        x, x_next = (torch.cat([0.1 * given[:, :1], given], -1) for given in (data.x, data.x_next))
        return replace(data, x=x, x_next=x_next)

    parts = {"training": _wide(plain.training), "validation": _wide(plain.validation)}
    return replace(plain, signature=model.signature, **parts)


def tank_period(slow, dt, hertz=None):
    model = tank(slow, hertz)
    log = None if dt is None else tank_log(dt, model)
    return suited_period(model, tracking_task(model, {"h": (-0.5, 0.5)}), log)


REGULATED = math.sqrt(1 + 100)
"""By how much the least cost of 100 e^2 + u^2 makes x' = (u - x) / T faster: its pole is -sqrt(1 + 100) / T."""
SETTLED = math.log(20) / REGULATED
"""Part of T after which 5 % of a step are left."""


@pytest.mark.parametrize(("slow", "dt"), [(4000, 5.0), (40, 0.02)])
def test_a_slow_plant_settles_in_the_80_periods_that_a_plan_looks_ahead(slow, dt):
    found, wanted = tank_period(slow, dt), SETTLED * slow / 80
    assert wanted * 0.99 <= found[0] < 1.03 * wanted + dt and found[0] > max(dt, 0.05)
    assert found[0] / dt == pytest.approx(round(found[0] / dt))
    assert found[1].values["cause"] == "settles" and found[1].values["value"] == pytest.approx(80 * wanted, rel=0.02)


def test_a_plant_that_fits_keeps_its_period_and_a_slow_one_without_a_log_gets_two_digits():
    assert tank_period(4.0, 0.02)[0] == pytest.approx(0.04)
    assert tank_period(250, 1.0)[0] == 1.0
    assert tank_period(400, None)[0] == pytest.approx(SETTLED * 400 / 80, rel=0.1)
    assert tank_period(4.0, None)[0] == 0.05


def test_a_longer_period_leaves_a_fifth_of_a_swing():
    """1.49 s would show all of it; the spring swings in 4.02 s."""
    assert tank_period(400, 0.1, 0.25)[0] == pytest.approx(0.8)


def test_a_plant_that_has_to_be_held_keeps_its_period():
    """v' = (p + u) / 900 doubles every 21 s, in an episode of 400 s."""
    model = known(1.0, 0.1)
    rows = [[0.0, 1 / 900], [1.0, 0.0], [0.0, 1 / 900]]
    model.coefficients = torch.tensor(rows, dtype=torch.float64)
    assert suited_period(model, tracking_task(model, {"p": (-0.5, 0.5)}), logged(1.0, model.signature))[0] == 1.0


def growing(rate):
    """Return p' = v, v' = rate^2 (p + u), which grows as exp(rate t)."""
    model = known(1.0, 0.1)
    model.coefficients = torch.tensor([[0.0, rate**2], [1.0, 0.0], [0.0, rate**2]], dtype=torch.float64)
    return model


@pytest.mark.parametrize(
    ("rate", "dt", "seconds"),
    [
        (60.0, 0.001, 0.002),  # doubles in 11.6 ms, of which a quarter is 2.9 samples; ten samples by the log alone
        (60.0, 0.01, 0.01),  # one sample
        (5.0, 0.01, 0.03),  # a quarter of 139 ms
        (3.0, 0.01, 0.05),  # a quarter of 231 ms is more than 50 ms
    ],
)
def test_the_period_of_an_unstable_plant_is_a_quarter_of_the_time_in_which_it_doubles(rate, dt, seconds):
    model = growing(rate)
    found = suited_period(model, tracking_task(model, {"p": (-0.5, 0.5)}), logged(dt, model.signature))
    assert found[0] == pytest.approx(seconds)
    doubles = math.log(2) / abs(rate)
    assert found[0] <= max(dt, doubles / 4)
    cause = "doubling" if dt < doubles / 4 else "sample_doubling"
    assert found[1] == (None if abs(rate) == 3 else chosen(seconds, cause, doubles))


def mapped(a, b, step):
    """Return x[k+1] = a x[k] + b u[k] as a model; its sign changes from step to step where a < 0."""
    model = SindyModel(Signature(("x",), ("-",), ("u",), (1.0,)), ["x", "u"], time="discrete")
    model.library = model.library.with_step(step)
    model.coefficients = torch.tensor([[a - 1], [b]], dtype=torch.float64) / step
    return model


def test_the_period_of_a_difference_equation_without_a_log_is_its_step():
    model = mapped(-0.6, 1.0, 0.3)
    found = suited_period(model, tracking_task(model, {"x": (-0.5, 0.5)}), None)
    assert found[0] == 0.3
    assert found[1] == chosen(0.3, "step", 0)


def test_the_period_of_a_slow_difference_equation_is_as_many_steps_as_a_plan_needs_to_see_it_settle():
    """x[k+1] = x[k] + (u - x) / 4000, every second: as slow as the tank of 4000 s above."""
    model = mapped(1 - 1 / 4000, 1 / 4000, 1.0)
    plain = logged(1.0, known(1.0, 0.1).signature)
    split = {"training": plain.training, "validation": plain.validation}
    first = {name: replace(data, x=data.x[:, :1], x_next=data.x_next[:, :1]) for name, data in split.items()}
    log = replace(plain, signature=model.signature, **first)
    found, wanted = suited_period(model, tracking_task(model, {"x": (-0.5, 0.5)}), log), SETTLED * 4000 / 80
    assert wanted * 0.99 <= found[0] < 1.03 * wanted + 1 and found[0] == round(found[0])


def test_a_plan_begins_at_zero_where_a_log_passes_through_it_and_else_in_its_middle():
    """A state that only touches zero passes through it, too; of one that stays away its median counts."""
    model = known(2.0, 0.2)
    task = tracking_task(model, {"p": (-5.0, 5.0)})
    whole = recorded()
    for low, expected in ((-0.7, 0.0), (0.0, 0.0), (0.3, None), (-1.5, None)):
        p = torch.linspace(low, low + 1.0, len(whole) + 1).double() ** 3
        x = torch.stack((p, 0 * p + 2.0), -1)
        data = replace(whole, x=x[:-1], x_next=x[1:])
        start = as_planned(task, model, Source.of(Recording(data, model.signature), 0.0)).start
        middle = float(np.sort(p[:-1])[(len(p) - 2) // 2]) if expected is None else expected
        torch.testing.assert_close(start.double(), torch.tensor([[middle, 2.0]] * 2).double(), atol=1e-6, rtol=1e-6)
