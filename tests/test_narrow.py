"""Tables on narrow terminals: every cell is still there, beside its name."""

import pytest

from dynasindy.narrow import is_table, narrowed

TABLE = [
    "| setting | seeds | return | commit |",
    "| --- | --- | --- | --- |",
    "| direct | 3 | 2.5 [1, 3] | abc |",
    r"| a\|b | 12 | 7 | def |",
    "| oracle |  | never | abc or def |",
]


def test_a_table_that_fits_stays_markdown():
    assert narrowed(TABLE, 40) == TABLE


def test_a_wider_one_has_its_rows_side_by_side_as_far_as_they_fit():
    assert narrowed(TABLE, 30) == [
        "setting  direct      a|b",
        "seeds    3           12",
        "return   2.5 [1, 3]  7",
        "commit   abc         def",
        "",
        "setting  oracle",
        "seeds",
        "return   never",
        "commit   abc or def",
    ]


@pytest.mark.parametrize("columns", range(12, 45))
def test_no_line_is_longer_than_the_terminal_and_no_cell_is_lost(columns):
    found = narrowed(TABLE, columns)
    assert max(map(len, found)) <= max(columns, 12)
    words = " ".join(found).replace(r"\|", "|").split()
    for line in (TABLE[0], *TABLE[2:]):
        for word in line.replace(r"\|", "/").replace("|", " ").replace("/", "|").split():
            assert word in words


def test_a_table_without_rows_is_its_names():
    assert narrowed(TABLE[:2], 12) == ["setting", "seeds", "return", "commit"]


def test_a_table_has_a_rule_in_its_second_line_and_rows_as_long_as_its_names():
    assert is_table(TABLE) and is_table(TABLE[:3])
    assert not any(map(is_table, ([], TABLE[:1], TABLE[:2], TABLE[2:], [*TABLE, "| one cell |"])))
