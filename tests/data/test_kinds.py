"""What programs and devices do to a log is undone and said: units, clocks, streams, angles that wrap."""

import numpy as np
import pytest

from dynasindy.data.recording import unwrap_angle
from dynasindy.findings import LogError, note, wrong
from dynasindy.identification.identify import LoggedData

ROWS = 400
T = 0.01 * np.arange(ROWS)
ANGLE = 8 * np.sin(1.5 * T) ** 2
COMMAND = 0.7 * np.sin(7 * T) + 0.2 * np.cos(19 * T)


def recording(path, headings, *columns, **settings):
    rows = (",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in np.stack(columns, -1))
    path.write_text("\n".join([headings, *rows]))
    return LoggedData(str(path), **settings).recording(None)


@pytest.mark.parametrize(
    ("headings", "scale"),
    [("t_ms,angle_deg,rate_dps,u_pct", 180 / np.pi), ("t [ms],angle [deg],rate [deg/s],u [%]", 180 / np.pi)],
)
def test_units_at_the_end_of_a_name_count_as_those_in_brackets(tmp_path, headings, scale):
    found = recording(tmp_path / "l.csv", headings, 1000 * T, scale * ANGLE, scale * COMMAND**2, 50 * COMMAND)
    assert found.signature.state_names == ("angle", "rate") and found.signature.state_units == ("rad", "rad/s")
    assert found.transitions.dt == pytest.approx(0.01)
    assert found.transitions.x[:, 0].numpy() == pytest.approx(ANGLE[:-1], abs=1e-8)
    _, angle, _, command = headings.split(",")
    named = LoggedData(str(tmp_path / "l.csv"), [angle], [command]).recording()
    assert (named.signature.state_names, named.signature.input_names) == (("angle",), ("u",))


@pytest.mark.parametrize(
    ("heading", "stamps"),
    [
        ("timestamp", 1_717_156_800_000 + 1000 * T),
        ("timestamp", 1_717_156_800_000_000 + 1e6 * T),
        ("Time(ms)", (65_000 + 1000 * T) % 2**16),
        ("micros", (2**32 - 1_000_000 + 1e6 * T) % 2**32),
        ("time [s]", (86_398 + T) % 86_400),
        ("time", np.floor(np.arange(ROWS) / 2) * 0.02),
    ],
)
def test_clocks_of_devices_give_the_time_between_rows(tmp_path, heading, stamps):
    found = recording(tmp_path / "l.csv", f"{heading},angle,u", np.round(stamps, 4), ANGLE, COMMAND)
    assert found.transitions.dt == pytest.approx(0.01, rel=1e-4) and len(found.transitions) == ROWS - 1
    assert found.transitions.segment.unique().tolist() == [0]


def test_whole_numbers_that_are_hardly_seconds_ask_for_their_unit(tmp_path):
    path = tmp_path / "l.csv"
    with pytest.raises(LogError) as error:
        recording(path, "timestamp,angle,u", 183_254_000 + 1e6 * T, ANGLE, COMMAND)
    assert error.value.finding == wrong("log.whole_time", file=str(path), column="timestamp", step=1e4)
    found = LoggedData(str(path), time="timestamp [us]").recording(None)
    assert found.transitions.dt == pytest.approx(0.01)


def test_rows_of_two_streams_are_one_log(tmp_path):
    """A command in every second row stands until the next; a measurement stands where it was made."""
    odd = np.arange(ROWS) % 2 == 1
    found = recording(
        tmp_path / "l.csv", "time,angle,cmd", T, np.where(odd, ANGLE, np.nan), np.where(odd, np.nan, COMMAND)
    )
    data, rows = found.transitions, np.arange(1, ROWS - 1)
    assert data.x[:, 0].isfinite().tolist() == [bool(k % 2) for k in rows]
    assert data.u[:, 0].numpy() == pytest.approx(COMMAND[rows - rows % 2])


def test_rates_are_known_by_their_headings(tmp_path):
    known = {"a_rad": "w_rad_s"}
    found = recording(tmp_path / "l.csv", "time,a_rad,w_rad_s,u", T, ANGLE, COMMAND**2, COMMAND)
    source = LoggedData(str(tmp_path / "l.csv"), known=known).load(None, None)
    assert source.signature.state_names == found.signature.state_names == ("a", "w")
    assert bool(source.training.x.isfinite().all())
    mapped = LoggedData(str(tmp_path / "l.csv"), {"q": "a_rad", "v": "w_rad_s"}, {"u": "u"}).recording(None)
    assert mapped.signature.state_units == ("rad", "rad/s")


def test_columns_with_a_clock_of_their_own_stand_at_the_times_of_the_first(tmp_path):
    later = T + 0.0037
    found = recording(
        tmp_path / "l.csv",
        "A_time [ms],A_x [m],B_time [ms],B_x [m],u",
        1e3 * T,
        ANGLE,
        1e3 * later,
        np.sin(later),
        COMMAND,
    )
    assert found.signature.state_names == ("A_x", "B_x")
    assert found.transitions.x[1:, 1].numpy() == pytest.approx(np.sin(T[1:-1]), abs=2e-5)


@pytest.mark.parametrize(
    ("unit", "turn"),
    [("rad", 2 * np.pi), ("deg", 360.0), ("-", 2 * np.pi), ("counts", 2.0**10), ("counts", 4000.0), ("ticks", 2.0**32)],
)
@pytest.mark.parametrize("start", [0.0, -0.5])
def test_an_angle_that_wraps_goes_on(unit, turn, start):
    whole = turn * ANGLE / 3
    whole = whole.round() if turn > 360 else whole
    inside, told = (whole - start * turn) % turn + start * turn, []
    found = unwrap_angle("q", np.where(np.arange(ROWS) % 7, inside, np.nan), unit, told)
    seen = np.isfinite(found)
    jumps = int((np.abs(np.diff(inside[seen])) > turn / 2).sum())
    assert told == [note("log.unwrapped", state="q", turn=turn, times=jumps, counts=turn > 360)]
    assert seen.sum() == (np.arange(ROWS) % 7 > 0).sum()
    assert np.ptp(found[seen] - whole[seen]) < 1e-9 * turn


LEVEL = np.interp(T, [0, 1.5, 1.8, 3.3, 3.6, 4], [0, 355, 2, 355, 1, 90])  # of a tank that is emptied


@pytest.mark.parametrize(
    "x", [ANGLE, LEVEL, LEVEL + 200, np.sign(COMMAND) * np.pi, 180 * COMMAND, np.clip(6 * COMMAND, -np.pi, np.pi)]
)
def test_what_moves_within_its_range_stays(x):
    told = []
    assert np.array_equal(unwrap_angle("q", x, "-", told), x) and not told
