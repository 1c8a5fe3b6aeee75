"""Progress of long work: events, reported where it is done and shown on standard error within `Progress`.

A terminal has bars that move and colours; a file gets plain lines, few of them, as the work reports its steps.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO, TypeVar

from dynasindy.text import format_duration

if TYPE_CHECKING:
    from rich.progress import Progress as Display
    from rich.progress import TaskID

Item = TypeVar("Item")

LOADING = "loading"
"""Phase of the imports that precede the work; it leaves no line."""
SHORT = 2.0
"""Length of a phase below which it leaves no line [s]."""
INTERVAL = 10.0
"""Time between two lines of one phase in a file [s]."""
COLOURS = {
    r"\bNOT (?:CONTROLLED|promised|JUDGED)\b": "bold red",
    r"(?<!NOT )\bCONTROLLED\b": "bold green",
    r"^(?:note|hint|found|next|warning):": "bold cyan",
    r"^ok(?=  )": "green",
    r"^WEAK(?=  )": "bold yellow",
}
"""Words that have a colour on a terminal."""
COPIED = re.compile(r"\s*(?:\| |(?:PYTHONPATH=(?:'[^']*'|\S+) )?(?:dynasindy \w+|python scripts/\w+\.py)(?: |$))")
"""How a line begins that is meant to be copied into a shell, or into a page."""


class TimeIsUp(RuntimeError):
    """Raised by a listener whose time limit is reached; a fit to trajectories then returns its present estimate."""


@dataclass(frozen=True)
class Event:
    """State of a phase of the work.

    Attributes:
        phase: What is done, in words.
        done: How much of it.
        total: How much there is; None if nobody knows.
        unit: What is counted, in the plural.
        note: What else there is to say.
        outer: Whether other phases happen within this one, as those of an episode in a run.
    """

    phase: str
    done: int = 0
    total: int | None = None
    unit: str = ""
    note: str = ""
    outer: bool = False

    def count(self) -> str:
        """Return how much is done, in words; nothing where nothing is counted."""
        of = f" of {self.total}" if self.total else ""
        return f"{self.done}{of} {self.unit}".strip() if self.done or self.total else ""

    def line(self, seconds: float | None = None) -> str:
        """Return the phase, how much of it is done and how long it took so far, in words."""
        elapsed = "" if seconds is None else format_duration(round(seconds), digits=3)
        details = ", ".join(filter(None, (self.count(), self.note, elapsed)))
        return f"{self.phase}: {details}" if details else self.phase


_listeners: list[Callable[[Event], None]] = []
_phases: list[str] = []


def report_progress(
    phase: str, done: int = 0, total: int | None = None, unit: str = "", note: str = "", outer: bool = False
) -> None:
    """Report the progress of a phase; the arguments are those of `Event`.

    An outer phase keeps its name within `reporting_as`: it may come from a thread that knows nothing of that.
    """
    event = Event(_phases[0] if _phases and not outer else phase, done, total, unit, note, outer)
    for listener in _listeners:
        listener(event)


def track(phase: str, items: Iterable[Item], total: int, unit: str = "") -> Iterator[Item]:
    """Yield items, and report how many are done.

    Args:
        phase: What is done with them.
        items: The items.
        total: How many there are.
        unit: What they are, in the plural.
    """
    for done, item in enumerate(items):
        report_progress(phase, done, total, unit)
        yield item
    report_progress(phase, total, total, unit)


@contextmanager
def reporting_as(phase: str) -> Iterator[None]:
    """Let all reports from inside be of one phase, which its parts do not know of."""
    _phases.append(phase)
    try:
        report_progress(phase)
        yield
    finally:
        _phases.pop()


@contextmanager
def listening(listener: Callable[[Event], None]) -> Iterator[None]:
    """Call a function with each event that is reported inside."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


