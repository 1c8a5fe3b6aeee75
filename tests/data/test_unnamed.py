"""Words for a log without names, read back by what they are for."""

import math
import shlex

import numpy as np
import pytest
import yaml

from dynasindy.data.columns import infer
from dynasindy.data.unnamed import settings_for
from dynasindy.evaluation.identification import Logged


def written(path, headings, order=(0, 1, 2, 3)):
    """Write time, a swing, its rate and a command that is held for nine samples, in some order of columns."""
    t = 0.01 * np.arange(200)
    rows = np.stack([t, np.sin(t) + 0.1, np.cos(9 * t), np.arange(200) // 9 % 3 - 1.0], -1)[:, list(order)]
    path.write_text("\n".join([headings, *(",".join(map(repr, map(float, row))) for row in rows)]))
    return path


def settings(words):
    return {key: yaml.safe_load(value) for key, _, value in (word.partition("=") for word in shlex.split(words))}


@pytest.mark.parametrize(
    ("headings", "order"),
    [
        ("Zeit,Winkel,Rate,Befehl", (0, 1, 2, 3)),
        ("Befehl,Winkel,Rate,Zeit", (3, 1, 2, 0)),
        ("Zeit [s],Winkel [rad],Rate,der Befehl (V)", (0, 1, 2, 3)),
    ],
)
def test_the_first_error_has_all_settings_and_these_read_the_log(tmp_path, headings, order):
    path = written(tmp_path / "log.csv", headings, order)
    with pytest.raises(ValueError, match=r"none of them is called time\. Allowed are") as error:
        Logged(str(path)).recording(None)
    assert "\n" not in str(error.value)
    given = settings(str(error.value).rpartition("to be corrected: ")[2])
    assert given["data.time"] == "Zeit" and given["data.states"] == ["Winkel", "Rate"]
    read = {key.removeprefix("data."): value for key, value in given.items()}
    found = Logged(str(path), **read).recording(None)
    assert set(np.unique(found.transitions.u)) == {-1.0, 0.0, 1.0} and found.transitions.dt == pytest.approx(0.01)


def test_what_headings_tell_is_no_guess(tmp_path):
    path = written(tmp_path / "log.csv", "t,a,b,c")
    with pytest.raises(ValueError, match=r"none of them is called u, u_\.\.\. or input_") as error:
        infer(str(path))
    given = settings(str(error.value).rpartition("to be corrected: ")[2])
    assert given == {"data.time": "t", "data.inputs": ["c"], "data.states": ["a", "b"]}
    named = settings_for(path, ["t", "a", "b", "c"], "t", ["a"])
    assert settings(named) == {"data.time": "t", "data.inputs": ["a"], "data.states": ["b", "c"]}


def test_without_a_column_that_is_held_the_last_one_is_the_input(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,a,b", *(f"{k},{math.sin(k)},{math.cos(k)}" for k in range(20))]))
    assert settings(settings_for(path, ["time", "a", "b"], "time", [])) == {"data.inputs": ["b"], "data.states": ["a"]}


def test_where_nothing_grows_the_heading_of_time_is_left_to_the_user(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a,b\n1,2\n0,3\n1,1\n")
    assert settings(settings_for(path, ["a", "b"], None, []))["data.time"] == "HEADING"
