"""Files and words of others: what is read, what is refused, and that pages hold no HTML of theirs."""

import json
import os

import pytest

from dynasindy.evaluation.given import (
    DamagedFileError,
    escaped,
    folder_for,
    own_folder,
    plain_name,
    read_cells,
    read_record,
    read_text,
    understood,
)
from dynasindy.sindy.functions import FunctionError, function


def test_text_records_and_tables_are_read_as_they_stand(tmp_path):
    (tmp_path / "a").write_text("ä\n")
    (tmp_path / "b").write_text('{"x": [1, null]}')
    (tmp_path / "c").write_text('p,q\n1,"a,\n2"\n\n3,\n')
    assert read_text(tmp_path / "a") == "ä\n"
    assert read_record(tmp_path / "b") == {"x": [1, None]}
    assert read_cells(tmp_path / "c") == (["p", "q"], [["1", "a,\n2"], ["3", ""]])


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1]", b"\xff", b"[" * 100_000, b"null", b'{"a": ' + b"9" * 5000 + b"}"]
)
def test_what_is_no_record_is_damaged(tmp_path, content):
    (tmp_path / "f.json").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"f\.json is damaged \(.+\); restore it") as error:
        read_record(tmp_path / "f.json")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\n\n", b"a,a\n1,2\n", b"a,b\n1\n", b"a\n1,2\n", b'a\n"1', b"a\n\xff\n"])
def test_what_is_no_table_is_damaged(tmp_path, content):
    (tmp_path / "f.csv").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"f\.csv is damaged \(.+\); restore it"):
        read_cells(tmp_path / "f.csv")


def test_what_is_no_file_is_not_waited_for(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    for name in ("folder", "pipe", "zeros"):
        with pytest.raises(DamagedFileError, match="is no file"):
            read_text(tmp_path / name)
    with pytest.raises(DamagedFileError, match=r"cannot be read: .*symbolic links"):
        read_text(tmp_path / "loop")
    with pytest.raises(FileNotFoundError):
        read_text(tmp_path / "nothing")
    (tmp_path / "long").write_text("abc")
    with pytest.raises(DamagedFileError, match="has 3 bytes; at most 2 are read"):
        read_text(tmp_path / "long", 2)


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        (lambda: {}["cost"], "it lacks 'cost'"),
        (lambda: f"{None:g}", "unsupported format string"),
        (lambda: [][0], "list index out of range"),
        (lambda: float("x\ny"), "could not convert string to float"),
        (lambda: json.loads("["), "Expecting value"),
    ],
)
def test_what_a_reader_stumbles_over_is_one_line(reading, said):
    with pytest.raises(DamagedFileError, match=f"f is damaged .*{said}") as error, understood("f"):
        reading()
    assert "\n" not in str(error.value)


def test_the_file_that_is_damaged_is_named_once():
    with pytest.raises(DamagedFileError, match=r"^inner is damaged"), understood("outer"), understood("inner"):
        raise ValueError("why")
    with pytest.raises(FileNotFoundError), understood("outer"):
        raise FileNotFoundError


def test_a_file_that_needs_a_function_is_not_called_damaged():
    with pytest.raises(FunctionError, match=r"^function 'nowhere' is not known"), understood("file"):
        function("nowhere")


@pytest.mark.parametrize("name", ["step", "xi_dyna_rollouts_800", "lr=1e-3,b=2", "a.b", "Größe", "_x", "two words"])
def test_a_name_is_kept(name):
    assert plain_name(name, "scenario") == name


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", "a\\b", "/x", "~", "-x", "a\n", "a\0", "<b>", "x" * 201, None, 1]
)
def test_a_path_is_no_name(name):
    with pytest.raises(ValueError, match=r"scenario '.*' is no file name; allowed are letters"):
        plain_name(name, "scenario")


def test_a_folder_of_results_may_be_new_or_old_but_no_link(tmp_path):
    assert own_folder(tmp_path, "evaluation") == tmp_path / "evaluation"
    (tmp_path / "evaluation" / "deep").mkdir(parents=True)
    (tmp_path / "evaluation" / "deep" / "f").write_text("x")
    assert own_folder(tmp_path, "evaluation") == tmp_path / "evaluation"
    (tmp_path / "evaluation" / "deep" / "g").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="g is a link"):
        own_folder(tmp_path, "evaluation")


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("<script>alert(1)</script>", "&lt;script>alert(1)&lt;/script>"),
        ("<!-- x", "&lt;!-- x"),
        ("[x](javascript:y)", "\\[x]\\(javascript:y)"),
        ("![x](http://y)", "![x]\\(http://y)"),
        ("[x][y] [x]: z", "\\[x]\\[y] [x]: z"),
        ("a\n\n# b\r\u2028c", "a # b c"),
        ("a < b, a <= b, [1, 2] and (3)", "a < b, a <= b, [1, 2] and (3)"),
    ],
)
def test_words_stay_words(words, shown):
    assert escaped(words) == shown


def test_a_command_writes_where_it_is_told_or_beside_what_it_read(tmp_path):
    file = tmp_path / "controller.json"
    file.touch()
    assert folder_for(None, tmp_path, "check") == folder_for(None, file, "check") == tmp_path / "check"
    given = tmp_path / "elsewhere"
    given.mkdir()
    assert folder_for(str(given), file, "check") == given
    (given / "out.c").symlink_to(file)
    with pytest.raises(ValueError, match="is a link"):
        folder_for(str(given), file, "check")
