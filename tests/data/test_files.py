"""Each format, as its own library and as other programs write it, gives the numbers of the plant."""

import importlib
import json
import sys

import numpy as np
import pandas as pd
import pytest

from dynasindy.findings import LogError, note
from dynasindy.identification.identify import LoggedData

ROWS = 300
T = 0.01 * np.arange(ROWS)
SWING = np.sin(3 * T)
STAIRS = np.arange(ROWS) // 25 % 3 - 1.0
WORDS = {"time": T, "angle": SWING, "u": STAIRS}


def write_mat(path):
    from scipy.io import savemat

    savemat(path, {"t": T[:, None], "angle": SWING[:, None], "u": STAIRS[:, None], "gain": 3.0, "title": "swing"})


def write_structure(path):
    """Simulink's structure with time, one of its signals with a label."""
    from scipy.io import savemat

    signals = [{"values": SWING[:, None], "label": "angle"}, {"values": STAIRS[:, None], "label": "u"}]
    savemat(path, {"simout": {"time": T[:, None], "signals": signals}, "tout": T[:, None]})


def write_hdf5(path):
    with importlib.import_module("h5py").File(path, "w") as file:
        for name, values in WORDS.items():
            file[f"recording/{name}"] = values
        file["serial"] = 7


def write_tdms(path):
    nptdms = importlib.import_module("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", name, values) for name, values in WORDS.items()])


def write_mdf(path):
    asammdf = importlib.import_module("asammdf")
    file = asammdf.MDF()
    file.append([asammdf.Signal(values, T, name=name) for name, values in WORDS.items() if name != "time"])
    file.save(path)


def write_bag(path):
    """Messages of an angle and of a command, at the same times, of ROS 1 or 2 by the ending."""
    typesys = importlib.import_module("rosbags.typesys")
    first = path.suffix == ".bag"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if first else typesys.Stores.ROS2_HUMBLE)
    kind = store.types["std_msgs/msg/Float64"]
    folder = path.with_suffix("")
    if first:
        writer = importlib.import_module("rosbags.rosbag1").Writer(path)
    else:
        bags = importlib.import_module("rosbags.rosbag2")
        storage = bags.StoragePlugin.MCAP if path.suffix == ".mcap" else bags.StoragePlugin.SQLITE3
        writer = bags.Writer(folder, version=9, storage_plugin=storage)
    write = store.serialize_ros1 if first else store.serialize_cdr
    with writer:
        topics = [
            (writer.add_connection(name, kind.__msgtype__, typestore=store), values)
            for name, values in (("/angle", SWING), ("/u", STAIRS))
        ]
        for k in range(ROWS):
            for connection, values in topics:
                data = write(kind(float(values[k])), kind.__msgtype__)
                writer.write(connection, 1_700_000_000_000_000_000 + 10_000_000 * k, data)
    if not first:
        next(folder.glob(f"*{path.suffix}")).rename(path)


