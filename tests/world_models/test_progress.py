"""A fit that takes long says what it does; a short one, and one nobody listens to, say nothing."""

import logging
import sys
import time

import pytest

from dynasindy.world_models.progress import LOG, Progress, Steps


class Terminal:
    """Standard error of somebody who sits in front of it."""

    def __init__(self):
        self.text = ""

    def write(self, text):
        self.text += text

    def flush(self):
        pass

    def isatty(self):
        return True


def test_steps_are_counted_and_named_while_inside(monkeypatch):
    monkeypatch.setattr(sys, "stderr", screen := Terminal())
    with Progress(after=0.0) as progress:
        LOG.info("fit of %d coefficients", 19)
        progress.bar.refresh()
        LOG.info("choice among %d", 7)
        assert progress.bar.n == 2 and progress.bar.desc.strip(": ") == "choice among 7"
    LOG.info("nobody listens")
    assert progress.bar.n == 2
    assert "\rfit of 19 coefficients" in screen.text and "\n" not in screen.text


def test_a_short_fit_says_nothing_and_the_logger_is_as_it_was(capsys):
    before = LOG.level, list(LOG.handlers), LOG.propagate
    with Progress(after=60.0):
        LOG.info("a step")
    assert capsys.readouterr().err == ""
    assert (LOG.level, LOG.handlers, LOG.propagate) == before
    assert not LOG.isEnabledFor(logging.INFO)


def test_a_file_gets_a_plain_line_now_and_then(capsys):
    """A step every second for 31 s: lines at 0, 10, 20 and 30 s, and the last one at the end."""
    now = [0.0]
    bar = Steps(clock=lambda: now[0], total=31, desc="work", unit="piece")
    for second in range(1, 32):
        now[0] = float(second)
        bar.set_postfix_str(f"at {second} s")
        bar.update()
    bar.close()
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[2] for line in lines] == ["0/31", "9/31", "19/31", "29/31", "31/31"]
    assert all("\r" not in line and line.startswith("work:") for line in lines)


def test_a_silent_fit_is_heard_of_in_a_file_after_a_moment(capsys):
    with Progress(after=0.01):
        time.sleep(0.2)
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("leave", [True, False])
def test_the_last_state_is_left_if_it_is_to_be(capsys, leave):
    bar = Steps(total=2, desc="work", leave=leave, clock=lambda: 0.0)
    bar.update(2)
    bar.close()
    assert ("2/2" in capsys.readouterr().err) == leave
