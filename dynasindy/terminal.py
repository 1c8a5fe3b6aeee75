"""What a command shows while it works and when it is done, to somebody who sits in front and to a file.

A terminal has a line that moves, colours and a width; a file gets plain lines, few of them.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TextIO

from dynasindy.told import Told, hearing

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

LOADING = "loading"
"""What comes before the work; a file hears nothing of it."""
MOMENT = 2.0
"""Length of a phase from which on a file hears of it [s]."""
EVERY = 10.0
"""Time between two lines of one phase in a file [s]."""
TOLD = re.compile(r"\bNOT (?:CONTROLLED|promised|JUDGED)\b|\bCONTROLLED\b|^(?:note|hint|found|next):", re.M)
SIGN = re.compile(r" (?=[+-] )")


class Shown:
    """Show what is told while inside, on standard error; within another one, or for a worker of a sweep, nothing more.

    Args:
        clock: Tells the time [s].
    """

    active: Shown | None = None
    OWNER = "DYNASINDY_SHOWN"

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.stack = ExitStack()
        self.view: Lines | Bars | None = None

    def __enter__(self) -> Self:
        """Begin to show."""
        if Shown.active is not None or os.environ.get(self.OWNER, str(os.getpid())) != str(os.getpid()):
            return self
        Shown.active, os.environ[self.OWNER] = self, str(os.getpid())
        self.stack.callback(os.environ.pop, self.OWNER, None)
        self.stack.callback(setattr, Shown, "active", None)
        self.view = Bars() if is_terminal(sys.stderr) else Lines(sys.stderr, self.clock)
        self.stack.callback(self.view.close)
        self.stack.enter_context(hearing(self.view.hear))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Take away what moves."""
        self.stack.close()


class Lines:
    """Plain lines for a file: of each phase that takes a moment what came of it, and now and then where it is.

    Args:
        file: Where they are written.
        clock: Tells the time [s].
    """

    def __init__(self, file: TextIO, clock: Callable[[], float]) -> None:
        self.file, self.clock = file, clock
        self.told: Told | None = None
        self.around: Told | None = None
        self.begun = self.written = clock()
        self.lock, self.ended = threading.RLock(), threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()  # a phase may be silent for long

    def hear(self, told: Told) -> None:
        """Take note of what is told; write what came of the phase before."""
        with self.lock:
            if told.around:
                if self.around is None and self.told is None:
                    self.begun = self.written = self.clock()
                self.around = told
            elif self.told is None or told.phase != self.told.phase:
                self._end()
                self.told, self.begun, self.written = told, self.clock(), self.clock()
            else:
                self.told = told

    def tick(self) -> None:
        """Write where a long phase is, if the last line is long enough ago."""
        with self.lock:
            now = self.clock()
            first = self.written == self.begun and now - self.begun >= MOMENT
            if (self.told or self.around) is not None and (first or now - self.written >= EVERY):
                self.written = now
                self._write("...")

    def rest(self) -> None:
        """Write what came of the latest phase, which is over."""
        with self.lock:
            self._end()
            self.told = None

    def close(self) -> None:
        """Write nothing more."""
        self.ended.set()
        self.rest()

    def _end(self) -> None:
        if self.told is not None and self.clock() - self.begun >= MOMENT:
            self._write()

    def _write(self, more: str = "") -> None:
        working = self.told is not None and self.told.phase != LOADING
        parts = [self.around.counted()] if working and self.around is not None else []
        shown = self.told if working else self.around
        if shown is not None:
            parts.append(line(shown, self.clock() - self.begun))
            self.file.write(f"{', '.join(filter(None, parts))}{more}\n")
            self.file.flush()

    def _watch(self) -> None:
        while not self.ended.wait(0.5):
            self.tick()


