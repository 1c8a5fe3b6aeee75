"""A file gets few plain lines, a terminal a line that moves; texts are as wide as the terminal."""

import errno
import io
import os
import re
import sys

import pytest

from dynasindy import terminal
from dynasindy.terminal import LOADING, Lines, Shown, fitted, line, say
from dynasindy.told import Told, tell

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Screen(io.StringIO):
    """A terminal that somebody sits in front of."""

    def isatty(self):
        return True


class Dead(io.StringIO):
    """A file whose reader has left, such as a terminal that was closed."""

    def __init__(self, front=False):
        super().__init__()
        self.front, self.tried = front, 0

    def isatty(self):
        return self.front

    def write(self, text):
        self.tried += 1
        raise OSError(errno.EIO, "Input/output error")


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


def test_each_phase_in_a_file_has_a_clock_of_its_own(clock):
    """A run that began at 0 s and goes on after a phase of its own, which began at 100 s and is over at 110 s."""
    shown = lines(clock)
    shown.hear(Told("run", 0, 10, "episodes", around=True))
    clock.now[0] = 100.0
    shown.hear(Told("planning"))
    clock.now[0] = 110.0
    shown.rest()
    for clock.now[0] in (118.0, 120.0):
        shown.tick()
    clock.now[0] = 121.0
    shown.hear(Told("run", 1, 10, "episodes", around=True))
    clock.now[0] = 130.0
    shown.tick()
    assert shown.file.getvalue().splitlines() == [
        "0 of 10 episodes, planning: 10 s",
        "run: 0 of 10 episodes, 120 s...",
        "run: 1 of 10 episodes, 130 s...",
    ]


def test_a_sweep_and_the_run_of_its_job_stand_side_by_side_in_a_file(clock):
    shown = lines(clock)
    shown.hear(Told("sweep", 3, 8, "jobs", around=True))
    clock.now[0] = 10.0
    shown.hear(Told("run", 4, 5, "episodes", around=True))
    shown.hear(Told("sweep", 3, 8, "jobs", around=True))
    shown.tick()
    clock.now[0] = 30.0
    shown.hear(Told("run", 0, 5, "episodes", around=True))  # the run of the next job
    clock.now[0] = 35.0
    shown.tick()
    shown.hear(Told("fit"))
    clock.now[0] = 40.0
    shown.close()
    assert shown.file.getvalue().splitlines() == [
        "3 of 8 jobs, run: 4 of 5 episodes, 0 s...",
        "3 of 8 jobs, run: 0 of 5 episodes, 5 s...",
        "3 of 8 jobs, 0 of 5 episodes, fit: 5 s",
    ]


def test_a_file_hears_nothing_after_the_end(clock):
    shown = lines(clock)
    shown.hear(Told("sweep", 3, 8, "jobs", around=True))
    shown.close()
    for clock.now[0] in (5.0, 50.0):
        shown.tick()
        shown.hear(Told("fit"))
        shown.rest()
    assert shown.file.getvalue() == ""


@pytest.mark.parametrize("front", [False, True])
def test_a_terminal_that_is_closed_does_not_end_the_work(monkeypatch, front):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(terminal, "MOMENT", 0.0)
    monkeypatch.setattr(sys, "stderr", dead := Dead(front))
    out = Dead(front) if front else io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    with Shown() as shown:
        for done in range(3):
            tell("run", done, 3, "episodes", around=True)
            tell("fit")
            tell("plan")
            if front:
                shown.view.progress.refresh()
            else:
                shown.view.tick()
            say("text")
    assert dead.tried == 1  # then it is left alone
    assert front or out.getvalue() == "text\n" * 3
    assert Shown.active is None


def test_lines_that_cannot_be_shown_leave_nothing_behind(monkeypatch):
    in_front(monkeypatch)

    def broken(file):
        raise ImportError("no rich")

    monkeypatch.setattr(terminal, "Bars", broken)
    with pytest.raises(ImportError), Shown():
        pass
    assert Shown.active is None and Shown.OWNER not in os.environ


@pytest.mark.parametrize("columns", [30, 100])
@pytest.mark.parametrize("around", [False, True])
def test_what_is_said_stays_on_a_terminal_and_lines_that_moved_do_not(monkeypatch, around, columns):
    screen = in_front(monkeypatch, columns)
    long = "x" * 45  # a word is not broken, so it runs on in the next row
    with Shown() as shown:
        tell("sweep", 1, 9, "jobs", "words that are longer than a narrow terminal", around=True)
        tell("run" if around else "planning", 2, 9, "steps", "words that are longer than it, too", around=around)
        for _ in range(2):
            shown.view.progress.refresh()
            say("first", f"second\n{long}", "CONTROLLED")
            print("printed")
        tell("figures")
        shown.view.progress.refresh()
        during = replayed(screen.getvalue(), columns)
    said = ["first", "second", *(long[i : i + columns] for i in range(0, 45, columns)), "CONTROLLED", "printed"] * 2
    assert replayed(screen.getvalue(), columns) == said
    assert during[: len(said)] == said and len(during) == len(said) + (3 if around else 2)


def test_what_is_said_to_a_file_is_written_to_it_while_a_terminal_shows_the_work(monkeypatch):
    screen = in_front(monkeypatch)
    monkeypatch.setattr(sys, "stdout", file := io.StringIO())
    with Shown() as shown:
        tell("planning")
        shown.view.progress.refresh()
        say("first", "second")
    assert file.getvalue() == "first\nsecond\n" and replayed(screen.getvalue()) == []


