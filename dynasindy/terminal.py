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
from itertools import groupby
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TextIO, cast

from dynasindy.durations import in_words
from dynasindy.narrow import is_table, narrowed
from dynasindy.told import Told, hearing

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

LOADING = "loading"
"""What comes before the work; a file hears nothing of it."""
MOMENT = 2.0
"""Length of a phase from which on a file hears of it [s]."""
EVERY = 10.0
"""Time between two lines of one phase in a file [s]."""
TOLD = re.compile(r"\bNOT (?:CONTROLLED|promised|JUDGED)\b|\bCONTROLLED\b|^(?:note|hint|found|next|warning):", re.M)
COMMAND = re.compile(r"\s*(?:dynasindy \w+|python scripts/\w+\.py)(?: |$)")
"""How a line begins that is meant to be copied into a shell."""
REMARK = "  # "
"""What a comment behind a command begins with."""
SIGN = re.compile(r" (?=[+-] )")
COLUMN = re.compile(r".*\S {2,}(?=\S)")
"""A row up to its last column, two spaces or more behind the one before."""


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
        file = cast("TextIO", Lasting(sys.stderr))
        self.view = Bars(file) if is_terminal(sys.stderr) else Lines(file, self.clock)  # first, as it may fail
        Shown.active, os.environ[self.OWNER] = self, str(os.getpid())
        self.stack.callback(os.environ.pop, self.OWNER, None)
        self.stack.callback(setattr, Shown, "active", None)
        self.stack.callback(self.view.close)
        self.stack.enter_context(hearing(self.view.hear))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Take away what moves."""
        self.stack.close()


class Lasting:
    """A file that whoever reads it may close, as a terminal: from then on nothing is written, and the work goes on.

    Args:
        file: Where it is written.
    """

    def __init__(self, file: TextIO) -> None:
        self.file = file
        self.gone = False

    def write(self, text: str) -> int:
        """Write a text, unless the file is gone."""
        if not self.gone:
            try:
                self.file.write(text)
            except OSError:
                self.gone = True
        return len(text)

    def flush(self) -> None:
        """Hand on what was written, unless the file is gone."""
        if not self.gone:
            try:
                self.file.flush()
            except OSError:
                self.gone = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


class Lines:
    """Plain lines for a file: of each phase that takes a moment what came of it, and now and then where it is.

    Args:
        file: Where they are written.
        clock: Tells the time [s].
    """

    def __init__(self, file: TextIO, clock: Callable[[], float]) -> None:
        self.file, self.clock = file, clock
        self.told: Told | None = None
        self.around: dict[str, tuple[Told, float]] = {}  # each with its begin, in the order of their begins
        self.begun = self.written = clock()
        self.fresh = True
        self.lock, self.ended = threading.RLock(), threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()  # a phase may be silent for long

    def hear(self, told: Told) -> None:
        """Take note of what is told; write what came of the phase before."""
        with self.lock:
            if told.around:
                if not self.around and self.told is None:
                    self._begin()
                before, begun = self.around.get(told.phase, (told, self.clock()))
                if told.done < before.done:  # that of the next job of a sweep
                    begun = self.clock()
                self.around[told.phase] = told, begun
            elif self.told is None or told.phase != self.told.phase:
                self._end()
                self.told = told
                self._begin()
            else:
                self.told = told

    def tick(self) -> None:
        """Write where a long phase is, if the last line is long enough ago."""
        with self.lock:
            now = self.clock()
            first = self.fresh and now - self.begun >= MOMENT
            if (self.told is not None or self.around) and (first or now - self.written >= EVERY):
                self.written, self.fresh = now, False
                self._write("...")

    def rest(self) -> None:
        """Write what came of the latest phase, which is over."""
        with self.lock:
            self._end()
            if self.told is not None:
                self.told, self.written, self.fresh = None, self.clock(), False

    def close(self) -> None:
        """Write nothing more."""
        with self.lock:
            self.rest()
            self.ended.set()

    def _begin(self) -> None:
        self.begun = self.written = self.clock()
        self.fresh = True

    def _end(self) -> None:
        if self._working() and self.clock() - self.begun >= MOMENT:
            self._write()

    def _working(self) -> bool:
        return self.told is not None and self.told.phase != LOADING

    def _write(self, more: str = "") -> None:
        if self.ended.is_set():  # the thread that watches may come late
            return
        shown = list(self.around.values())
        if self.told is not None and self._working():
            shown.append((self.told, self.begun))
        if shown:
            told, begun = shown.pop()
            parts = [*(one.counted() for one, _ in shown), line(told, self.clock() - begun)]
            self.file.write(f"{', '.join(filter(None, parts))}{more}\n")
            self.file.flush()

    def _watch(self) -> None:
        while not self.ended.wait(0.5):
            self.tick()


class Bars:
    """Lines that move, on a terminal; what is printed meanwhile stands above them.

    Args:
        file: The terminal.
    """

    def __init__(self, file: TextIO) -> None:
        self.progress = _progress(file)
        self.around: dict[str, tuple[TaskID, int]] = {}  # each with how much of it was done when it was last told
        self.told: Told | None = None
        self.task: TaskID | None = None
        self.begun = 0.0
        self.lock = threading.RLock()
        self.progress.start()

    def hear(self, told: Told) -> None:
        """Show what is told; leave a line of a phase that took a moment and is over."""
        with self.lock:
            if told.around:
                self._surround(told)
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

    def _surround(self, told: Told) -> None:
        task, done = self.around.get(told.phase, (None, 0))
        if task is None:
            task = self.progress.add_task(told.phase)
        elif told.done < done:
            self.progress.reset(task, completed=told.done)  # else the next job would go on with the clock of the last
        self.around[told.phase] = task, told.done
        self._update(task, told)

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


def _progress(file: TextIO) -> Progress:
    """Return rich's display, which leaves the cursor of a terminal: a process that is killed could not give it back."""
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

    console = _Steady(file=file)
    return Progress(
        SpinnerColumn("line"),
        TimeElapsedColumn(),
        _Known(bar_width=min(20, max(4, console.width - 60))),  # on a narrow terminal words tell more than a bar
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
        expand=True,
        console=console,
        transient=True,
        refresh_per_second=4,
        redirect_stdout=is_terminal(sys.stdout),
    )


