"""What programs and devices do to a log is undone and said: units, clocks, streams, angles that wrap."""

import numpy as np
import pytest

from dynasindy.findings import LogError, note, wrong
from dynasindy.identification.identify import LoggedData

ROWS = 400
T = 0.01 * np.arange(ROWS)
ANGLE = 8 * np.sin(1.5 * T) ** 2
COMMAND = 0.7 * np.sin(7 * T) + 0.2 * np.cos(19 * T)


def recording(path, headings, *columns, **settings):
    rows = (",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in np.stack(columns, -1))
    return of_lines(path, headings, *rows, **settings)


def of_lines(path, *lines, **settings):
    path.write_text("\n".join(lines))
    return LoggedData(str(path), **settings).recording(None)


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
    assert error.value.finding == wrong("log.no_time_unit", file=str(path), column="timestamp", step=1e4)
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
    found = recording(tmp_path / "l.csv", "time,a_rad,w_rad_s,u", T, ANGLE, np.sin(COMMAND), COMMAND)
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
def test_an_angle_that_wraps_goes_on(tmp_path, unit, turn, start):
    whole = turn * ANGLE / 3
    whole = whole.round() if turn > 360 else whole
    inside = np.where(np.arange(ROWS) % 7, (whole - start * turn) % turn + start * turn, np.nan)
    found = recording(tmp_path / "l.csv", "time,q,u", T, inside, COMMAND, states={"q": {"name": "q", "unit": unit}})
    jumps = int((np.abs(np.diff(inside[np.isfinite(inside)])) > turn / 2).sum())
    assert note("log.unwrapped", state="q", turn=turn, times=jumps, counts=turn > 360) in found.findings
    x = found.transitions.x[:, 0].numpy()
    seen = np.isfinite(x)
    assert seen.sum() == np.isfinite(inside[1:-2]).sum() and np.ptp(x[seen] - whole[1:-2][seen]) < 1e-9 * turn


@pytest.mark.parametrize("unit", ["-", "mm"])
@pytest.mark.parametrize("turn", [1000.0, 400.0, 1.0, 437.5, 628.3])
@pytest.mark.parametrize("start", [0.0, -0.5])
def test_a_place_that_jumps_by_its_range_goes_on_whatever_its_unit_and_range(tmp_path, unit, turn, start):
    for whole in (turn * ANGLE / 3, turn * (T + 0.2 * ANGLE)):  # to either side, or to one
        inside = (whole - start * turn) % turn + start * turn
        found = recording(tmp_path / "l.csv", f"time,q [{unit}],u", T, inside, COMMAND)
        assert [each.values["turn"] for each in found.findings if each.code == "log.unwrapped"] == [turn]
        assert np.ptp(found.transitions.x[:, 0].numpy() - whole[:-1]) < 1e-9 * turn


def test_what_is_emptied_or_set_anew_stays_and_is_told_with_the_setting_that_unwraps_it(tmp_path):
    level = np.zeros(ROWS)
    for k in range(1, ROWS):
        level[k] = level[k - 1] + 1.7 + 0.5 * np.sin(k / 30)
        level[k] = 0.0 if level[k] > 100 else level[k]
    moved = ANGLE + 20.0 * (np.arange(ROWS) > 150)
    for column, times, row in ((level, 6, 1 + (np.diff(level) < 0).argmax()), (moved, 1, 151)):
        found = recording(path := tmp_path / "l.csv", "time,x [mm],u", T, column, COMMAND)
        assert np.array_equal(found.transitions.x[:, 0].numpy(), column[:-1])
        (told,) = (each for each in found.findings if each.code == "log.jumps")
        assert (told.severity, told.values["times"], told.values["after"]) == ("weak", times, pytest.approx(T[row]))
        if times > 1:
            turned = LoggedData(str(path), states=told.values["states"], inputs=["u"]).recording(None)
            assert "log.unwrapped" in [each.code for each in turned.findings]


LEVEL = np.interp(T, [0, 1.5, 1.8, 3.3, 3.6, 4], [0, 355, 2, 355, 1, 90])  # of a tank that is emptied


@pytest.mark.parametrize(
    "x", [ANGLE, LEVEL, LEVEL + 200, np.sign(COMMAND) * np.pi, 180 * COMMAND, np.clip(6 * COMMAND, -np.pi, np.pi)]
)
def test_what_moves_within_its_range_stays(tmp_path, x):
    found = recording(tmp_path / "l.csv", "time,q,u", T, x, COMMAND)
    assert "log.unwrapped" not in [each.code for each in found.findings]
    assert np.isin(found.transitions.x[:, 0].numpy(), x).all()


def _require_truth(found, rows=ROWS - 1):
    assert (found.signature.state_names, found.signature.input_names) == (("angle", "rate"), ("u",))
    assert found.transitions.dt == pytest.approx(0.01, rel=1e-3) and len(found.transitions) >= rows
    assert found.transitions.x[:30, 0].numpy() == pytest.approx(ANGLE[:30], abs=1e-4)


RATE = 12 * np.sin(3 * T)


@pytest.mark.parametrize(
    ("heading", "epoch", "per_second"),
    [
        ("FILETIME", 11_644_473_600, 1e7),
        ("Ticks", 62_135_596_800, 1e7),
        ("JD", 2_440_587.5 * 86400, 1 / 86400),
        ("Date", 25_569 * 86400, 1 / 86400),
        ("Date", 719_529 * 86400, 1 / 86400),
        ("ts", 0, 1e3),
    ],
)
def test_a_time_is_known_by_numbers_that_only_a_date_can_be(tmp_path, heading, epoch, per_second):
    stamps = (epoch + 1_741_944_413 + 60 * T) * per_second
    found = recording(tmp_path / "l.csv", f"{heading},angle,rate,u", stamps, ANGLE, RATE, COMMAND)
    assert found.transitions.dt == pytest.approx(0.6, rel=1e-2) and found.signature.state_names == ("angle", "rate")


def test_a_counter_of_ticks_that_overflows_is_the_time_where_the_period_is_given(tmp_path):
    ticks = (2**32 - 5_000_000 + 480_000 * np.arange(ROWS)) % 2**32
    _require_truth(recording(tmp_path / "l.csv", "ticks,angle,rate,u", ticks, ANGLE, RATE, COMMAND, dt=0.01))


@pytest.mark.parametrize(
    "order",
    [
        np.arange(ROWS)[::-1],
        np.r_[0:100, 200:300, 100:200, 300:ROWS],
        np.r_[0:50, 51, 50, 52:ROWS],
        np.r_[0:200, 190:ROWS],
    ],
)
def test_rows_that_came_late_or_twice_or_the_newest_first_are_put_in_order(tmp_path, order):
    columns = (column[order] for column in (T, ANGLE, RATE, COMMAND))
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", *columns)
    _require_truth(found)
    assert "log.sorted" in {each.code for each in found.findings}


def test_a_clock_that_was_set_back_is_refused(tmp_path):
    with pytest.raises(LogError) as error:
        recording(tmp_path / "l.csv", "time,angle,rate,u", T - 0.503 * (T > 2), ANGLE, RATE, COMMAND)
    assert error.value.finding.code == "log.time_order"


def test_words_of_a_switch_are_an_input(tmp_path):
    on = COMMAND > 0
    rows = (f"{t:.2f};{a:.6f};{r:.6f};{'ON' if u else 'OFF'}" for t, a, r, u in zip(T, ANGLE, RATE, on, strict=True))
    found = of_lines(tmp_path / "l.csv", "time;angle;rate;u", *rows)
    _require_truth(found)
    assert found.transitions.u[:, 0].tolist() == on[:-1].tolist()


def test_commands_between_two_samples_and_sensors_that_take_turns_leave_the_period_of_the_samples(tmp_path):
    times = np.sort(np.concatenate([T, T + 0.003, T + 0.0005]))
    turn = np.tile([0, 2, 1], ROWS)
    angle, rate, command = (
        np.where(turn == k, np.repeat(v, 3), np.nan) for k, v in enumerate((ANGLE, 12 * np.sin(3 * T + 0.009), COMMAND))
    )
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", times, angle, rate, command)
    assert found.transitions.dt == pytest.approx(0.01)
    x = found.transitions.x.numpy()
    assert np.isfinite(x).mean() > 0.95
    assert np.nanmedian(np.abs(np.diff(x[:, 0]) / 0.01 - x[:-1, 1])) < 0.4


def test_a_slower_clock_of_a_column_leaves_rows_without_it(tmp_path):
    cells = [f"{t:.3f},{a:.6f}" for t, a in zip(T, ANGLE, strict=True)]
    slow = [f",{t:.3f},{u:.4f}" for t, u in zip(T[::10], COMMAND[::10], strict=True)] + [",,"] * ROWS
    rows = (a + b for a, b in zip(cells, slow))
    found = of_lines(tmp_path / "l.csv", "time_angle,angle,time_u,u", *rows)
    assert found.transitions.u[:, 0].numpy() == pytest.approx(np.repeat(COMMAND[::10], 10)[:-1], abs=1e-4)


def test_what_jumps_with_an_input_is_no_state(tmp_path):
    command = np.where(np.arange(ROWS) // 15 % 2, 0.7, -0.4)
    push = 8 * command + np.sin(T)
    found = recording(tmp_path / "l.csv", "time,angle,rate,push,u", T, ANGLE, RATE, push, command)
    _require_truth(found)
    assert [each.values["why"] for each in found.findings if each.code == "log.left_out"] == ["direct"]


def test_of_two_rows_at_an_event_the_second_stays(tmp_path):
    command = np.where(np.arange(ROWS) // 10 % 2, 0.7, -0.4)
    events = np.flatnonzero(np.diff(command)) + 1
    rows = np.sort(np.r_[np.arange(ROWS), events])
    before = np.append(rows[1:] == rows[:-1], False)
    u = np.where(before, command[rows - 1], command[rows])
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", T[rows], ANGLE[rows], RATE[rows], u)
    _require_truth(found)
    assert found.transitions.u[:, 0].numpy() == pytest.approx(command[:-1])


@pytest.mark.parametrize(
    ("headings", "names", "units"),
    [
        ('time;"angle, deg (S/N: 17)";"rate, deg/s (S/N: 18)";u', ("angle", "rate"), ("rad", "rad/s")),
        ("time;angle;der(angle);u", ("angle", "der_angle"), ("-", "-")),
        ("time;x['angle'];x['rate'];u", ("x_angle", "x_rate"), ("-", "-")),
    ],
)
def test_what_stands_in_brackets_and_is_no_unit_belongs_to_the_name(tmp_path, headings, names, units):
    rows = (";".join(map(str, row)) for row in zip(T, ANGLE, RATE, COMMAND, strict=True))
    signature = of_lines(tmp_path / "l.csv", headings, *rows).signature
    assert (signature.state_names, signature.state_units) == (names, units)


def test_a_switch_that_is_missing_now_and_then_is_one(tmp_path):
    words = ["" if k % 50 == 7 else "OPEN" if k // 20 % 2 else "CLOSED" for k in range(ROWS)]
    rows = (f"{t:.2f},{a:.6f},{r:.6f},{u}" for t, a, r, u in zip(T, ANGLE, RATE, words, strict=True))
    found = of_lines(tmp_path / "l.csv", "time,angle,rate,u", *rows)
    assert set(found.transitions.u[:, 0].tolist()) == {0.0, 1.0}


@pytest.mark.parametrize("apart", [0.0, 0.002])
def test_rows_of_a_time_a_name_and_a_value_have_a_column_a_name(tmp_path, apart):
    rows = (
        f"{t + k * apart:.4f},{name},{value:.6f}"
        for t, *values in zip(T, ANGLE, RATE, COMMAND, strict=True)
        for k, (name, value) in enumerate(zip(("angle", "rate", "u"), values, strict=True))
    )
    found = of_lines(tmp_path / "l.csv", "time,signal,value", *rows)
    if not apart:
        _require_truth(found)
    assert (found.signature.state_names, found.signature.input_names) == (("angle", "rate"), ("u",))
    assert found.transitions.dt == pytest.approx(0.01) and len(found.transitions) >= ROWS - 3
    assert found.transitions.x.isfinite().double().mean() > 0.95