DATED = pd.DataFrame({**WORDS, "time": pd.Timestamp("2024-05-31 12:00") + pd.to_timedelta(T, unit="s")})
WRITERS = {
    "plain.mat": (write_mat, ()),
    "structure.mat": (write_structure, ()),
    "log.npz": (lambda path: np.savez(path, **WORDS), ()),
    "log.npy": (lambda path: np.save(path, pd.DataFrame(WORDS).to_records(index=False)), ()),
    "log.h5": (write_hdf5, ("h5py",)),
    "log.parquet": (lambda path: pd.DataFrame(WORDS).to_parquet(path), ("pyarrow",)),
    "dates.parquet": (lambda path: DATED.to_parquet(path), ("pyarrow",)),
    "log.feather": (lambda path: pd.DataFrame(WORDS).to_feather(path), ("pyarrow",)),
    "log.xlsx": (lambda path: pd.DataFrame(WORDS).to_excel(path, index=False), ("openpyxl",)),
    "log.tdms": (write_tdms, ("nptdms",)),
    "log.mf4": (write_mdf, ("asammdf",)),
    "log.mcap": (write_bag, ("rosbags",)),
    "log.db3": (write_bag, ("rosbags",)),
    "log.bag": (write_bag, ("rosbags",)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_format_gives_the_log_that_was_written(tmp_path, name):
    write, packages = WRITERS[name]
    for package in packages:
        pytest.importorskip(package)
    write(tmp_path / name)
    found = LoggedData(str(tmp_path / name)).recording(None)
    assert found.signature.state_names == ("angle",) and found.signature.input_names == ("u",)
    data = found.transitions
    assert data.dt == pytest.approx(0.01, rel=1e-6)
    assert data.x[:, 0].numpy() == pytest.approx(SWING[:-1], abs=1e-12)
    assert data.u[:, 0].numpy() == pytest.approx(STAIRS[:-1], abs=1e-12)


def test_a_row_of_a_sheet_is_told_by_its_number_there(tmp_path):
    pytest.importorskip("openpyxl")
    gap = pd.DataFrame(WORDS).assign(angle=np.where(np.arange(ROWS) == 7, np.nan, SWING))
    gap.to_excel(tmp_path / "log.xlsx", index=False)
    findings = LoggedData(str(tmp_path / "log.xlsx")).recording(None).findings
    assert [each.values["line"] for each in findings if each.code == "log.missing"] == [9]  # behind one of headings


def test_arrays_of_other_lengths_are_left_out_and_said(tmp_path):
    np.savez(tmp_path / "log.npz", time=T, angle=SWING, u=STAIRS[:-1], trigger=np.arange(7.0))
    found = LoggedData(str(tmp_path / "log.npz")).recording(None)
    assert len(found.transitions) == ROWS - 2
    assert found.findings[1] == note("log.other_lengths", length=300, names=["trigger (7)"])


def test_typed_dates_are_no_input(tmp_path):
    stamps = np.datetime64("2025-03-14T09:26:00") + np.arange(ROWS).astype("timedelta64[s]")
    np.savez(tmp_path / "log.npz", time=T, angle=SWING, u=stamps)
    with pytest.raises(LogError) as found:
        LoggedData(str(tmp_path / "log.npz")).recording(None)
    finding = found.value.finding
    assert finding.code == "log.no_roles" and finding.values["left_out"][0].values["columns"] == ["u"]


def test_what_is_no_column_of_real_numbers_is_told_and_text_may_hold_the_time(tmp_path):
    stamps = np.array([f"2025-03-14 09:26:{second:06.3f}" for second in T])
    columns = {"time": stamps, "angle": SWING, "u": STAIRS, "z": 1j * SWING, "camera": np.zeros((ROWS, 3, 3))}
    columns["operator"] = np.full(ROWS, "Jörg".encode("latin-1"))
    np.savez(tmp_path / "log.npz", **columns)
    found = LoggedData(str(tmp_path / "log.npz")).recording(None)
    assert found.signature.state_names == ("angle",) and found.transitions.dt == pytest.approx(0.01)
    assert note("log.other_lengths", length=300, names=["z (300)", "camera (2700)"]) in found.findings
    with importlib.import_module("h5py").File(tmp_path / "log.h5", "w") as file:
        for name in ("angle", "u", "operator"):
            file[name] = columns[name]
        file["time"], file["title"] = stamps.astype("S"), "swing"
    found = LoggedData(str(tmp_path / "log.h5")).recording(None)
    assert len(found.transitions) == ROWS - 1 and found.transitions.dt == pytest.approx(0.01)


def test_a_damaged_file_and_a_format_without_its_package_cost_one_line(tmp_path, monkeypatch):
    for ending in ("mat", "npz", "parquet", "h5", "xlsx"):
        (tmp_path / f"log.{ending}").write_bytes(b"neither \x00 nor")
        with pytest.raises(ValueError, match=ending) as error:
            LoggedData(str(tmp_path / f"log.{ending}")).recording(None)
        assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "nptdms", None)
    (tmp_path / "log.tdms").write_bytes(b"TDSm")
    with pytest.raises(ValueError, match="nptdms"):
        LoggedData(str(tmp_path / "log.tdms")).recording(None)


def test_objects_of_a_strangers_file_are_not_executed(tmp_path):
    class Bomb:
        def __reduce__(self):
            return open, (str(tmp_path / "written"), "w")

    np.savez(tmp_path / "log.npz", time=T, x=np.array([Bomb()] * ROWS, dtype=object))
    with pytest.raises(ValueError, match="npz"):
        LoggedData(str(tmp_path / "log.npz")).recording(None)
    assert not (tmp_path / "written").exists()


ANGLE = 8 * np.sin(1.5 * T) ** 2 - 1
RATE = 12 * np.sin(3 * T)
COMMAND = np.where(np.arange(ROWS) // 20 % 2, 0.7, -0.25)
START = pd.Timestamp("2024-05-31 12:00")
TIMES = [START + pd.Timedelta(milliseconds=10 * k) for k in range(ROWS)]


def table(headings, *columns, separator=",", above="", below=()):
    cells = [[c if isinstance(c, str) else f"{c:.6f}" for c in column] for column in columns]
    rows = (separator.join(row) for row in zip(*cells, strict=True))
    return "\n".join([*filter(None, [above]), separator.join(headings), *below, *rows]) + "\n"


def recording(path, text, **settings):
    path.write_text(text, encoding="utf-8")
    return LoggedData(str(path), **settings).recording(None)


def require_truth(found, states=("angle", "rate"), rows=ROWS - 1):
    assert (found.signature.state_names, found.signature.input_names) == (states, ("u",))
    assert found.transitions.dt == pytest.approx(0.01, rel=1e-5) and len(found.transitions) == rows
    assert found.transitions.x[:, 0].numpy() == pytest.approx(ANGLE[:rows], abs=1e-5)
    assert found.transitions.x[:, 1].numpy() == pytest.approx(RATE[:rows], abs=1e-4)
    assert found.transitions.u[:, 0].numpy() == pytest.approx(COMMAND[:rows], abs=1e-3)


@pytest.mark.parametrize(
    ("angle", "rate"),
    [
        ("angle, deg", "rate, deg/s"),
        ("angle / deg", "rate / (deg/s)"),
        ("angle (\u00ba)", "rate (\u00ba/s)"),
        ("angle [deg]", "rate [deg\u00b7s\u207b\u00b9]"),
        ("angle_degrees", "rate_degrees_per_second"),
    ],
)
def test_degrees_are_read_however_a_heading_says_them(tmp_path, angle, rate):
    degrees = (np.degrees(ANGLE), np.degrees(RATE))
    found = recording(tmp_path / "l.csv", table(["time", angle, rate, "u"], T, *degrees, COMMAND, separator=";"))
    require_truth(found)
    assert found.signature.state_units == ("rad", "rad/s")


DATES = ("%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S.%f %p", "%d-%b-%Y %H:%M:%S.%f", "%d.%m.%y %H:%M:%S,%f")
OF_DAYS = ("%H:%M:%S.%f", "%H:%M:%S,%f")
DURATIONS = ("{:g} sec", "0:00:{:g}", "00:{:05.2f}", "0 days 00:00:{:09.6f}")
UNITS = {"s": 1, "T": 1, "ms": 1000, "h": 1 / 3600, "min": 1 / 60}
MIDNIGHT = {day: pd.Timestamp(2025, 4, day, 23, 59, 58) - START for day in (3, 12)}
CLOCKS = [
    *(("time", [time.strftime(form) for time in TIMES]) for form in (*DATES, *OF_DAYS)),
    # Over midnight a day is told from a month.
    *(("time", [(time + MIDNIGHT[day]).strftime(DATES[0]) for time in TIMES]) for day in MIDNIGHT),
    *(("time", [form.format(t) for t in T]) for form in DURATIONS),
    *((name, 1e6 * T) for name in ("TimeUS", "timestampUs", "time_usec", "timestamps [us]")),
    *((unit, [f"{t * scale:.12f}" for t in T]) for unit, scale in UNITS.items()),
]


@pytest.mark.parametrize(("heading", "stamps"), CLOCKS)
def test_a_column_of_times_tells_the_time_between_rows(tmp_path, heading, stamps):
    text = table([heading, "angle", "rate", "u"], stamps, ANGLE, RATE, COMMAND, separator=";")
    require_truth(recording(tmp_path / "l.csv", text))


def test_digits_of_a_date_are_no_seconds(tmp_path):
    stamps = [time.strftime("%Y%m%d%H%M%S.%f") for time in TIMES]
    with pytest.raises(LogError) as refused:
        recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], stamps, ANGLE, RATE, COMMAND))
    assert refused.value.finding.code == "log.no_time_unit"