def line(told: Told, seconds: float) -> str:
    """Return a phase, how much of it is done, and how long it took so far, in words."""
    parts = [told.counted(), told.words, in_words(round(seconds), digits=3, running=True)]
    return f"{told.phase}: {', '.join(filter(None, parts))}"


def is_terminal(file: TextIO) -> bool:
    """Return whether somebody sits in front of a file who can be shown a line that moves."""
    file = getattr(file, "rich_proxied_file", file)  # what stands in for it while lines move need not know
    return file.isatty() and os.environ.get("TERM") != "dumb"


def width() -> int | None:
    """Return the columns of the terminal that standard output is; None where it is none, and lines may be long."""
    return shutil.get_terminal_size().columns if is_terminal(sys.stdout) else None


def say(*texts: str) -> None:
    """Print texts at once: on a terminal within its width and with its colours, elsewhere as they are."""
    view = Shown.active.view if Shown.active is not None else None
    if view is not None:
        view.rest()
    if (columns := width()) is None:
        print(*texts, sep="\n", flush=True)
        return
    from rich.console import Console

    # Only the console of the lines that move knows where they are; what another one writes, they would erase.
    console = view.progress.console if isinstance(view, Bars) else Console()
    for text in texts:
        console.print(_coloured(fitted(text, columns)), soft_wrap=True, highlight=False)


def fitted(text: str, columns: int) -> str:
    """Return a text whose lines are no longer than so many columns: equations end between terms, sentences at words.

    A row whose last column is too wide goes on below that column, if it begins in the left half, else a little further
    right than the row itself, so that rows can be told apart.
    A command stays one line, which the terminal wraps: of two lines, a shell would take the second for another command.
    A comment that does not fit behind it stands below it, each of its lines a comment. A table in Markdown that is too
    wide is turned.
    """
    found: list[str] = []
    for _, several in groupby(text.split("\n"), lambda line: line.startswith("| ")):
        lines = [*several]
        turned = is_table(lines)  # a lone line may begin with a bar as well
        found += narrowed(lines, columns) if turned else [part for line in lines for part in _broken(line, columns)]
    return "\n".join(found)


def _broken(whole: str, columns: int) -> list[str]:
    if len(whole) <= columns:
        return [whole]
    start = " " * (len(whole) - len(whole.lstrip()))
    if COMMAND.match(whole):
        command, sign, comment = whole.rpartition(REMARK)
        begin = f"{start}{REMARK}"
        below = textwrap.wrap(comment, columns, initial_indent=begin, subsequent_indent=begin, break_long_words=False)
        return [command, *below] if sign else [whole]
    equation = re.match(r"\s*\S+(?:'|\[k\+1\]) = ", whole)
    if equation is None:
        row = COLUMN.match(whole)
        if row is not None:
            start = " " * len(row[0]) if len(row[0]) <= columns // 2 else f"{start}    "
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
