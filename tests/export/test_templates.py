"""Templates of C are filled with words that are not looked at again."""

from importlib import resources

import pytest

from dynasindy.export.templates import fill


@pytest.fixture
def template(monkeypatch, tmp_path):
    (tmp_path / "c").mkdir()
    monkeypatch.setattr(resources, "files", lambda package: tmp_path)
    return tmp_path / "c" / "t.c"


def test_lines_stay_where_their_flags_are_set(template):
    template.write_text("a\n@if x\nb\n@if y\nc\n@end\n@end\n@if !x\nd\n@if y\ne\n@end\n@end\nf\n")
    assert fill("t.c", {}).split() == ["a", "d", "f"]
    assert fill("t.c", {}, {"x"}).split() == ["a", "b", "f"]
    assert fill("t.c", {}, {"x", "y"}).split() == ["a", "b", "c", "f"]
    assert fill("t.c", {}, {"y"}).split() == ["a", "d", "e", "f"]


def test_a_word_that_looks_like_a_gap_opens_none(template):
    template.write_text("@one@ @two@\n")
    assert fill("t.c", {"one": "@two@\n@if x", "two": 2}) == "@two@\n@if x 2\n"
    with pytest.raises(KeyError, match="two"):
        fill("t.c", {"one": 1})