@pytest.mark.parametrize(
    ("headings", "parts"),
    [(("secs", "nsecs"), 1e9), (("header.stamp.sec", "header.stamp.nanosec"), 1e9), (("Time", "Millisecond"), 1e3)],
)
def test_seconds_and_their_parts_are_one_time(tmp_path, headings, parts):
    rows = np.arange(ROWS)
    whole = [f"12:00:0{k // 100}" if headings[0] == "Time" else str(1717156800 + k // 100) for k in rows]
    text = table([*headings, "angle", "rate", "u"], whole, [f"{k % 100 * parts / 100:.0f}" for k in rows],
                 ANGLE, RATE, COMMAND)  # fmt: skip
    require_truth(recording(tmp_path / "l.csv", text))


def test_rows_that_are_skipped_are_none_that_the_clock_left_out(tmp_path):
    command = ["" if k % 60 == 30 else f"{v:.6f}" for k, v in enumerate(COMMAND)]
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, ANGLE, RATE, command))
    assert found.transitions.dt == pytest.approx(0.01) and len(found.transitions) == ROWS - 1 - 2 * ROWS // 60


@pytest.mark.parametrize(
    ("headings", "day", "clock"),
    [
        (("Date", "Time"), "%Y-%m-%d", "%H:%M:%S.%f"),
        (("Date", "Time"), "%d.%m.%Y", "%H:%M:%S,%f"),
        (("time", "tod"), "%d/%m/%Y", "%I:%M:%S.%f %p"),
    ],
)
def test_a_day_and_a_time_of_day_are_one_time(tmp_path, headings, day, clock):
    stamps = [[time.strftime(form) for time in TIMES] for form in (day, clock)]
    text = table(
        [headings[0], "angle", "rate", "u", headings[1]], stamps[0], ANGLE, RATE, COMMAND, stamps[1], separator=";"
    )
    require_truth(recording(tmp_path / "l.csv", text))