class Progress:
    """Show progress on standard error while inside; within another one, or in a worker of a sweep, show nothing more.

    Args:
        clock: Returns the time [s].
    """

    active: Progress | None = None
    OWNER = "DYNASINDY_PROGRESS"

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self.lock, self.stack = clock, threading.RLock(), ExitStack()
        self.phases: dict[tuple[bool, str], tuple[Event, float]] = {}  # by outer and name, each with its start [s]
        self.display: Display | None = None  # of a terminal
        self.tasks: dict[tuple[bool, str], TaskID] = {}
        self.due = 0.0  # time of the next line in a file [s]

    def __repr__(self) -> str:
        return f"Progress({'shows' if Progress.active is self else 'does not show'} what is under way)"

    def __enter__(self) -> Self:
        """Begin to show."""
        if Progress.active is not None or os.environ.get(self.OWNER, str(os.getpid())) != str(os.getpid()):
            return self
        self.file = sys.stderr
        if _is_terminal(sys.stderr):
            self.display = self.stack.enter_context(_display(self.file, self.clock))
        Progress.active, os.environ[self.OWNER] = self, str(os.getpid())
        self.stack.callback(os.environ.pop, self.OWNER, None)
        self.stack.callback(setattr, Progress, "active", None)
        self.stack.callback(self.finish)
        self.stack.enter_context(listening(self._handle))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Remove the bars."""
        self.stack.close()

    def finish(self) -> None:
        """End the inner phase; leave a line of a long one."""
        with self.lock:
            now = self.clock()
            for key in [key for key in self.phases if not key[0]]:
                event, start = self.phases.pop(key)
                if self.display is not None:
                    self.display.remove_task(self.tasks.pop(key))
                if event.phase != LOADING and now - start >= SHORT:
                    self._write(event.line(now - start))
                    self.due = now + INTERVAL

    def _handle(self, event: Event) -> None:
        with self.lock:
            now, key = self.clock(), (event.outer, event.phase)
            if (new := key not in self.phases) and not event.outer:
                self.finish()
            if new and (not event.outer or not self.phases):
                self.due = max(now + SHORT, self.due)
            before, start = self.phases.get(key, (event, now))
            begins = event.outer and event.done < before.done  # the next job of a sweep
            self.phases[key] = event, now if begins else start
            if self.display is not None:
                if new:
                    self.tasks[key] = self.display.add_task(event.phase)
                elif begins:
                    self.display.reset(self.tasks[key])
                self.display.update(self.tasks[key], description=event.line(), completed=event.done, total=event.total)
            elif not new and now >= self.due and (not event.outer or all(of for of, _ in self.phases)):
                self.due = now + INTERVAL
                self._write(f"{event.line(now - start)}...", key)

    def _write(self, line: str, key: tuple[bool, str] | None = None) -> None:
        """Write a line of a phase: above the bars, or to a file behind the counts of the phases around it."""
        if self.display is not None:
            self.display.console.print(line, style="dim", markup=False, highlight=False)
        else:
            around = [event.count() for of, (event, _) in self.phases.items() if of[0] and of != key]
            self.file.write(f"{', '.join(filter(None, [*around, line]))}\n")
            self.file.flush()


def _display(file: TextIO, clock: Callable[[], float]) -> Display:
    """Return rich's display, which leaves the cursor of a terminal: a process that is killed could not give it back."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    console = Console(file=file)
    console.show_cursor = lambda show=True: False  # type: ignore[method-assign]
    return Progress(
        SpinnerColumn("line"),
        TimeElapsedColumn(),
        BarColumn(bar_width=min(20, max(4, console.width - 60))),  # on a narrow terminal words say more than a bar
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
        expand=True,
        console=console,
        transient=True,
        refresh_per_second=4,
        get_time=clock,
        redirect_stdout=_is_terminal(sys.stdout),
    )


def _is_terminal(file: TextIO) -> bool:
    """Return whether a file is a terminal that can show a line that moves."""
    file = getattr(file, "rich_proxied_file", file)  # what stands in for it while bars are shown need not know
    return file.isatty() and os.environ.get("TERM") != "dumb"


def say(*texts: str) -> None:
    """Print texts at once: on a terminal within its width and with its colours, elsewhere as they are.

    A command stays one line, which the terminal wraps: of two lines, a shell would take the second for another command.
    So does a row of a table in Markdown, which is to be copied into a page, and what holds a longer path than fits.
    """
    active = Progress.active
    if active is not None:
        active.finish()
    if not _is_terminal(sys.stdout):
        print(*texts, sep="\n", flush=True)
        return
    from rich.console import Console
    from rich.text import Text

    # Only the console of the bars knows where they are; what another one writes, they would erase.
    console = active.display.console if active is not None and active.display is not None else Console()
    for line in "\n".join(texts).split("\n"):
        shown = Text(line)
        for words, colour in COLOURS.items():
            shown.highlight_regex(words, colour)
        whole = COPIED.match(line) or any(len(word) > console.width for word in line.split())
        console.print(shown, soft_wrap=bool(whole), highlight=False)
