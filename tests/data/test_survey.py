"""What a first look at a file says of its columns, against what was written into it."""

from pathlib import Path

import pytest

from dynasindy.data.headings import summarise_columns


def write(folder: Path, text: str) -> Path:
    (folder / "log.csv").write_text(text, newline="")
    return folder / "log.csv"


def test_a_heading_has_a_number_below_it_or_is_left_out(tmp_path):
    file = write(tmp_path, "a,b,c,d\nx,,1,\ny,,2,5\n")
    assert summarise_columns(file).numeric == ("c", "d") and summarise_columns(file).headings == ("a", "b", "c", "d")


def test_a_heading_that_stands_twice_is_refused_whatever_its_units(tmp_path):
    with pytest.raises(ValueError, match="'b' more than once"):
        summarise_columns(write(tmp_path, "a,b [m],b [s]\n1,2,3\n"))


def test_an_index_needs_no_heading_but_other_numbers_do(tmp_path):
    assert summarise_columns(write(tmp_path, ",a,b\n0,1,2\n")).numeric == ("a", "b")
    with pytest.raises(ValueError, match="heading"):
        summarise_columns(write(tmp_path, "a,,b\n0,1,2\n"))


def test_a_column_of_one_number_never_changes_and_a_column_of_words_is_told_by_its_first_one(tmp_path):
    """What is empty or nan is no word, and one other number, however late, is a change."""
    rows = [f"{k},5,1.0,{k == 7:d},,{'OFF' if k else 'ON'},{'nan' if k < 3 else 'late'}" for k in range(8)]
    look = summarise_columns(write(tmp_path, "\n".join(["t,still [V],same,last,none,word,text", *rows])))
    assert look.still == {"still [V]": 5.0, "same": 1.0} and look.numeric == ("t", "still [V]", "same", "last")
    assert look.worded == {"word": "ON", "text": "late"} and look.dated == ()


def test_a_column_of_dates_is_told_from_one_of_words(tmp_path):
    text = "a,when,since,word\n1,31.05.2024 12:00:00,2024-05-31,31.13.2024 12:00\n"
    assert summarise_columns(write(tmp_path, text)).dated == ("when", "since")


def test_a_column_that_grows_by_one_in_each_row_counts(tmp_path):
    """A cell that is missing does not stop a counter; a jump of two, half a step and one row alone are none."""
    rows = [
        ",".join(map(str, (0.5 * k, 7 + k, "" if k == 4 else float(k), k + (k > 6), 2 * k, "" if k else 3, 9 - k, 4)))
        for k in range(9)
    ]
    look = summarise_columns(write(tmp_path, "\n".join(["half,row,gap [-],jump,even,once,down,still", *rows])))
    assert look.counting == ("row", "gap [-]") and set(look.still) == {"once", "still"}
    assert summarise_columns(write(tmp_path, "a,b\n1,5\n2,6\n3,7\n")).counting == ()  # three rows may do so by chance
