"""Files are read as they are written, in the units of actuators and at even times; a bad file costs one line."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from plants import pendulum_rates, scipy_motion

import dynasindy
from dynasindy import envs
from dynasindy.data.columns import Column, infer
from dynasindy.data.recording import LogReader
from dynasindy.data.table import Table
from dynasindy.findings import Finding, LogError, note, weak, wrong
from dynasindy.identification.identify import LoggedData
from dynasindy.identification.source import Source
from dynasindy.systems import BlackBox

STATES = {"q": Column("angle", "rad"), "v": Column("rate", "rad/s")}
INPUTS = {"u": "volt"}
HEADINGS = ("time", "angle", "rate", "volt")


def log(n: int = 80, dt: float = 0.01) -> np.ndarray:
    """A swing q = sin(3 t), its rate, and an input that jumps every five samples."""
    t = dt * np.arange(n)
    return np.stack([t, np.sin(3 * t), 3 * np.cos(3 * t), np.arange(n) // 5 % 3 - 1.0], -1)


def write(path: Path, table, headings=HEADINGS, separator=",") -> str:
    rows = [separator.join("" if math.isnan(v) else repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([separator.join(headings), *rows]) + "\n")
    return str(path)


def refused(path: str | list[str]) -> ValueError:
    with pytest.raises(ValueError, match=r".") as error:
        LogReader(path, STATES, INPUTS).recording()
    assert "\n" not in str(error.value)
    return error.value


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_file_is_read_to_the_last_digit(tmp_path, separator):
    table = log()
    found = LogReader(write(tmp_path / "log.csv", table, separator=separator), STATES, INPUTS).recording()
    data = found.transitions
    assert np.array_equal(data.x.numpy(), table[:-1, 1:3])
    assert np.array_equal(data.x_next.numpy(), table[1:, 1:3])
    assert np.array_equal(data.u.numpy(), table[:-1, 3:])
    assert data.dt == pytest.approx(0.01) and data.segment.unique().tolist() == [0]
    assert found.signature.state_units == ("rad", "rad/s") and found.signature.input_names == ("u",)
    assert found.signature.x_scale == pytest.approx(np.abs(table[:, 1:3]).max(0))
    assert [each.code for each in found.findings] == ["log.time"]


def test_rows_without_an_input_are_skipped_and_those_without_a_state_stay(tmp_path):
    table = log()
    table[20, 1] = table[50, 3] = np.nan
    table[51, 3] = np.inf
    path = write(tmp_path / "log.csv", table)
    found = LogReader(path, STATES, INPUTS).recording()
    skipped = {"rows": 2, "total": 80, "counts": {"volt": 2}, "line": 52, "skipped": True}
    kept = {"rows": 1, "total": 80, "counts": {"angle": 1}, "line": 22, "skipped": False}
    missing = [note("log.missing", **skipped), note("log.missing", **kept)]
    assert [*found.findings][1:] == [*missing, note("log.gaps", count=1)]
    data = found.transitions
    assert len(data) == 79 - 3  # two rows in turn cost themselves and the transition before them
    assert data.segment.unique().tolist() == [0, 1] and data.u[20, 0] == table[20, 3]
    assert data.x.isnan().nonzero().tolist() == [[20, 0]] and data.x_next.isnan().nonzero().tolist() == [[19, 0]]
    inside = data.segment[1:] == data.segment[:-1]
    assert torch.equal(data.x[1:][inside].nan_to_num(), data.x_next[:-1][inside].nan_to_num())


def test_a_sensor_that_is_read_every_fifth_row_keeps_all_rows(tmp_path):
    table = log(300)
    table[np.arange(300) % 5 > 0, 1] = np.nan
    data = LogReader(write(tmp_path / "log.csv", table), STATES, INPUTS).recording().transitions
    assert len(data) == 299 and data.segment.unique().tolist() == [0]
    assert torch.equal(data.x[:, 1], torch.from_numpy(table[:-1, 2]))
    assert data.x[:, 0].isfinite().nonzero().flatten().tolist() == list(range(0, 299, 5))


def test_time_that_does_not_increase_is_refused_at_its_row(tmp_path):
    table = log()
    table[30, 0] = table[29, 0]
    told = refused(write(tmp_path / "equal.csv", table)).finding
    assert told.code == "log.time_order" and told.values["line"] == 32


def test_a_recording_that_begins_anew_is_two(tmp_path):
    path = Path(write(tmp_path / "two.csv", np.concatenate([log(), log()])))
    lines = path.read_text().splitlines()
    for text in (lines, [*lines[:81], lines[0], *lines[81:]]):  # with the headings once more, too
        path.write_text("\n".join(text))
        data = LogReader(str(path), STATES, INPUTS).recording().transitions
        assert data.segment.bincount().tolist() == [79, 79]
        assert np.array_equal(data.x.numpy(), np.concatenate([log()[:-1, 1:3]] * 2))


def test_too_few_samples_are_refused_with_what_was_left_out(tmp_path):
    table = log(52)
    table[10, 3] = np.nan
    told = refused(write(tmp_path / "log.csv", table)).finding
    assert told.code == "log.too_few" and (told.values["count"], told.values["least"]) == (49, 50)
    assert [each.code for each in told.values["left_out"]] == ["log.missing", "log.gaps"]
    assert len(LogReader(write(tmp_path / "enough.csv", log(51)), STATES, INPUTS).recording().transitions) == 50


def test_samples_at_a_stop_are_masked_but_not_a_start_at_rest(tmp_path):
    table = log(200)
    table[:, 1] = np.minimum(table[:, 1], 0.9)
    stuck = int((table[:, 1] == 0.9).sum())
    found = LogReader(write(tmp_path / "log.csv", table), STATES, INPUTS).recording()
    assert found.findings[1:] == (note("log.stop", count=stuck, state="q", value=0.9),)
    assert not bool((found.transitions.x[:, 0] == 0.9).any() or (found.transitions.x_next[:, 0] == 0.9).any())
    resting = np.concatenate([np.zeros((20, 4)), log(100)])
    resting[:, 0], resting[20:, 1] = 0.01 * np.arange(120), 1.5 - np.cos(3 * log(100)[:, 0])
    found = LogReader(write(tmp_path / "rest.csv", resting), {"q": "angle"}, INPUTS).recording()
    assert [each.code for each in found.findings[1:]] == ["log.jumps"]


def test_decimal_commas_between_semicolons_are_numbers(tmp_path):
    path = Path(write(tmp_path / "log.csv", log(), separator=";"))
    path.write_text(path.read_text().replace(".", ","))
    assert np.array_equal(LogReader(str(path), STATES, INPUTS).recording().transitions.x.numpy(), log()[:-1, 1:3])
    path.write_text(path.read_text().replace(";", ","))
    assert "headings" in str(refused(str(path)))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "cp1252"])
def test_the_encodings_of_spreadsheets_are_read(tmp_path, encoding):
    path = Path(write(tmp_path / "log.csv", log(), ("time", "angle [\u00b0]", "rate", "volt")))
    path.write_text(path.read_text(), encoding=encoding)
    data = LogReader(str(path), STATES, INPUTS).recording().transitions
    assert data.x[:, 0].numpy() == pytest.approx(np.radians(log()[:-1, 1]))


def test_inputs_and_rates_are_scaled_by_their_own_factors(tmp_path):
    """Angles in degrees, an input in volts of 24, a second input as it is, a logged rate in rpm."""
    table = np.concatenate([log(), np.cos(np.arange(80.0))[:, None]], -1)
    states = {
        "q": Column("angle", "rad", math.pi / 180),
        "v": Column("rate", "rad/s", 2 * math.pi / 60),
    }
    inputs = {"u": Column("volt", "-", 1 / 24), "w": Column("second", "-", -0.5)}
    path = write(tmp_path / "log.csv", table, (*HEADINGS, "second"))
    found = LogReader(path, states, inputs).recording()
    data = found.transitions
    assert np.allclose(data.x[:, 0], table[:-1, 1] * 0.017453292519943295, rtol=1e-14)
    assert np.allclose(data.x[:, 1], table[:-1, 2] * 0.10471975511965977, rtol=1e-14)
    assert np.allclose(data.u, np.stack([table[:-1, 3] / 24, -0.5 * table[:-1, 4]], -1), rtol=1e-14)
    assert found.signature.state_names == ("q", "v") and found.signature.input_names == ("u", "w")
    assert found.signature.state_units == ("rad", "rad/s")
    largest = [np.radians(table[:, 1]).max(), 3 * 0.10471975511965977]
    assert found.signature.x_scale[:2] == pytest.approx(largest, rel=1e-12)


def test_a_gap_is_more_than_one_and_a_half_sampling_times_and_jitter_up_to_two_percent_is_even(tmp_path):
    table = log(120)
    table[60:, 0] += 0.004  # a step of 1.4 sampling times is resampled
    found = LogReader(write(tmp_path / "log.csv", table), STATES, INPUTS, dt=0.01).recording()
    assert found.findings[1:] == (note("log.resampled", count=1, total=119, dt=0.01),)
    assert found.transitions.segment.unique().tolist() == [0]
    table[60:, 0] += 0.002  # one of 1.6 splits
    found = LogReader(write(tmp_path / "gap.csv", table), STATES, INPUTS, dt=0.01).recording()
    assert found.findings[1:] == (note("log.gaps", count=1),)
    for share, even in ((0.019, True), (0.021, False)):
        table = log(120)
        table[60, 0] += share * 0.01
        found = LogReader(write(tmp_path / "jitter.csv", table), STATES, INPUTS, dt=0.01).recording()
        assert (not found.findings[1:]) is even


@pytest.mark.parametrize(("resting", "masked"), [(4, 0), (5, 5), (9, 9)])
def test_five_equal_samples_at_an_end_are_a_stop_and_four_are_not(tmp_path, resting, masked):
    table = log(100)
    table[:, 1] = table[:, 0]
    table[40 : 40 + resting, 1] = -0.5  # the lower end
    found = LogReader(write(tmp_path / "log.csv", table), STATES, INPUTS).recording()
    stops = [each for each in found.findings if each.code == "log.stop"]
    assert stops == [note("log.stop", count=masked, state="q", value=-0.5)] * bool(masked)
    assert len(found.transitions) == 99 - (masked + 1 if masked else 0)


def starts(path: Path, code: str, t=None, **states: np.ndarray) -> tuple[list[int], list[Finding]]:
    """Return the rows at which a transition starts, told by their inputs, and the findings of a code."""
    n = len(next(iter(states.values())))
    u = np.sin(np.arange(n))
    table = np.stack([0.01 * np.arange(n) if t is None else t, *states.values(), u], -1)
    names = {name: name for name in states}
    found = LogReader(write(path / "log.csv", table, ("time", *names, "volt")), names, INPUTS).recording()
    rows = np.flatnonzero(np.isin(u, found.transitions.u[:, 0]))
    return rows.tolist(), [each for each in found.findings if each.code == code]


def beside(n: int, out) -> list[int]:
    """Return the rows at which a transition starts without those that are left out."""
    return [k for k in range(n - 1) if k not in out and k + 1 not in out]


@pytest.mark.parametrize(("step", "phase"), [(0.0015, 0.3), (0.02, 0.77)])
def test_the_peak_of_an_overshoot_that_an_encoder_reads_in_steps_is_no_stop_and_a_clipped_one_is(tmp_path, step, phase):
    t = 0.01 * np.arange(600)
    swing = np.exp(-0.3 * t) * np.cos(2 * t + phase)
    assert starts(tmp_path, "log.stop", q=step * np.round(swing / step)) == (beside(600, []), [])
    stopped = step * np.round(np.clip(swing, -0.3, None) / step)
    held = np.flatnonzero(stopped == stopped.min())
    assert len(held) > 30 and starts(tmp_path, "log.stop", q=stopped)[0] == beside(600, set(held.tolist()))


def test_a_state_that_no_sensor_sees_is_nan_and_the_rest_is_as_it_was(tmp_path):
    states = {"q": "angle", "level": {"unit": "V"}, "v": Column("rate", "rad/s")}
    found = LogReader(write(tmp_path / "log.csv", log()), states, INPUTS).recording()
    data = found.transitions
    assert bool(data.x[:, 1].isnan().all() and data.x_next[:, 1].isnan().all()) and len(data) == 79
    assert np.array_equal(data.x[:, [0, 2]], log()[:-1, 1:3]) and np.array_equal(data.x_next[:, 0], log()[1:, 1])
    assert found.findings[1:] == (note("log.unmeasured", state="level"),)
    assert found.signature.state_units[1] == "V" and found.signature.x_scale[1] == 1.0


def test_several_files_are_one_recording_with_the_ends_of_all(tmp_path):
    first, second = log(60), log(50)
    first[:, 3], second[:, 3] = 5.0, np.where(np.arange(50) % 7 < 3, -20.0, 0.0)  # still in the first file
    second[20, 1] = np.nan
    paths = [write(tmp_path / "a.csv", first), write(tmp_path / "b.csv", second)]
    found = LogReader(paths, STATES, INPUTS).recording()
    data = found.transitions
    assert data.segment.bincount().tolist() == [59, 49]
    assert torch.equal(data.x[59:].nan_to_num(), torch.from_numpy(second[:-1, 1:3]).nan_to_num())
    assert found.signature.in_own_units(data.u.numpy())[:, 0] == pytest.approx([*first[:-1, 3], *second[:-1, 3]])
    assert data.u.min() == -1.0 and found.signature.input_ends == ((-20.0, 20.0),)
    (lost,) = (each.values for each in found.findings if each.code == "log.missing")
    assert (lost["file"], lost["rows"], lost["total"]) == (paths[1], 1, 50)
    alone = refused(paths[:1]).finding  # refused by its name
    assert alone.code == "log.constant_input" and (alone.values["input"], alone.values["value"]) == ("u", 5.0)


def test_files_that_do_not_fit_together_are_refused(tmp_path):
    one = write(tmp_path / "a.csv", log())
    slow = str(refused([one, write(tmp_path / "slow.csv", log(dt=0.02))]))
    assert "a.csv" in slow and "slow.csv" in slow
    other = write(tmp_path / "b.csv", log(), ("time", "angle", "rate", "volt [mV]"))
    assert "u [-]" in (told := str(refused([one, other]))) and "u [mV]" in told
    lacking = write(tmp_path / "c.csv", log(), ("time", "angle", "speed", "volt"))
    assert "c.csv" in str(refused([one, lacking]))
    with pytest.raises(ValueError, match="path"):
        LogReader([], STATES, INPUTS)


@pytest.mark.parametrize("named", ["T", "T [degC]", "T (degC)", "T[degC]"])
def test_a_column_is_named_with_its_unit_or_without(tmp_path, named):
    path = tmp_path / "log.csv"
    path.write_text("t [s],T [degC],u\n" + "".join(f"{k},{20 + k},{k % 2}\n" for k in range(60)))
    for states in ({"heat": {"name": named, "unit": "degC"}}, {"heat": named}):
        log = LogReader(str(path), states, {"u": "u"}, "t").recording()
        assert log.transitions.x[:, 0].tolist() == list(range(20, 79))
        assert log.signature.state_units == ("degC",)


def lacking(n: int, *rows: slice | int) -> np.ndarray:
    column = np.arange(float(n))
    for each in rows:
        column[each] = np.nan
    return column


def test_a_stretch_of_ten_samples_is_a_moment_and_one_more_is_none(tmp_path):
    gap = note("log.long_gap", rows=10, longest=10, state="a")
    found = starts(tmp_path, "log.long_gap", a=lacking(100, slice(20, 29), slice(60, 70)), b=lacking(100))
    assert found == (beside(100, range(60, 70)), [gap])


@pytest.mark.parametrize("last", [95, 98])
def test_a_recording_begins_and_ends_with_its_states(tmp_path, last):
    a, b = lacking(100, slice(0, 3), slice(last + 1, 100)), lacking(100, slice(0, 5), slice(last, 100))
    assert starts(tmp_path, "log.long_gap", a=a, b=b) == (list(range(3, last)), [])


def test_inputs_may_be_named_and_all_others_are_states(tmp_path):
    path = write(tmp_path / "log.csv", log(), ("time [s]", "angle [rad]", "rate", "volt [V]"))
    for names in (["volt"], ["volt [V]"]):
        states, inputs, _ = infer(Table.read(Path(path)), inputs=names)
        assert (list(states), inputs) == (["angle", "rate"], {"volt": Column("volt [V]")})
    with pytest.raises(ValueError, match="no column 'current'"):
        LogReader(path, inputs=["current"]).recording()


def test_a_counter_of_rows_beside_the_time_is_no_state_unless_it_is_named(tmp_path):
    table = np.concatenate([log(), 3.0 + np.arange(80)[:, None]], -1)
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "u", "row"))
    states, _, found = infer(Table.read(Path(path)))
    assert list(states) == ["angle", "rate"] and found == [note("log.left_out", why="counter", columns=["row"])]
    assert list(infer(Table.read(Path(path)), states=["angle", "row"])[0]) == ["angle", "row"]
    path = write(tmp_path / "log.csv", table, ("Zeit", "angle", "rate", "volt", "row"))
    with pytest.raises(LogError) as error:
        infer(Table.read(Path(path)))
    told = error.value.finding.values
    assert told["left_out"] == [note("log.left_out", why="counter", columns=["row"])]
    assert (told["guess"]["inputs"], told["guess"]["states"]) == (["volt"], ["angle", "rate"])


DT = 0.02


def swung(held, n=1500):
    """Return times with 20 % jitter, angle and rate of a pendulum, and inputs that change every few samples."""
    rng = np.random.default_rng(0)
    t = DT * (np.arange(n) + 0.2 * rng.uniform(-1, 1, n))
    u = np.repeat(rng.uniform(-0.5, 0.5, n // held + 1), held)[:n]
    return t, scipy_motion(pendulum_rates, [0, 0], u[:-1], np.diff(t), 1e-7, 1e-9), u


def resampled(folder, t, u, dt, **states):
    """Return what is read of samples at uneven times, and the even ones."""
    rows = np.stack([t, *states.values(), u], -1)
    np.savetxt(folder / "log.csv", rows, "%.17g", ",", header=",".join(["time", *states, "u"]), comments="")
    found = LoggedData(str(folder / "log.csv"), dt=dt).recording(None)
    assert "log.resampled" in [each.code for each in found.findings] and not found.transitions.segment.any()
    return found, t[0] + dt * np.arange(len(found.transitions))


@pytest.mark.parametrize("held", [1, 5])
def test_a_log_with_a_fifth_of_jitter_tells_the_equations_of_its_plant(tmp_path, held):
    t, x, u = swung(held)
    found, _ = resampled(tmp_path, t, u, DT, a=x[:, 0], w=x[:, 1])
    words = ["a", "w", "u", "sin(a)", "u sin(a)", "w^2", "u cos(a)"]
    model = dynasindy.identify(Source.of(found), words, {"a": "w"}, "one_step", longest_delay=0)
    told = dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True))
    true = {"u": 12.0, "sin(a)": -9.81, "w": -0.5}
    for name, value in told.items():
        assert value == pytest.approx(true.get(name, 0.0), rel=0.01), name


def test_states_between_two_jumps_of_the_input_are_a_smooth_curve_and_bend_at_the_jump(tmp_path):
    """A rate that grows by t cubed, and falls from the jump on: a spline over the jump would swing by a hundredth."""
    rng = np.random.default_rng(1)
    t = 0.1 * (np.arange(60) + 0.2 * rng.uniform(-1, 1, 60))
    jump = t[30]

    def rate(time):
        return np.where(time < jump, time**3 / 8, jump**3 / 8 - 5 * (time - jump))

    found, times = resampled(tmp_path, t, np.where(t < jump, 1.0, -1.0), 0.1, w=rate(t))
    assert found.transitions.x[:, 0].numpy() == pytest.approx(rate(times), abs=1e-9)
    share = (jump - times) / 0.1  # of the step in which the input jumps
    assert found.transitions.u[:, 0].numpy() == pytest.approx(2 * share.clip(0, 1) - 1, abs=1e-9)


def test_under_an_input_that_moves_smoothly_states_are_one_curve(tmp_path):
    """Each sample has another input, and lines between them would be off by a thousandth."""
    t = 0.1 * (np.arange(100) + 0.2 * np.random.default_rng(2).uniform(-1, 1, 100))
    found, times = resampled(tmp_path, t, np.cos(0.5 * t), 0.1, x=np.sin(t))
    assert found.transitions.x[:, 0].numpy() == pytest.approx(np.sin(times), abs=5e-5)


class Task(envs.Task):
    """What every task takes of a signature."""

    def __init__(self, signature):
        super().__init__(signature, 1)

    def initial_state(self, batch, generator):
        raise NotImplementedError

    def observation(self, x, params, t):
        raise NotImplementedError

    def reward(self, x, x_next, params, t_next, at_stop):
        raise NotImplementedError


def written(path, values, heading="valve [%]"):
    """Write a log of a tank that a valve fills, and return its path."""
    rows = [(0.1 * k, math.sin(0.07 * k), float(value)) for k, value in enumerate(values)]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("time [s]", "level [m]", heading), *rows])
    return str(path)


def levels(low, high):
    return np.tile(np.repeat(np.linspace(low, high, 8), 5), 4)


@pytest.mark.parametrize(
    ("low", "high", "rest", "one", "limits"),
    [
        (0, 100, 0, 100, (0, 1)),
        (-100, 0, 0, 100, (-1, 0)),
        (-20, 100, 0, 100, (-0.2, 1)),
        (-100, 100, 0, 100, (-1, 1)),
        (4, 100, 4, 96, (0, 1)),
        (-100, -4, -4, 96, (-1, 0)),
    ],
)
def test_zero_stays_zero_and_what_an_actuator_does_not_reach_are_limits(tmp_path, low, high, rest, one, limits):
    """A heater of 0 to 100 % is off at 0, a valve of 4 to 20 mA is shut at 4 mA."""
    values = levels(low + 3.0, high - 5.0)
    given = {"valve": {"name": "valve", "low": low, "high": high}}
    found = LogReader(written(tmp_path / "log.csv", values), {"level": "level"}, given).recording()
    u, signature = found.transitions.u[:, 0].numpy(), found.signature
    assert u == pytest.approx((values[:-1] - rest) / one)
    assert signature.input_ends == ((rest - one, rest + one),)
    assert (signature.input_limits or ((-1, 1),))[0] == pytest.approx(limits)
    assert signature.in_own_units(found.transitions.u)[:, 0] == pytest.approx(values[:-1])
    assert signature.in_own_units([limits[0]]) == pytest.approx([low])
    ends = {"rest": rest, "one": rest + one, "low": low, "high": high}
    assert found.findings[1] == note("log.scaled", input="valve", unit="%", **ends)
    assert Task(signature).input_limits.flatten().tolist() == pytest.approx(limits)


@pytest.mark.parametrize(
    ("low", "high", "rest", "reach"),
    [
        (20, 60, 0, (20, 60)),
        (-12, 11, 0, (-12, 12)),
        (-30, 70, 0, (-30, 70)),
        (0, 255, 0, (0, 255)),
        (-9, -3, 0, (-9, -3)),
        (60, 80, 60, (60, 80)),  # so far from zero that zero says nothing
    ],
)
def test_a_log_alone_tells_the_range_that_an_input_used(tmp_path, low, high, rest, reach):
    """Zero stays zero, and inputs within what the log has tried."""
    values = levels(low, high)
    path = written(tmp_path / "log.csv", values)
    found = LoggedData(path, inputs=["valve"]).recording(None)
    one = max(abs(end - rest) for end in reach)
    assert found.signature.input_ends == ((rest - one, rest + one),)
    assert rest + one * found.transitions.u[:, 0].numpy() == pytest.approx(values[:-1])
    limits = (found.signature.input_limits or ((-1, 1),))[0]
    assert [rest + one * limit for limit in limits] == pytest.approx(reach)
    given = found.findings[2].values["inputs"]
    assert found.findings[2] == note("log.guessed_ends", inputs=given)
    # An actuator that rests at zero reaches zero, whether the log has tried it or not.
    assert (given["valve"]["low"], given["valve"]["high"]) == (min(*reach, rest), max(*reach, rest))
    again = LoggedData(path, inputs=given).recording(None)
    assert again.signature.input_ends == found.signature.input_ends
    assert torch.equal(again.transitions.u, found.transitions.u)


@pytest.mark.parametrize(("low", "high", "ends"), [(0.05, 0.6, (0, 1)), (-0.9, 0.0, (-1, 0))])
def test_an_input_within_one_that_never_leaves_one_side_is_asked_about(tmp_path, low, high, ends):
    path = written(tmp_path / "log.csv", levels(low, high), "valve")
    found = LoggedData(path, inputs=["valve"]).recording(None)
    assert found.signature.input_ends == () == found.signature.input_limits
    named = {"valve": {"name": "valve", "low": ends[0], "high": ends[1]}}
    assert found.findings[1:] == (note("log.one_sided", input="valve", least=low, most=high, inputs=named),)


@pytest.mark.parametrize(("most", "small"), [(0.04, True), (0.06, False)])
def test_an_input_that_hardly_moved_asks_for_its_ends(tmp_path, most, small):
    """A plan would use all of -1 to 1, of which 0.08 is less than a twentieth."""
    path = written(tmp_path / "log.csv", levels(-most, most), "valve")
    found = LoggedData(path, inputs=["valve"]).recording(None)
    assert [each.severity for each in found.findings if each.code == "log.hardly_moved"] == ["weak"] * small
    if small:
        again = LoggedData(path, inputs=found.findings[1].values["inputs"]).recording(None)
        assert np.abs(again.transitions.u.numpy()).max() == pytest.approx(1.0)
        assert "log.hardly_moved" not in [each.code for each in again.findings]


def test_an_input_with_a_unit_goes_as_far_as_its_log_though_that_is_within_one(tmp_path):
    found = LoggedData(written(tmp_path / "log.csv", levels(-0.3, 0.3), "valve [Nm]"), inputs=["valve"]).recording(None)
    assert found.signature.input_ends == ((-0.3, 0.3),) and "log.guessed_ends" in {f.code for f in found.findings}


def test_motors_that_are_named_alike_but_for_a_number_have_one_range(tmp_path):
    path, steps = tmp_path / "log.csv", levels(0.0, 1.0)
    motors = np.stack([1300 + 500 * steps, 1200 + 300 * steps[::-1], 60 * steps], 1)
    rows = [f"{k / 10},{np.sin(k)},{a},{b},{c}" for k, (a, b, c) in enumerate(motors)]
    path.write_text("\n".join(["time [s],level [m],motor1 [us],motor2 [us],valve [%]", *rows]))
    found = LoggedData([str(path)], inputs=["motor1", "motor2", "valve"]).recording(None)
    assert found.signature.in_own_units(found.transitions.u) == pytest.approx(motors[:-1])
    ends = {each.values["input"]: each.values for each in found.findings if each.code == "log.scaled"}
    assert [(ends[name]["low"], ends[name]["high"]) for name in ends] == [(1200, 1800), (1200, 1800), (0, 60)]


def test_ends_of_minus_one_and_one_keep_the_numbers(tmp_path):
    values = levels(-12.0, 12.0)
    kept = {"valve": {"name": "valve", "low": -1, "high": 1}}
    found = LoggedData(written(tmp_path / "log.csv", values), inputs=kept).recording(None)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert found.findings[1:] == (weak("log.beyond_ends", input="valve", least=-12, most=12),)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (5, 100.5), (0, 99.9)])
def test_ends_that_the_column_goes_beyond_are_refused(tmp_path, low, high):
    path = written(tmp_path / "log.csv", levels(0.0, 100.0))
    log = LogReader(path, {"level": "level"}, {"valve": {"name": "valve", "low": low, "high": high}})
    with pytest.raises(LogError) as error:
        log.recording()
    ends = {"input": "valve", "low": low, "high": high, "least": 0, "most": 100}
    assert error.value.finding == wrong("log.input_ends", file=path, **ends)


PLANT = BlackBox({"level": "m"}, {"valve": {"low": 4, "high": 20, "unit": "mA"}}).signature


@pytest.mark.parametrize(("heading", "given"), [("valve [mA]", "valve"), ("valve", "valve"), ("i [A]", "scaled")])
def test_a_plant_that_is_known_by_names_says_the_ends_of_its_actuators(tmp_path, heading, given):
    """Of 4 to 20 mA a quarter is 8 mA, in whatever part of it the log lies."""
    values = levels(6.0, 12.0)
    inputs = None if given == "valve" else {"valve": {"name": "i", "unit": "mA", "scale": 1000.0}}
    path = written(tmp_path / "log.csv", values if inputs is None else values / 1000, heading)
    found = LoggedData(path, inputs=inputs).recording(PLANT)
    assert found.transitions.u[:, 0].numpy() == pytest.approx((values[:-1] - 4) / 16)
    assert found.signature.input_ends == ((-12.0, 20.0),) and found.signature.input_limits == ((0.0, 1.0),)
    assert found.signature.input_units == ("mA",)


def test_the_numbers_that_a_rig_has_logged_stay_what_they_are(tmp_path):
    values = levels(0.1, 0.5)
    found = LoggedData(written(tmp_path / "log.csv", values, "valve [-]")).recording(PLANT)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert found.signature.in_own_units(found.transitions.u)[:, 0] == pytest.approx(4 + 16 * values[:-1])
    assert [each.code for each in found.findings] == ["log.time"]  # none on the input's ends


@pytest.mark.parametrize(
    ("heading", "given", "message"),
    [
        (
            "valve [mA]",
            {"low": 0, "high": 20},
            "from 0 to 20 and rests at 0 in data.inputs, and from 4 to 20 and at 4 in",
        ),
        ("valve [A]", {}, "is in A in the log, and in mA in system.inputs; give the factor from one to the other"),
        ("valve [mA]", {"scale": 2.0}, "was given low 4 and high 20, its column goes from 12 to 24"),
    ],
)
def test_a_log_that_contradicts_its_plant_is_refused(tmp_path, heading, given, message):
    path = written(tmp_path / "log.csv", levels(6.0, 12.0), heading)
    with pytest.raises(ValueError, match=message):
        LoggedData(path, inputs={"valve": {"name": "valve", **given}}).recording(PLANT)