def test_the_clock_of_a_line_begins_anew_with_the_next_job(monkeypatch):
    in_front(monkeypatch)
    with Shown() as shown:
        now = [0.0]
        shown.view.progress.get_time = lambda: now[0]
        tell("run", 0, 2, "episodes", around=True)
        (task,) = shown.view.progress.tasks
        task._get_time = shown.view.progress.get_time
        task.start_time = 0.0
        now[0] = 60.0
        tell("run", 2, 2, "episodes", around=True)
        assert (task.finished_time, task.completed) == (60.0, 2)
        now[0] = 100.0
        tell("run", 0, 2, "episodes", around=True)
        now[0] = 107.0
        assert (task.finished_time, task.elapsed, task.completed) == (None, 7.0, 0)
        assert "0 of 2 episodes" in task.description


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
    screen = in_front(monkeypatch)
    monkeypatch.setattr("dynasindy.terminal.MOMENT", 0.0)
    with Shown() as shown:
        tell("run", 1, 2, "episodes", around=True)
        tell("planning", 3, 50, "updates", "score -0.5")
        shown.view.progress.refresh()
        print("a line")
        tell("figures")
    raw = screen.getvalue()
    seen = ESCAPE.sub("", raw)
    assert "planning" in seen and "3 of 50 updates, score -0.5" in seen and "1 of 2 episodes" in seen
    assert "a line\n" in seen
    assert "planning: 3 of 50 updates, score -0.5, 0 s\n" in seen  # what is left of the phase
    assert "\x1b[?25l" not in raw


@pytest.mark.parametrize("columns", [60, 80])
def test_the_score_of_a_plan_is_read_on_a_narrow_terminal(monkeypatch, columns):
    screen = in_front(monkeypatch, columns)
    with Shown() as shown:
        tell("planning", 1000, 1000, "updates", "score -0.0706")
        shown.view.progress.refresh()
        during = replayed(screen.getvalue(), columns)
    assert during[-1].rstrip().endswith("planning: 1000 of 1000 updates, score -0.0706")


def test_a_command_is_one_line_that_can_be_copied_however_narrow_the_terminal():
    command = "  dynasindy train system=xi 'plant.known={a:  # b}' train.episodes=3"
    script = command.replace("dynasindy train", "python scripts/train.py")
    why = "flies more episodes, whose data mend the model"
    text = f"next:\n{command}  # {why}\n{script}  # short\na sentence that names dynasindy train is none"
    found = fitted(text, 40).splitlines()
    assert found[:2] == ["next:", command] and found[4:6] == [script, "    # short"]
    assert [line[:6] for line in found[2:4]] == ["    # "] * 2  # so a shell takes no line of it for a command
    assert " ".join(line[6:] for line in found[2:4]) == why
    assert max(map(len, [*found[2:4], *found[6:]])) <= 40
    assert fitted(text, 120) == text


def test_a_table_that_is_too_wide_is_turned_and_what_stands_around_it_is_not():
    text = "Level: 0.05\n| setting | seeds |\n| --- | --- |\n| direct | 3 |\nTables: x"
    assert fitted(text, 20).splitlines() == text.splitlines()
    assert fitted(text, 15).splitlines() == ["Level: 0.05", "setting  direct", "seeds    3", "Tables: x"]


def test_a_wide_line_that_begins_with_a_bar_is_no_table():
    line = "| a sentence that begins with a bar"
    assert fitted(line, 20).splitlines() == ["| a sentence that", "begins with a bar"]
    ragged = "| setting | seeds |\n| --- | --- |\n| direct and more |"
    assert fitted(ragged, 15).split() == ragged.split()  # nothing is lost of what is no table either


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


def test_a_row_goes_on_below_its_last_column_unless_that_begins_too_far_to_the_right():
    """The last column begins after 24 places, which is in the left half of 50 and in the right half of 40."""
    row = "Omega_a'  -9.81 ± 0.03  sin(alpha_p) cos(alpha_p) Omega_a"
    assert fitted(row, 60) == row
    assert fitted(row, 50).splitlines() == [
        "Omega_a'  -9.81 ± 0.03  sin(alpha_p) cos(alpha_p)",
        " " * 24 + "Omega_a",
    ]
    assert fitted(row, 40).splitlines() == ["Omega_a'  -9.81 ± 0.03  sin(alpha_p)", "    cos(alpha_p) Omega_a"]


def test_equations_in_discrete_time_end_between_terms_too():
    text = "p_long_name[k+1] = 0.5 p_long_name + v_long - 0.0025 sin(3 p_long_name) + 0.1 cos(3 p_long_name)"
    assert fitted(text, 50).splitlines() == [
        "p_long_name[k+1] = 0.5 p_long_name + v_long",
        " " * 16 + "- 0.0025 sin(3 p_long_name)",
        " " * 16 + "+ 0.1 cos(3 p_long_name)",
    ]


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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(599, "599 s"), (768, "12.8 min"), (889, "14.8 min"), (1009, "16.8 min"), (7130, "119 min"), (7500, "2.08 h")],
)
def test_the_unit_of_the_time_so_far_only_grows(seconds, words):
    assert line(Told("fit", 1, 2, "steps"), seconds).endswith(f", {words}")
