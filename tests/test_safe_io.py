"""Files and words of others: what is read, what is refused, and that pages hold no HTML of theirs."""

import os
import re

import pytest

from dynasindy import excite
from dynasindy.envs import Aprbs, Channel
from dynasindy.planning import GradientPlanning
from dynasindy.safe_io import (
    DamagedFileError,
    escape_markdown,
    file_name,
    output_folder,
    read_json,
    read_rows,
    read_text,
    remove_leftovers,
    write_json,
    write_text,
)
from dynasindy.sindy import Refinement
from dynasindy.systems import Pendulum


def test_text_records_and_tables_are_read_as_they_stand(tmp_path):
    (tmp_path / "a").write_text("ä\n")
    (tmp_path / "b").write_text('{"x": [1, null]}')
    (tmp_path / "c").write_text('p,q\n1,"a,\n2"\n\n3,\n')
    assert read_text(tmp_path / "a") == "ä\n"
    assert read_json(tmp_path / "b") == {"x": [1, None]}
    assert read_rows(tmp_path / "c") == [{"p": "1", "q": "a,\n2"}, {"p": "3", "q": ""}]


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1]", b"\xff", b"[" * 100_000, b"null", b'{"a": ' + b"9" * 5000 + b"}"]
)
def test_what_is_no_record_is_damaged(tmp_path, content):
    (tmp_path / "f.json").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"f\.json .*damaged") as error:
        read_json(tmp_path / "f.json")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\n\n", b"a,a\n1,2\n", b"a,b\n1\n", b"a\n1,2\n", b'a\n"1', b"a\n\xff\n"])
def test_what_is_no_table_is_damaged(tmp_path, content):
    (tmp_path / "f.csv").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"f\.csv .*damaged"):
        read_rows(tmp_path / "f.csv")


@pytest.mark.parametrize(("row", "cells"), [("1", 1), ("1,2,3,4", 4), ("1,2,3,4,5", 5)])
def test_a_row_of_another_length_is_named_with_what_it_has_and_what_it_may_have(tmp_path, row, cells):
    (tmp_path / "f.csv").write_text(f"a,b,c\n1,2,3\n{row}\n")
    with pytest.raises(DamagedFileError) as error:
        read_rows(tmp_path / "f.csv")
    numbers = re.findall(r"\b\d+\b", str(error.value).replace(str(tmp_path), ""))
    assert numbers == ["2", str(cells), "3"] and "f.csv" in str(error.value)


def test_what_is_no_file_is_not_waited_for(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    for name in ("folder", "pipe", "zeros"):
        with pytest.raises(DamagedFileError, match="is no file"):
            read_text(tmp_path / name)
    with pytest.raises(DamagedFileError, match="symbolic links"):
        read_text(tmp_path / "loop")
    with pytest.raises(FileNotFoundError):
        read_text(tmp_path / "nothing")
    (tmp_path / "long").write_text("abc")
    with pytest.raises(DamagedFileError, match="3 bytes; at most 2"):
        read_text(tmp_path / "long", 2)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", "a\\b", "/x", "~", "-x", "a\n", "a\0", "<b>", "x" * 201, None, 1]
)
def test_a_path_is_no_name(name):
    with pytest.raises(ValueError, match="scenario '"):
        file_name(name, "scenario")


def test_a_folder_of_results_may_be_new_or_old_but_no_link(tmp_path):
    assert output_folder(tmp_path, "evaluation") == tmp_path / "evaluation"
    (tmp_path / "evaluation" / "deep").mkdir(parents=True)
    (tmp_path / "evaluation" / "deep" / "f").write_text("x")
    assert output_folder(tmp_path, "evaluation") == tmp_path / "evaluation"
    (tmp_path / "evaluation" / "deep" / "g").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="g is a link"):
        output_folder(tmp_path, "evaluation")


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
    assert escape_markdown(words) == shown


def test_a_command_writes_where_it_is_told_or_beside_what_it_read(tmp_path):
    file = tmp_path / "controller.json"
    file.touch()
    assert output_folder(tmp_path, "check") == output_folder(file, "check") == tmp_path / "check"
    given = tmp_path / "elsewhere"
    given.mkdir()
    assert output_folder(file, "check", str(given)) == given
    (given / "out.c").symlink_to(file)
    with pytest.raises(ValueError, match="is a link"):
        output_folder(file, "check", str(given))


def test_files_have_the_rights_that_the_user_gives_new_ones(tmp_path):
    before = os.umask(0o027)
    try:
        write_json(tmp_path / "a.json", {"x": 1})
    finally:
        os.umask(before)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == 0o640


def test_a_file_that_stands_where_a_writer_would_begin_stays(tmp_path, monkeypatch):
    monkeypatch.setattr("secrets.token_hex", lambda count: "0" * 2 * count)
    (tmp_path / f".{'0' * 16}.tmp").write_text("of others")
    with pytest.raises(FileExistsError, match=r"a\.txt"):
        write_text(tmp_path / "a.txt", "ours")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["of others"]


def test_what_killed_writers_left_is_removed_and_nothing_else(tmp_path):
    for name in (f".{'0a' * 8}.tmp", ".mine.tmp", "0123456789abcdef.tmp"):
        (tmp_path / name).touch()
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine.tmp", "0123456789abcdef.tmp"]


@pytest.mark.parametrize(
    ("made", "named"),
    [
        (lambda: GradientPlanning(updates="x"), "updates"),
        (lambda: GradientPlanning(), "env"),
        (lambda: Channel("x"), "resolution"),
        (lambda: Refinement(rounds="x"), "rounds"),
        (lambda: Refinement(rows=3), "rows"),
        (lambda: Aprbs(1, duration="x"), "duration"),
        (lambda: GradientPlanning(gain_rang=1), "gain_rang=1; .*'gain_range"),
        (lambda: excite(Pendulum), "plant=.*give Pendulum"),
        (lambda: excite(Pendulum(), noise=float("nan")), "noise=nan"),
    ],
)
def test_what_is_built_of_wrong_arguments_names_one_of_them_in_a_line(made, named):
    with pytest.raises(ValueError, match=rf"^\w+ (has {named}\b|lacks {named};).*$"):
        made()