def left_out(found):
    return {each.values["why"]: [*each.values["columns"]] for each in found.findings if each.code == "log.left_out"}


def test_columns_that_follow_from_others_and_labels_are_no_states(tmp_path):
    rows = np.arange(ROWS)
    wanted = np.where(rows // 100 % 2, 0.4, -0.3)
    headings = ["time", "trial", "angle_deg", "angle_rad", "rate", "u", "setpoint", "error", "alarm"]
    text = table(headings, T, rows // 150 + 1.0, np.degrees(ANGLE), ANGLE, RATE, COMMAND, wanted, wanted - ANGLE,
                 rows // 30 % 2 * 1.0)  # fmt: skip
    found = recording(tmp_path / "l.csv", text)
    require_truth(found, states=("angle_deg", "rate"))
    expected = {"reference": ["setpoint"], "label": ["trial", "alarm"], "derived": ["angle_rad", "error"]}
    assert left_out(found) == expected and found.signature.state_units[0] == "rad"
    chosen = recording(tmp_path / "l.csv", text, states=["angle_rad", "error"], inputs=["u"])
    assert chosen.signature.state_names == ("angle_rad", "error")


@pytest.mark.parametrize(
    "function",
    [
        lambda angle, rate, wanted, u: 12 * u * rate,  # a power, which jumps with the input
        lambda angle, rate, wanted, u: -(angle**2) - 0.1 * rate**2 - 0.01 * u**2,
        lambda angle, rate, wanted, u: np.hypot(angle, rate),
        lambda angle, rate, wanted, u: np.abs(wanted - angle),
        lambda angle, rate, wanted, u: (wanted - angle) ** 2,
    ],
)
@pytest.mark.parametrize("digits", [3, 6])
def test_a_function_of_other_columns_is_no_state_wherever_it_stands(tmp_path, function, digits):
    rng = np.random.default_rng(7)
    angle, rate = (np.convolve(rng.normal(0, 1, ROWS + 19), np.ones(20) / 20, "valid") for _ in range(2))
    wanted = np.where(np.arange(ROWS) // 100 % 2, 0.4, -0.3)
    command = np.repeat(rng.uniform(-1, 1, ROWS // 20), 20)
    columns = {"angle": angle, "rate": rate, "setpoint": wanted, "u": command}
    columns = {name: column.round(digits) for name, column in columns.items()}
    value = {"value": function(*columns.values()).round(digits)}
    for order in (columns | value, value | columns):
        found = recording(tmp_path / "l.csv", table(["time", *order], T, *order.values()))
        assert found.signature.state_names == ("angle", "rate") and left_out(found)["derived"] == ["value"]
    free = {"value": (value["value"] + rng.normal(0, 0.01, ROWS)).round(digits)}
    found = recording(tmp_path / "l.csv", table(["time", *columns, *free], T, *columns.values(), *free.values()))
    assert found.signature.state_names == ("angle", "rate", "value")


def test_noise_and_integrals_of_an_error_are_no_states_beside_smooth_ones(tmp_path):
    rng = np.random.default_rng(8)
    wanted = np.repeat(rng.uniform(-1, 1, ROWS // 30), 30)
    sums = {"total": np.cumsum(wanted - ANGLE) * 0.01, "ise": np.cumsum((wanted - ANGLE) ** 2) * 0.01}
    noise = {"loop_us": 2000 + rng.normal(0, 15, ROWS).round(), "crc": rng.integers(0, 256, ROWS)}
    plain = {"angle": ANGLE, "rate": RATE, "setpoint": wanted, "u": COMMAND}
    columns = sums | plain | noise
    found = recording(tmp_path / "l.csv", table(["time", *columns], T, *columns.values()))
    require_truth(found)
    assert (left_out(found)["derived"], left_out(found)["noise"]) == ([*sums], [*noise])
    alone = recording(tmp_path / "l.csv", table(["time", "crc", "u"], T, noise["crc"], COMMAND))
    assert alone.signature.state_names == ("crc",)


def test_samples_of_the_next_row_are_no_states_and_a_state_that_is_held_is_told(tmp_path):
    following = [np.append(column[1:], 5.0) for column in (ANGLE, RATE)]  # an episode ends with the log
    text = table(["time", "angle", "rate", "u", "next_angle", "next_rate"], T, ANGLE, RATE, COMMAND, *following)
    found = recording(tmp_path / "l.csv", text)
    require_truth(found)
    assert "next_angle" in left_out(found)["shifted"]
    level = np.random.default_rng(3).uniform(-1, 1, ROWS)
    for coarse, told in ((level[np.arange(ROWS) // 12 * 12], [["level"]]), (np.round(2 * np.sin(0.3 * T), 1), [])):
        found = recording(tmp_path / "l.csv", table(["time", "angle", "level", "u"], T, ANGLE, coarse, COMMAND))
        assert [each.values["states"] for each in found.findings if each.code == "log.held_states"] == told


def test_headings_that_come_again_are_those_of_the_first_page(tmp_path):
    head, *rows = table(["time", "angle", "rate", "u"], T, ANGLE, RATE, COMMAND).splitlines()
    pages = [line for k in range(0, ROWS, 50) for line in (f"page {k // 50}", head, *rows[k : k + 50])]
    require_truth(recording(tmp_path / "l.csv", "\n".join(pages)))


def test_words_in_many_cells_of_a_column_are_a_warning(tmp_path):
    for every, severity in ((20, "note"), (5, "weak")):
        cells = ["low" if k % every == 3 else f"{x:.6f}" for k, x in enumerate(ANGLE)]
        found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, cells, RATE, COMMAND))
        assert [each.severity for each in found.findings if each.code == "log.words"] == [severity]


def test_states_that_are_nearly_multiples_of_each_other_stay(tmp_path):
    twist = 1e-3 * np.cos(9 * T)
    text = table(["time", "motor", "load", "u"], T, ANGLE, ANGLE + twist, COMMAND)
    assert recording(tmp_path / "l.csv", text).signature.state_names == ("motor", "load")


@pytest.mark.parametrize(
    ("above", "below"),
    [
        ("TOA5,CR1000,1234,pendulum", ("s,rad,rad/s,", ",Smp,Smp,Smp")),
        ("", (",mean,mean,mean",)),
        ("[s],[rad],[rad/s],[-]", ()),
    ],
)
def test_headings_are_the_line_in_which_all_differ(tmp_path, above, below):
    text = table(["time", "angle", "rate", "u"], T, ANGLE, RATE, COMMAND, above=above, below=below)
    require_truth(recording(tmp_path / "l.csv", text))


def test_a_second_clock_and_a_counter_that_lost_rows_are_no_states(tmp_path):
    counter = np.arange(ROWS) % 256
    other = 1.7e9 + T + 1e-3 * np.sin(np.arange(ROWS))
    headings = ["time", "stamp_pc", "seq", "angle", "rate", "u"]
    found = recording(tmp_path / "l.csv", table(headings, T, other, counter, ANGLE, RATE, COMMAND))
    require_truth(found)
    (left,) = [each for each in found.findings if each.values.get("why") == "counter"]
    assert set(left.values["columns"]) == {"stamp_pc", "seq"}


@pytest.mark.parametrize(("value", "level"), [(-9999.0, 0.0), (1e30, 0.0), (50.0, 0.0), (1050.0, 1000.0)])
def test_what_a_sensor_writes_when_it_fails_counts_as_missing(tmp_path, value, level):
    failed = np.arange(40, ROWS, 50)
    angle = ANGLE + level
    angle[failed] = value
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, angle, RATE, COMMAND))
    (lost,) = [each for each in found.findings if each.code in ("log.spikes", "log.code")]
    assert {**lost.values, "state": "angle", "column": "angle"} == {
        "state": "angle", "column": "angle", "count": len(failed), "line": 42, "value": value,
    }  # fmt: skip
    rows = found.transitions.x[:, 0].isfinite().numpy()
    assert np.flatnonzero(~rows).tolist() == failed.tolist()
    assert found.transitions.x[:, 0].numpy()[rows] == pytest.approx(level + ANGLE[:-1][rows], abs=1e-6)


@pytest.mark.parametrize(("lost", "code"), [(-6.0, "log.spikes"), (9999.0, "log.code")])
def test_a_sensor_that_fails_twice_in_a_row_is_missing_twice(tmp_path, lost, code):
    failed = [40, 100, 101, 180]
    angle = ANGLE.copy()
    angle[failed] = lost
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, angle, RATE, COMMAND))
    assert np.flatnonzero(found.transitions.x[:, 0].isnan().numpy()).tolist() == failed
    assert code in {each.code for each in found.findings}


def test_pulses_of_an_input_that_else_hardly_moves_are_no_codes(tmp_path):
    command = np.where(np.arange(ROWS) % 40 == 0, 1.0, 0.05 * np.sin(np.arange(ROWS)))
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, ANGLE, RATE, command))
    assert found.transitions.u[:, 0].numpy() == pytest.approx(command[:-1], abs=1e-6)


def test_a_code_for_a_lost_input_is_no_input(tmp_path):
    command = np.where(np.arange(ROWS) % 50 == 30, -999.0, COMMAND)
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, ANGLE, RATE, command))
    assert found.transitions.u.numpy().min() == pytest.approx(COMMAND.min())
    (told,) = [each for each in found.findings if each.code == "log.code"]
    assert told.values == {"column": "u", "value": -999.0, "count": ROWS // 50, "line": 32}


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_signal_that_jumps_or_is_noisy_keeps_all_its_samples(tmp_path, noise):
    jumps = np.where(np.arange(ROWS) // 7 % 3, 4.0, -2.0) + noise * np.random.default_rng(0).standard_normal(ROWS)
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, jumps, RATE, COMMAND))
    assert "log.spikes" not in {each.code for each in found.findings}


