"""A file gets few plain lines, a terminal bars that move; texts are as wide as the terminal."""

import io
import os
import re
import sys

import pytest

from dynasindy.progress import LOADING, Event, Progress, listening, report_progress, reporting_as, say

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Screen(io.StringIO):
    """A terminal that somebody sits in front of."""

    def isatty(self):
        return True


def replayed(raw, columns=100):
    """Return the lines that a terminal shows after what was written to it: text, line ends, cursor up, erased lines."""
    rows, row, column = [""], 0, 0
    for code in re.finditer(r"\x1b\[([0-9;?]*)([A-Za-z])|\r|\n|[^\x1b]", raw):
        if code[0] == "\r":
            column = 0
        elif code[0] == "\n" or (code[2] is None and column == columns):
            row, column = row + 1, 0
            rows += [""] * (row + 1 - len(rows))
        elif code[2] == "A":
            row -= int(code[1] or 1)
        elif code[2] == "K":
            assert code[1] == "2"
            rows[row] = ""
        else:
            assert code[2] in (None, "m"), code[0]
        if code[2] is None and code[0] not in "\r\n":
            rows[row] = rows[row][:column].ljust(column) + code[0] + rows[row][column + 1 :]
            column += 1
        assert row >= 0
    return [text.rstrip() for text in rows if text.strip()]


def in_front(monkeypatch, columns=100):
    """Return a terminal that both outputs are; no fixture, as pytest exchanges the outputs before a test begins."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(sys, "stdout", screen)
    return screen


@pytest.fixture
def clock():
    now = [0.0]

    def time():
        return now[0]

    time.now = now
    return time


@pytest.fixture
def file(monkeypatch, clock):
    """Return a progress whose standard error is a file, and the file."""
    monkeypatch.setattr(sys, "stderr", file := io.StringIO())
    with Progress(clock) as progress:
        yield progress, file


def test_a_file_hears_of_a_long_phase_after_a_moment_and_then_now_and_then(clock, file):
    """31 s of updates: lines at 2, 12, 22 s and at the end."""
    shown, written = file
    for second in range(32):
        clock.now[0] = float(second)
        report_progress("planning", second, 31, "updates", "score 1")
    shown.__exit__(None, None, None)
    assert written.getvalue().splitlines() == [
        "planning: 2 of 31 updates, score 1, 2 s...",
        "planning: 12 of 31 updates, score 1, 12 s...",
        "planning: 22 of 31 updates, score 1, 22 s...",
        "planning: 31 of 31 updates, score 1, 31 s",
    ]


def test_a_short_phase_and_the_loading_say_nothing_to_a_file(clock, file):
    shown, written = file
    report_progress(LOADING)
    clock.now[0] = 30.0
    report_progress("fit")
    clock.now[0] = 31.0
    report_progress("planning")
    shown.__exit__(None, None, None)
    assert written.getvalue() == ""


@pytest.mark.parametrize("columns", [30, 100])
@pytest.mark.parametrize("around", [False, True])
def test_what_is_said_stays_on_a_terminal_and_lines_that_moved_do_not(monkeypatch, around, columns):
    screen = in_front(monkeypatch, columns)
    long = "x" * 45  # a word is not broken, so it runs on in the next row
    with Progress() as shown:
        report_progress("sweep", 1, 9, "jobs", "words that are longer than a narrow terminal", outer=True)
        report_progress(
            "run" if around else "planning", 2, 9, "steps", "words that are longer than it, too", outer=around
        )
        for _ in range(2):
            shown.display.refresh()
            say("first", f"second\n{long}", "CONTROLLED")
            print("printed")
        report_progress("figures")
        shown.display.refresh()
        during = replayed(screen.getvalue(), columns)
    said = ["first", "second", *(long[i : i + columns] for i in range(0, 45, columns)), "CONTROLLED", "printed"] * 2
    assert replayed(screen.getvalue(), columns) == said
    assert during[: len(said)] == said and len(during) == len(said) + (3 if around else 2)


def test_a_file_sees_no_control_characters_and_the_inner_of_two_shows_nothing(capsys, monkeypatch):
    monkeypatch.setattr("dynasindy.progress.SHORT", 0.0)
    with Progress():
        with Progress():
            report_progress("fit", 1, 2, "steps")
        report_progress("plan")
        say("done")
        assert capsys.readouterr().err.splitlines() == ["fit: 1 of 2 steps, 0 s", "plan: 0 s"]
    assert capsys.readouterr().err == ""  # a phase that was over when something was said is not told again
    assert Progress.OWNER not in os.environ


def test_a_text_is_whole_in_a_file_and_within_the_width_of_a_terminal(capsys, monkeypatch):
    text = "NOT CONTROLLED: " + " ".join(["word"] * 20)
    say(text)
    assert capsys.readouterr().out == text + "\n"
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys, "stdout", screen := Screen())
    say(text)
    seen = ESCAPE.sub("", screen.getvalue())
    assert max(map(len, seen.splitlines())) <= 40 and seen.split() == text.split()
    assert "\x1b[1;31mNOT CONTROLLED\x1b[0m" in screen.getvalue()


def test_what_a_check_says_is_coloured_and_words_inside_are_not(monkeypatch):
    screen = in_front(monkeypatch)
    say("ok    stability: ok", "WEAK  slew: not WEAK")
    assert screen.getvalue().count("\x1b[32mok\x1b[0m") == screen.getvalue().count("\x1b[1;33mWEAK\x1b[0m") == 1


def test_what_the_parts_of_a_phase_tell_is_told_of_it_until_it_ends_or_fails():
    heard = []
    with listening(heard.append):
        try:
            with reporting_as("actuators"):
                report_progress("fit", note="6 coefficients")
                raise ValueError
        except ValueError:
            report_progress("fit")
    assert heard == [Event("actuators"), Event("actuators", note="6 coefficients"), Event("fit")]


def test_a_command_is_one_line_that_can_be_copied_however_narrow_the_terminal(monkeypatch):
    command = "  dynasindy train system=xi 'plant.known={a:  # b}' train.episodes=3  # flies more episodes"
    script = command.replace("dynasindy train", "PYTHONPATH='/home/my dir' python scripts/train.py")
    screen = in_front(monkeypatch, 40)
    folder = f"Run folder: /home/{'deep/' * 10}down"
    say(f"next:\n{command}\n{script}\n{folder}", "a sentence that names dynasindy train is none")
    found = ESCAPE.sub("", screen.getvalue()).splitlines()
    assert found[:4] == ["next:", command, script, folder] and max(map(len, found[4:])) <= 40


def test_equations_and_sentences_end_between_words(monkeypatch):
    screen = in_front(monkeypatch, 20)
    say("  x' = 1.5 a - 2 sin(b + c) d + 1e-06 e^2\nOne sentence that is long\nshort")
    found = [line.rstrip() for line in screen.getvalue().splitlines()]
    assert found[-3:] == ["One sentence that is", "long", "short"] and found[0] == "  x' = 1.5 a - 2"
