"""A file gets few plain lines, a terminal a line that moves; texts are as wide as the terminal."""

import io
import os
import re
import sys

import pytest

from dynasindy.terminal import LOADING, Lines, Shown, fitted, say
from dynasindy.told import Told, tell

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Screen(io.StringIO):
    """A terminal that somebody sits in front of."""

    def isatty(self):
        return True


@pytest.fixture
def clock():
    now = [0.0]

    def time():
        return now[0]

    time.now = now
    return time


def lines(clock):
    return Lines(io.StringIO(), clock)


def test_a_file_hears_of_a_long_phase_after_a_moment_and_then_now_and_then(clock):
    """31 s of updates: lines at 2, 12, 22 s and at the end."""
    shown = lines(clock)
    for second in range(32):
        clock.now[0] = float(second)
        shown.hear(Told("planning", second, 31, "updates", "score 1"))
        shown.tick()
    shown.close()
    assert shown.file.getvalue().splitlines() == [
        "planning: 2 of 31 updates, score 1, 2 s...",
        "planning: 12 of 31 updates, score 1, 12 s...",
        "planning: 22 of 31 updates, score 1, 22 s...",
        "planning: 31 of 31 updates, score 1, 31 s",
    ]


def test_a_short_phase_and_the_loading_say_nothing_to_a_file(clock):
    shown = lines(clock)
    shown.hear(Told(LOADING))
    clock.now[0] = 30.0
    shown.tick()
    shown.hear(Told("fit"))
    clock.now[0] = 31.0
    shown.hear(Told("planning"))
    shown.close()
    assert shown.file.getvalue() == ""


def test_what_is_around_a_phase_stands_before_it(clock):
    shown = lines(clock)
    shown.hear(Told("run", 3, 10, "episodes", around=True))
    shown.hear(Told("fit"))
    clock.now[0] = 5.0
    shown.close()
    assert shown.file.getvalue() == "3 of 10 episodes, fit: 5 s\n"


def test_a_file_hears_how_a_sweep_goes_whose_jobs_run_elsewhere(clock):
    shown = lines(clock)
    shown.hear(Told(LOADING))
    for second in range(14):
        clock.now[0] = float(second)
        shown.hear(Told("sweep", second // 5, 3, "jobs", around=True))
        shown.tick()
    assert shown.file.getvalue().splitlines() == ["sweep: 0 of 3 jobs, 2 s...", "sweep: 2 of 3 jobs, 12 s..."]


def test_a_file_sees_no_control_characters_and_the_inner_of_two_shows_nothing(capsys, monkeypatch):
    monkeypatch.setattr("dynasindy.terminal.MOMENT", 0.0)
    with Shown():
        with Shown():
            tell("fit", 1, 2, "steps")
        tell("plan")
        say("done")
        assert capsys.readouterr().err.splitlines() == ["fit: 1 of 2 steps, 0 s", "plan: 0 s"]
    assert capsys.readouterr().err == ""  # a phase that was over when something was said is not told again
    assert Shown.OWNER not in os.environ


def test_a_worker_of_a_sweep_shows_nothing(capsys, monkeypatch):
    monkeypatch.setattr("dynasindy.terminal.MOMENT", 0.0)
    monkeypatch.setenv(Shown.OWNER, str(os.getppid()))
    with Shown():
        tell("fit")
    assert capsys.readouterr().err == ""


def test_a_terminal_sees_phases_and_what_is_printed_and_keeps_its_cursor(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr("dynasindy.terminal.MOMENT", 0.0)
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(sys, "stdout", screen)
    with Shown() as shown:
        tell("run", 1, 2, "episodes", around=True)
        tell("planning", 3, 50, "updates", "imagined score -0.5")
        shown.view.progress.refresh()
        print("a line")
        tell("figures")
    raw = screen.getvalue()
    seen = ESCAPE.sub("", raw)
    assert "planning" in seen and "3 of 50 updates, imagined score -0.5" in seen and "1 of 2 episodes" in seen
    assert "a line\n" in seen
    assert "planning: 3 of 50 updates, imagined score -0.5, 0 s\n" in seen  # what is left of the phase
    assert "\x1b[?25l" not in raw


def test_equations_end_between_terms_and_sentences_between_words():
    text = "  x' = 1.5 a - 2 sin(b + c) d + 1e-06 e^2\nOne sentence that is long\nshort"
    assert fitted(text, 20).splitlines() == [
        "  x' = 1.5 a",
        "      - 2 sin(b",  # the brackets alone are too long
        "      + c) d",
        "      + 1e-06 e^2",
        "One sentence that is",
        "long",
        "short",
    ]
    assert fitted(text, 30).splitlines()[:2] == ["  x' = 1.5 a - 2 sin(b + c) d", "       + 1e-06 e^2"]
    assert all(len(line) <= 30 for line in fitted(text, 30).splitlines())


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
