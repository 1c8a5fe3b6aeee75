"""Durations, lines as wide as a terminal, and names that were probably meant."""

import math

import pytest

from dynasindy.text import format_duration, wrap


def test_a_row_of_a_table_stays_a_line_of_markdown():
    row = "| setting | 2.5 [1, 3] | a commit that is long |"
    assert wrap(row, 20) == row


def test_a_command_is_one_line_that_can_be_copied_however_narrow_the_terminal():
    command = "  dynasindy train system=xi 'plant.known={a:  # b}' train.episodes=3"
    script = command.replace("dynasindy train", "python scripts/train.py")
    why = "flies more episodes, whose data mend the model"
    text = f"next:\n{command}  # {why}\n{script}  # short\na sentence that names dynasindy train is none"
    found = wrap(text, 40).splitlines()
    assert found[:2] == ["next:", command] and found[4:6] == [script, "    # short"]
    assert [line[:6] for line in found[2:4]] == ["    # "] * 2  # so a shell takes no line of it for a command
    assert " ".join(line[6:] for line in found[2:4]) == why
    assert max(map(len, [*found[2:4], *found[6:]])) <= 40
    assert wrap(text, 120) == text


def test_equations_end_between_terms_and_sentences_between_words():
    text = "  x' = 1.5 a - 2 sin(b + c) d + 1e-06 e^2\nOne sentence that is long\nshort"
    assert wrap(text, 20).splitlines() == [
        "  x' = 1.5 a",
        "      - 2 sin(b",  # the brackets alone are too long
        "      + c) d",
        "      + 1e-06 e^2",
        "One sentence that is",
        "long",
        "short",
    ]
    assert wrap(text, 30).splitlines()[:2] == ["  x' = 1.5 a - 2 sin(b + c) d", "       + 1e-06 e^2"]
    assert all(len(line) <= 30 for line in wrap(text, 30).splitlines())
    product = "x' = 15.81 sin(alpha) cos(alpha) Omega omega"  # one term, which is broken between its factors
    lines = wrap(product, 20).splitlines()
    assert " ".join(lines).split() == product.split() and max(map(len, lines)) <= 20


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.05, "0.05 s"),
        (20, "20 s"),
        (599, "599 s"),
        (600, "10 min"),
        (930, "15.5 min"),
        (1000, "1000 s"),
        (2000, "2000 s"),
        (2005, "33.42 min"),
        (9000, "2.5 h"),
        (10000, "2.778 h"),
        (-5400, "-90 min"),
        (7200, "2 h"),
        (86400 * 7, "168 h"),
        (3600 * 12345, "12345 h"),
        (math.inf, "inf s"),
        (math.nan, "nan s"),
    ],
)
def test_a_length_of_time_is_told_in_the_unit_that_suits_it(seconds, words):
    assert format_duration(seconds) == words
