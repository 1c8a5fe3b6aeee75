"""A table is read cell by cell as it was written, and every mistake has its line."""

import math
from pathlib import Path

import numpy as np
import pytest

from dynasindy.data.table import Table


def write(folder: Path, text: str) -> Path:
    (folder / "log.csv").write_text(text, newline="")
    return folder / "log.csv"


def test_cells_headings_and_lines_are_those_of_the_file(tmp_path):
    table = Table.read(write(tmp_path, "a [m],b,c\n1,2,3\n\n4,,x\n7\n")).select(["c", "a"])
    assert table.headings == ["c", "a [m]"] and table.frame.index.tolist() == [2, 4, 5]
    assert np.array_equal(table.frame, [[3, 1], [math.nan, 4], [math.nan, 7]], equal_nan=True)


def test_text_in_a_column_of_numbers_is_told_with_its_line(tmp_path):
    """What is empty or nan was not measured, and is no text."""
    table = Table.read(write(tmp_path, "time,a [m],b\n0,1,5\n1,off,nan\n2,,6\n3,ERR 4,7\n4,1,2\n"))
    table = table.select(["time", "a", "b"])
    assert {heading: (w.line, w.text, w.count) for heading, w in table.words.items()} == {"a [m]": (3, "off", 2)}
    assert Table.read(write(tmp_path, "time,a\n2024-02-28 23:59:59,1\n")).select(["time", "a"]).words == {}


@pytest.mark.parametrize(
    ("text", "headings", "lines"),
    [
        ("Motor test 3\na,b,c\n1,2,3\n", "a b c", [3]),
        ("Motor test 3, third run\nSolver; RK4\n\na;b;c\n1,5;2;3\n", "a b c", [5]),
        ("a,b,c\ns,V,-\n1,2,3\n", "a [s],b [V],c", [3]),
        ("a,b,c\n(s),(V),(-)\n\n1,2,3\n", "a [s],b [V],c", [4]),
        ("a,b,c\n,,\n1,2,3\n", "a b c", [3]),
        ("a,b\nx,y\n", "a b", [2]),
        ("Sample rate,100,\na,b,c\n1,2,3\n4,5,6\n", "a b c", [3, 4]),
        ("Run 1,,,\nt,x,v,u\n1,2,3,4\n4,5,6,7\n", "t x v u", [3, 4]),
        ("# a b c\n1 2 3\n4 5 6\n", "a b c", [2, 3]),
        ("time,1,2,u\n1,2,3,4\n4,5,6,7\n", "time 1 2 u", [2, 3]),
        ("a,b,c\n1,N/A,N/A\n2,N/A,N/A\n3,4,5\n", "a b c", [2, 3, 4]),
        ("a,b\nsec,1/min\n1,2\n3,4\n", "a [sec],b [1/min]", [3, 4]),
        ("  a  b (m/s) c\n  1.5  2 3\n  4  5 6\n", "a,b (m/s),c", [2, 3]),
        ("a\tb\t\n1\t2\t\n", "a b", [2]),
        (",a,b\n0,1,2\n1,2,3\n2,3,4\n3,4,5\n4,5,6\n", "a b", [2, 3, 4, 5, 6]),
        (",time,a\n0.5,0,2\n0.7,1,3\n1.2,2,4\n", "time a", [2, 3, 4]),
    ],
)
def test_headings_are_found_below_a_title_above_units_and_between_any_separators(tmp_path, text, headings, lines):
    table = Table.read(write(tmp_path, text))
    assert list(table.headings) == headings.split("," if "," in headings else None)
    assert table.frame.index.tolist() == lines


def test_a_quote_within_a_value_is_a_letter(tmp_path):
    table = Table.read(write(tmp_path, 'a,pipe\n1,5" long\n2,6 long\n')).select(["a"])
    assert table.frame.index.tolist() == [2, 3]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("1,2,3,4\n3,4,5,6\n", "no line of headings"),
        ("a,b\n1,2,3\n", "line 2 has 3 values for 2 headings"),
        ('a,b\n1,2\n3,"4\n5,6\n', "line 3: a quote opens that is not closed"),
        ("a,a\n1,2\n", "2 columns 'a'"),
        ("b,c\n1,2\n", "no column 'a'; allowed are b, c"),
        ("a\0b\n", "is not text"),
    ],
)
def test_what_is_no_table_is_refused_at_its_line(tmp_path, text, said):
    with pytest.raises(ValueError, match=r".") as error:
        Table.read(write(tmp_path, text)).select(["a"])
    assert said in str(error.value) and str(tmp_path) in str(error.value) and "\n" not in str(error.value)


def test_dates_of_the_time_column_become_seconds(tmp_path):
    """Over midnight, with fractions and a zone; of another column they are no numbers."""
    text = "time,a\n2024-02-28 23:59:59.50,1\n2024-02-29T00:00:00.25,2\n2024-02-29 01:00:01+01:00,3\n"
    table = Table.read(write(tmp_path, text)).select(["time", "a"])
    assert np.diff(table.column("time")) == pytest.approx([0.75, 0.75], abs=1e-6)
    with pytest.raises(ValueError, match="words"):
        Table.read(write(tmp_path, text)).select(["a", "time"])


@pytest.mark.parametrize(
    ("headings", "plain"),
    [
        ("a_deg,rate_deg_s,u_pct", ["a [deg]", "rate [deg/s]", "u [%]"]),
        ("a_deg,a_rad,q[0],q[1]", ["a_deg [deg]", "a_rad [rad]", "q_0", "q_1"]),
        ("/joint/q[1],/cmd/u,x_V [V]", ["joint_q_1", "cmd_u", "x_V [V]"]),
    ],
)
def test_the_end_of_a_name_is_its_unit_where_the_name_stays_its_own(tmp_path, headings, plain):
    count = len(plain)
    text = "\n".join([headings, *(",".join(map(str, range(k, k + count))) for k in range(3))])
    assert list(Table.read(write(tmp_path, text)).headings) == plain
    assert Table.read(tmp_path / "log.csv").frame.to_numpy().tolist() == [list(range(k, k + count)) for k in range(3)]
    assert Table.read(tmp_path / "log.csv").select(headings.split(",")).headings == plain