def test_a_plant_that_its_first_row_sets_in_motion_keeps_that_row(tmp_path):
    speed = np.concatenate([[0.0], 5 + 0.01 * RATE[1:-1], [0.0]])
    found = recording(tmp_path / "l.csv", table(["time", "angle", "rate", "u"], T, ANGLE, speed, COMMAND))
    assert found.transitions.x.isfinite().all() and found.transitions.x[0, 1] == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (json.dumps([{"time": t, "u": 1.0} for t in T]), "JSON"),
        ("".join(json.dumps({"time": t, "u": 1.0}) + "\n" for t in T), "JSON"),
        ("<log>\n" + "".join(f"<row t='{t:.2f}' u='1.0'/>\n" for t in T) + "</log>\n", "markup"),
        ("\n".join(",".join([name, *map(str, np.tile(T, 8))]) for name in ("time", "angle", "u")), "rows"),
    ],
)
def test_what_is_no_table_is_refused_as_such(tmp_path, text, said):
    with pytest.raises(ValueError, match=said):
        recording(tmp_path / "l.csv", text)


def frame():
    return pd.DataFrame({"time": T, "angle": ANGLE, "rate": RATE, "u": COMMAND})


def _zoned(path):
    frame().assign(time=[time.tz_localize("Europe/Berlin") for time in TIMES]).to_parquet(path)


