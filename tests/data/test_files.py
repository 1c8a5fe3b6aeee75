"""Each format is written by its own library, and gives the numbers of the same log as text."""

import importlib
import sys

import numpy as np
import pandas as pd
import pytest

from dynasindy.findings import note
from dynasindy.identification.identify import LoggedData

ROWS = 300
T = 0.01 * np.arange(ROWS)
ANGLE = np.sin(3 * T)
COMMAND = np.arange(ROWS) // 25 % 3 - 1.0
WORDS = {"time": T, "angle": ANGLE, "u": COMMAND}


def write_mat(path):
    from scipy.io import savemat

    savemat(path, {"t": T[:, None], "angle": ANGLE[:, None], "u": COMMAND[:, None], "gain": 3.0, "title": "swing"})


def write_structure(path):
    """Simulink's structure with time, one of its signals with a label."""
    from scipy.io import savemat

    signals = [{"values": ANGLE[:, None], "label": "angle"}, {"values": COMMAND[:, None], "label": "u"}]
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
            for name, values in (("/angle", ANGLE), ("/u", COMMAND))
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
    assert data.x[:, 0].numpy() == pytest.approx(ANGLE[:-1], abs=1e-12)
    assert data.u[:, 0].numpy() == pytest.approx(COMMAND[:-1], abs=1e-12)


def test_a_row_of_a_sheet_is_told_by_its_number_there(tmp_path):
    pytest.importorskip("openpyxl")
    gap = pd.DataFrame(WORDS).assign(angle=np.where(np.arange(ROWS) == 7, np.nan, ANGLE))
    gap.to_excel(tmp_path / "log.xlsx", index=False)
    findings = LoggedData(str(tmp_path / "log.xlsx")).recording(None).findings
    assert [each.values["line"] for each in findings if each.code == "log.missing"] == [9]  # behind one of headings


def test_arrays_of_other_lengths_are_left_out_and_said(tmp_path):
    np.savez(tmp_path / "log.npz", time=T, angle=ANGLE, u=COMMAND[:-1], trigger=np.arange(7.0))
    found = LoggedData(str(tmp_path / "log.npz")).recording(None)
    assert len(found.transitions) == ROWS - 2
    assert found.findings[1] == note("log.other_lengths", length=300, names=["trigger (7)"])


def test_what_is_no_column_of_real_numbers_is_told_and_text_may_hold_the_time(tmp_path):
    stamps = np.array([f"2025-03-14 09:26:{second:06.3f}" for second in T])
    columns = {"time": stamps, "angle": ANGLE, "u": COMMAND, "z": 1j * ANGLE, "camera": np.zeros((ROWS, 3, 3))}
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
