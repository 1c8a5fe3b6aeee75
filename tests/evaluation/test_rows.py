"""Tables that are carried on, against the text of their files."""

import pytest

from dynasindy.evaluation.rows import append_rows, read_rows, write_rows

COLUMNS = ("name", "value")


def test_headings_stand_once_above_what_is_appended(tmp_path):
    path = tmp_path / "made" / "table.csv"
    append_rows(path, COLUMNS, [{"name": "a, b", "value": 0.1}])
    append_rows(path, COLUMNS, [{"name": "c", "value": ""}])
    assert path.read_bytes() == b'name,value\n"a, b",0.1\nc,\n'
    assert read_rows(path) == [{"name": "a, b", "value": "0.1"}, {"name": "c", "value": ""}]


def test_what_is_written_takes_the_place_of_the_file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old\n1\n")
    path.with_suffix(".tmp").write_text("left by an interruption")
    write_rows(path, COLUMNS, [{"name": "a", "value": 1}])
    assert path.read_text() == "name,value\na,1\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("name,value\na,1\n")
    with pytest.raises(ValueError, match="colour"):
        write_rows(path, COLUMNS, [{"name": "b", "value": 2}, {"colour": "red"}])
    assert path.read_text() == "name,value\na,1\n"


def test_a_file_that_is_not_there_has_no_rows(tmp_path):
    assert read_rows(tmp_path / "none.csv") == []
