"""What headings say of columns, against what they were written to say."""

import math
from pathlib import Path

import numpy as np
import pytest

from dynasindy.data.columns import Column, infer
from dynasindy.data.recording import LogReader
from dynasindy.findings import LogError, note, wrong


def log(n: int = 80, dt: float = 0.01) -> np.ndarray:
    """A swing, its rate, and an input that jumps every five samples."""
    t = dt * np.arange(n)
    return np.stack([t, np.sin(3 * t), 3 * np.cos(3 * t), np.arange(n) // 5 % 3 - 1.0], -1)


def write(path: Path, table, headings=("time", "angle", "rate", "volt")) -> str:
    rows = [",".join("" if math.isnan(v) else repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([",".join(headings), *rows]) + "\n")
    return str(path)


def test_without_a_map_the_headings_say_what_is_a_state_and_what_an_input(tmp_path):
    table = np.concatenate([log(), log()[:, 1:2], log()[:, 1:2] * math.nan], -1)
    headings = ("time [s]", "angle [rad]", "rate", "u_1 [V]", "reference_angle", "comment")
    path = write(tmp_path / "log.csv", table, headings)
    data = LogReader(path).recording()
    assert data.signature.state_names == ("angle", "rate") and data.signature.input_names == ("u_1",)
    assert data.signature.input_units == ("V",)
    assert np.array_equal(data.transitions.x.numpy(), table[:-1, 1:3]) and data.signature.state_units == ("rad", "-")


def test_inputs_may_be_named_and_all_others_are_states(tmp_path):
    path = write(tmp_path / "log.csv", log(), ("time [s]", "angle [rad]", "rate", "volt [V]"))
    for names in (["volt"], ["volt [V]"]):
        states, inputs = infer(path, inputs=names)
        assert (list(states), inputs) == (["angle", "rate"], {"volt": Column("volt [V]")})
    with pytest.raises(ValueError, match="colum"):
        infer(path, inputs=["current"])


def test_headings_without_an_input_are_refused(tmp_path):
    path = write(tmp_path / "log.csv", log())
    with pytest.raises(LogError) as error:
        infer(path)
    assert error.value.finding.code == "log.no_roles" and error.value.finding.values["lacks"] == "inputs"
    assert "\n" not in str(error.value)


def test_a_counter_of_rows_beside_the_time_is_no_state_unless_it_is_named(tmp_path):
    table = np.concatenate([log(), 3.0 + np.arange(80)[:, None]], -1)
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "u", "row"))
    states, _ = infer(path, findings=(found := []))
    assert list(states) == ["angle", "rate"] and found == [note("log.counters", columns=["row"])]
    assert list(infer(path, states=["angle", "row"])[0]) == ["angle", "row"]
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "volt", "row"))
    with pytest.raises(LogError) as error:
        infer(path)
    told = error.value.finding.values
    assert told["left_out"] == [note("log.counters", columns=["row"])]
    assert (told["guess"]["inputs"], told["guess"]["states"]) == (["volt"], ["angle", "rate"])


def test_a_column_of_nan_alone_is_told_and_refused_where_it_is_named(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{0.1 * k},{math.sin(k)},NaN,{math.cos(k)}" for k in range(20)]
    path.write_text("\n".join(["time,angle [rad],speed [rpm],volts [V]", *rows]))
    empty = note("log.empty_columns", columns=["speed"])
    states, inputs = infer(str(path), inputs=["volts"], findings=(found := []))
    assert list(states) == ["angle"] and list(inputs) == ["volts"] and found == [empty]
    for states_, inputs_ in ((["angle", "speed"], ["volts"]), (None, ["speed [rpm]"])):
        with pytest.raises(LogError) as error:
            infer(str(path), states=states_, inputs=inputs_)
        assert error.value.finding == wrong("log.column_without_numbers", file=str(path), column="speed")
    worded = [f"{row},{'ON' if k % 3 else 'OFF'}" for k, row in enumerate(rows)]
    path.write_text("\n".join(["time,angle [rad],speed [rpm],volts [V],pump", *worded]))
    infer(str(path), inputs=["volts"], findings=(both := []))
    assert both == [note("log.text_columns", columns={"pump": "OFF"}), empty]
    path.write_text("\n".join(["time,speed [rpm],volts [V]", *(f"{0.1 * k},,{math.cos(k)}" for k in range(20))]))
    with pytest.raises(LogError) as error:
        infer(str(path), inputs=["volts"])
    told = error.value.finding
    assert told.code == "log.nothing_moves" and told.values["driven"] and told.values["left_out"] == [empty]