class Bars:
    """Lines that move, on a terminal; what is printed meanwhile stands above them."""

    def __init__(self) -> None:
        self.progress = _progress()
        self.around: dict[str, TaskID] = {}
        self.told: Told | None = None
        self.task: TaskID | None = None
        self.begun = 0.0
        self.lock = threading.RLock()
        self.progress.start()

    def hear(self, told: Told) -> None:
        """Show what is told; leave a line of a phase that took a moment and is over."""
        with self.lock:
            if told.around:
                if told.phase not in self.around:
                    self.around[told.phase] = self.progress.add_task(told.phase)
                self._update(self.around[told.phase], told)
                return
            if self.told is None or told.phase != self.told.phase:
                self._end()
                self.begun, self.task = time.monotonic(), self.progress.add_task(told.phase)
            self.told = told
            assert self.task is not None
            self._update(self.task, told)

    def rest(self) -> None:
        """Leave a line of the latest phase, which is over."""
        with self.lock:
            self._end()

    def close(self) -> None:
        """Take the lines away."""
        self.rest()
        self.progress.stop()

    def _update(self, task: TaskID, told: Told) -> None:
        words = ", ".join(filter(None, (told.counted(), told.words)))
        said = f"{told.phase}: {words}" if words else told.phase
        self.progress.update(task, description=said, completed=told.done, total=told.total)

    def _end(self) -> None:
        if self.told is not None and self.task is not None:
            if self.told.phase != LOADING and time.monotonic() - self.begun >= MOMENT:
                self.progress.console.print(line(self.told, time.monotonic() - self.begun), style="dim", markup=False)
            self.progress.remove_task(self.task)
        self.told = self.task = None


def _progress() -> Progress:
    """Return rich's display, which leaves the cursor as it is: a process that is killed could not give it back."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    class _Steady(Console):
        def show_cursor(self, show: bool = True) -> bool:
            """Leave the cursor as it is."""
            return False

    class _Known(BarColumn):
        def render(self, task: Any) -> Any:
            """Return a bar where the total is known."""
            return super().render(task) if task.total else ""

    return Progress(
        SpinnerColumn("line"),
        TimeElapsedColumn(),
        _Known(bar_width=20),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
        expand=True,
        console=_Steady(stderr=True),
        transient=True,
        refresh_per_second=4,
        redirect_stdout=is_terminal(sys.stdout),
    )


def line(told: Told, seconds: float) -> str:
    """Return a phase, how much of it is done, and how long it took so far, in words."""
    parts = [told.counted(), told.words, f"{seconds:.0f} s"]
    return f"{told.phase}: {', '.join(filter(None, parts))}"


def is_terminal(file: TextIO) -> bool:
    """Return whether somebody sits in front of a file who can be shown a line that moves."""
    return file.isatty() and os.environ.get("TERM") != "dumb"


def width() -> int | None:
    """Return the columns of the terminal that standard output is; None where it is none, and lines may be long."""
    return shutil.get_terminal_size().columns if is_terminal(sys.stdout) else None


def say(*texts: str) -> None:
    """Print texts at once: on a terminal within its width and with its colours, elsewhere as they are."""
    if Shown.active is not None and Shown.active.view is not None:
        Shown.active.view.rest()
    if (columns := width()) is None:
        print(*texts, sep="\n", flush=True)
        return
    from rich.console import Console

    console = Console(highlight=False)
    for text in texts:
        console.print(_coloured(fitted(text, columns)), soft_wrap=True)


def fitted(text: str, columns: int) -> str:
    """Return a text whose lines are no longer than so many columns: equations end between terms, sentences at words."""
    return "\n".join(part for whole in text.split("\n") for part in _broken(whole, columns))


def _broken(whole: str, columns: int) -> list[str]:
    if len(whole) <= columns:
        return [whole]
    start = " " * (len(whole) - len(whole.lstrip()))
    equation = re.match(r"\s*\S+' = ", whole)
    if equation is None:
        return textwrap.wrap(whole, columns, subsequent_indent=start, break_long_words=False, break_on_hyphens=False)
    return _equation(whole, columns, " " * min(len(equation[0]), columns // 3))


def _equation(whole: str, columns: int, indent: str) -> list[str]:
    """Return an equation in lines that end between terms; brackets are broken where they are too long themselves."""
    lines = [""]
    for term in _terms(whole):
        parts = [term] if len(indent) + len(term) <= columns else SIGN.split(term)
        for part in parts:
            if lines[-1] and len(lines[-1]) + 1 + len(part) > columns:
                lines.append(indent + part)
            else:
                lines[-1] = f"{lines[-1]} {part}" if lines[-1] else part
    return lines


def _terms(whole: str) -> list[str]:
    """Return the terms of an equation, each with its sign and all that is in its brackets."""
    terms: list[str] = []
    for part in SIGN.split(whole):
        if terms and terms[-1].count("(") > terms[-1].count(")"):
            terms[-1] = f"{terms[-1]} {part}"
        else:
            terms.append(part)
    return terms


def _coloured(text: str) -> Any:
    """Return rich's text, with the verdict in green or red."""
    from rich.text import Text

    found = Text(text)
    for word in TOLD.finditer(text):
        colour = "bold cyan" if word[0].endswith(":") else "bold red" if "NOT" in word[0] else "bold green"
        found.stylize(colour, *word.span())
    return found
