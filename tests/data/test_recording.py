"""Files are read as they are written, and every kind of bad file costs one line that says what to mend."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from dynasindy.data.columns import Column, infer
from dynasindy.data.recording import LogReader
from dynasindy.findings import Finding, LogError, note

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


def refused(path: str, states=STATES, inputs=INPUTS, **settings) -> Finding:
    with pytest.raises(LogError) as error:
        LogReader(path, states, inputs, **settings).recording()
    assert "\n" not in str(error.value)
    return error.value.finding


def refusal(path: str, states=STATES, inputs=INPUTS, **settings) -> str:
    with pytest.raises(ValueError, match=r".") as error:
        LogReader(path, states, inputs, **settings).recording()
    assert "\n" not in str(error.value)
    return str(error.value)


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
    told = refused(write(tmp_path / "equal.csv", table))
    assert told.code == "log.time_order" and told.values["line"] == 32


def test_a_recording_that_begins_anew_is_two(tmp_path):
    path = Path(write(tmp_path / "two.csv", np.concatenate([log(), log()])))
    lines = path.read_text().splitlines()
    for text in (lines, [*lines[:81], lines[0], *lines[81:]]):  # with the headings once more, too
        path.write_text("\n".join(text))
        data = LogReader(str(path), STATES, INPUTS).recording().transitions
        assert data.segment.bincount().tolist() == [79, 79]
        assert np.array_equal(data.x.numpy(), np.concatenate([log()[:-1, 1:3]] * 2))


def test_a_constant_input_is_refused_by_its_name(tmp_path):
    table = log()
    table[:, 3] = 0.5
    told = refused(write(tmp_path / "log.csv", table))
    assert told.code == "log.constant_input" and (told.values["input"], told.values["value"]) == ("u", 0.5)


def test_too_few_samples_are_refused_with_what_was_left_out(tmp_path):
    table = log(52)
    table[10, 3] = np.nan
    told = refused(write(tmp_path / "log.csv", table))
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


@pytest.mark.parametrize(
    ("heading", "unit", "factor"),
    [
        ("time [{}]", "ms", 1000),
        ("time ({})", "MS", 1000),
        ("time[{}]", "\u00b5s", 1e6),
        ("time [{}]", "min", 1 / 60),
        ("time [{}]", "h", 1 / 3600),
    ],
)
def test_time_is_read_in_its_unit(tmp_path, unit, factor, heading):
    table = log()
    table[:, 0] *= factor
    path = write(tmp_path / "log.csv", table, (heading.format(unit), *HEADINGS[1:]))
    data = LogReader(path, STATES, INPUTS).recording().transitions
    assert data.dt == pytest.approx(0.01) and len(data) == 79


def test_decimal_commas_between_semicolons_are_numbers(tmp_path):
    path = Path(write(tmp_path / "log.csv", log(), separator=";"))
    path.write_text(path.read_text().replace(".", ","))
    assert np.array_equal(LogReader(str(path), STATES, INPUTS).recording().transitions.x.numpy(), log()[:-1, 1:3])
    path.write_text(path.read_text().replace(";", ","))
    assert "headings" in refusal(str(path))


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
    assert refused(paths[:1]).code == "log.constant_input"


def test_files_that_do_not_fit_together_are_refused(tmp_path):
    one = write(tmp_path / "a.csv", log())
    slow = refusal([one, write(tmp_path / "slow.csv", log(dt=0.02))])
    assert "a.csv" in slow and "slow.csv" in slow
    other = write(tmp_path / "b.csv", log(), ("time", "angle", "rate", "volt [mV]"))
    assert "u is in - in" in (told := refusal([one, other])) and "in mV in" in told
    lacking = write(tmp_path / "c.csv", log(), ("time", "angle", "speed", "volt"))
    assert "c.csv" in refusal([one, lacking])
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
        states, inputs, _ = infer(path, inputs=names)
        assert (list(states), inputs) == (["angle", "rate"], {"volt": Column("volt [V]")})
    with pytest.raises(ValueError, match="colum"):
        infer(path, inputs=["current"])


def test_a_counter_of_rows_beside_the_time_is_no_state_unless_it_is_named(tmp_path):
    table = np.concatenate([log(), 3.0 + np.arange(80)[:, None]], -1)
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "u", "row"))
    states, _, found = infer(path)
    assert list(states) == ["angle", "rate"] and found == [note("log.left_out", why="counter", columns=["row"])]
    assert list(infer(path, states=["angle", "row"])[0]) == ["angle", "row"]
    path = write(tmp_path / "log.csv", table, ("Zeit", "angle", "rate", "volt", "row"))
    with pytest.raises(LogError) as error:
        infer(path)
    told = error.value.finding.values
    assert told["left_out"] == [note("log.left_out", why="counter", columns=["row"])]
    assert (told["guess"]["inputs"], told["guess"]["states"]) == (["volt"], ["angle", "rate"])
