"""What headings say of columns, against what they were written to say."""

import math
from pathlib import Path

import numpy as np
import pytest

from dynasindy.data.columns import Column, infer
from dynasindy.data.csv import CsvLog


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
    states, inputs = infer(path)
    assert states == {"angle": Column("angle [rad]", "rad"), "rate": Column("rate")}
    assert inputs == {"u_1": Column("u_1 [V]", "V")}
    data = CsvLog(path, states, inputs).read()
    assert np.array_equal(data.transitions.x.numpy(), table[:-1, 1:3]) and data.signature.state_units == ("rad", "-")


def test_inputs_may_be_named_and_all_others_are_states(tmp_path):
    path = write(tmp_path / "log.csv", log(), ("time [s]", "angle [rad]", "rate", "volt [V]"))
    for names in (["volt"], ["volt [V]"]):
        states, inputs = infer(path, inputs=names)
        assert (list(states), inputs) == (["angle", "rate"], {"volt": Column("volt [V]", "V")})
    with pytest.raises(ValueError, match="colum"):
        infer(path, inputs=["current"])


def test_headings_without_an_input_are_refused(tmp_path):
    path = write(tmp_path / "log.csv", log())
    with pytest.raises(ValueError, match="columns") as error:
        infer(path)
    assert "\n" not in str(error.value)


def test_a_counter_of_rows_beside_the_time_is_no_state_unless_it_is_named(tmp_path):
    table = np.concatenate([log(), 3.0 + np.arange(80)[:, None]], -1)
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "u", "row"))
    notes = []
    states, _ = infer(path, notes=notes)
    assert list(states) == ["angle", "rate"]
    (note,) = notes
    assert "counter" in note and " row;" in note
    assert list(infer(path, states=["angle", "row"])[0]) == ["angle", "row"]
    path = write(tmp_path / "log.csv", table, ("time", "angle", "rate", "volt", "row"))
    with pytest.raises(ValueError, match="counter") as error:
        infer(path)
    assert str(error.value).endswith("'data.inputs=[volt]' 'data.states=[angle,rate]'")


def test_a_column_of_nan_alone_is_told_and_refused_where_it_is_named(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{0.1 * k},{math.sin(k)},NaN,{math.cos(k)}" for k in range(20)]
    path.write_text("\n".join(["time,angle [rad],speed [rpm],volts [V]", *rows]))
    notes: list[str] = []
    states, inputs = infer(str(path), inputs=["volts"], notes=notes)
    assert list(states) == ["angle"] and list(inputs) == ["volts"]
    assert notes == ["left out, as cells that are empty or NaN are all that they hold: speed"]
    for states_, inputs_ in ((["angle", "speed"], ["volts"]), (None, ["speed [rpm]"])):
        with pytest.raises(ValueError, match="cells"):
            infer(str(path), states=states_, inputs=inputs_)
    worded = [f"{row},{'ON' if k % 3 else 'OFF'}" for k, row in enumerate(rows)]
    path.write_text("\n".join(["time,angle [rad],speed [rpm],volts [V],pump", *worded]))
    infer(str(path), inputs=["volts"], notes=(both := []))
    assert "words" in both[0] and "speed" in both[1] and len(both) == 2
    path.write_text("\n".join(["time,speed [rpm],volts [V]", *(f"{0.1 * k},,{math.cos(k)}" for k in range(20))]))
    with pytest.raises(ValueError, match="hold") as error:
        infer(str(path), inputs=["volts"])
    assert "the command" not in str(error.value)
