"""What is under way: told where the work is done, heard by whoever shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class Told:
    """What is under way.

    Attributes:
        phase: What is done, in words.
        done: How much of it.
        total: How much there is; None if nobody knows.
        unit: What is counted, in the plural.
        words: What else there is to say.
        around: Whether other phases happen within this one, as those of an episode in a run.
    """

    phase: str
    done: int = 0
    total: int | None = None
    unit: str = ""
    words: str = ""
    around: bool = False

    def counted(self) -> str:
        """Return how much is done, in words; nothing where nothing is counted."""
        of = f" of {self.total}" if self.total else ""
        return f"{self.done}{of} {self.unit}".strip() if self.done or self.total else ""


_hearers: list[Callable[[Told], None]] = []
_phases: list[str] = []


def tell(
    phase: str, done: int = 0, total: int | None = None, unit: str = "", words: str = "", around: bool = False
) -> None:
    """Tell what is under way; the arguments are those of `Told`.

    What is around phases keeps its name within `telling`: a thread tells it that knows nothing of the phase of another.
    """
    named = _phases[0] if _phases and not around else phase
    for hearer in _hearers:
        hearer(Told(named, done, total, unit, words, around))


def counted(phase: str, items: Iterable[Item], total: int, unit: str = "") -> Iterator[Item]:
    """Yield items, and tell how many are done.

    Args:
        phase: What is done with them.
        items: The items.
        total: How many there are.
        unit: What they are, in the plural.
    """
    for done, item in enumerate(items):
        tell(phase, done, total, unit)
        yield item
    tell(phase, total, total, unit)


@contextmanager
def telling(phase: str) -> Iterator[None]:
    """Let all that is told while inside be told of one phase, which its parts do not know of."""
    _phases.append(phase)
    tell(phase)
    try:
        yield
    finally:
        _phases.pop()


@contextmanager
def hearing(hearer: Callable[[Told], None]) -> Iterator[None]:
    """Let a function hear what is told while inside."""
    _hearers.append(hearer)
    try:
        yield
    finally:
        _hearers.remove(hearer)