def _durations(path):
    frame().drop(columns="time").set_index(pd.to_timedelta(T, "s")).to_parquet(path)


def _sheets(path):
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"rig": ["A"]}).to_excel(book, sheet_name="Info", index=False)
        frame().to_excel(book, sheet_name="Data", index=False)


def _units_of_tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    wave = {"wf_increment": 0.01, "wf_start_offset": 0.0, "wf_samples": ROWS}
    with TdmsWriter(str(path)) as file:
        file.write_segment(
            [
                ChannelObject("g", "angle", np.degrees(ANGLE), {**wave, "unit_string": "deg"}),
                ChannelObject("g", "rate", np.degrees(RATE), {**wave, "unit_string": "deg/s"}),
                ChannelObject("g", "u", COMMAND[::10], {**wave, "wf_increment": 0.1, "wf_samples": ROWS // 10}),
            ]
        )


def _units_of_mdf(path):
    from asammdf import MDF, Signal

    angle, rate = Signal(np.degrees(ANGLE), T, name="angle", unit="deg"), Signal(RATE, T, name="rate", unit="rad/s")
    with MDF() as file:
        file.append([angle, rate, Signal(COMMAND, T, name="u")])
        file.save(path, overwrite=True)


def _units_of_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in {**frame(), "angle": np.degrees(ANGLE)}.items():
            file[name] = values
        file["angle"].attrs["unit"] = "deg"


def _fields_of_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        file["log"] = frame().to_records(index=False)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("l.parquet", _zoned),
        ("l.parquet", _durations),
        ("l.xlsx", _sheets),
        ("l.tdms", _units_of_tdms),
        ("l.mf4", _units_of_mdf),
        ("l.h5", _units_of_hdf5),
        ("l.h5", _fields_of_hdf5),
    ],
)
def test_containers_tell_times_units_and_which_sheet_holds_the_log(tmp_path, name, write):
    write(tmp_path / name)
    require_truth(LoggedData(str(tmp_path / name)).recording(None))


@pytest.mark.parametrize("reference", [0.3 + 0 * np.arange(400.0), np.repeat([0.2, -0.4, 0.5, 0.0], 100)])
def test_a_state_that_an_exact_feedback_was_made_of_stays_one(tmp_path, reference):
    """Of an input and a reference it is a sum of multiples, as the command is its own."""
    t = 0.01 * np.arange(400)
    place, path = np.sin(7 * t) * np.exp(-t), tmp_path / "log.csv"
    np.savetxt(
        path,
        np.stack([t, place, np.gradient(place, t), reference, 2 * (reference - place)], -1).round(6),
        delimiter=",",
        header="time,place,speed,reference,u",
        comments="",
    )
    found = LoggedData(str(path)).recording()
    assert (found.signature.state_names, found.signature.input_names) == (("place", "speed"), ("u",))
