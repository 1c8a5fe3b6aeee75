"""Runs in lockstep: each goes on until it needs work that others need, too; then the work of all is done at once.

Each run is the ordinary one, in a thread of its own, and only one thread moves at a time, in the order of the runs. So
nothing is done in parallel but what is batched, and what comes out does not depend on how fast a thread is.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeVar

import torch

T = TypeVar("T")
ROOMS = 16
"""Rooms that a company keeps. One of flights may take a tenth of a gigabyte of a GPU's memory."""


class Work(ABC):
    """What a run needs done."""

    @property
    @abstractmethod
    def kind(self) -> Hashable:
        """What has to be equal for the work of several runs to be done at once."""

    @property
    def waits(self) -> bool:
        """Whether all runs begin this at the same time: it waits until no run needs anything else."""
        return False

    @abstractmethod
    def done(self, all_of_it: Sequence[Any], company: Company) -> Sequence[Any]:
        """Do the work of several runs, and return what came of each: a result, or the exception that it ended in.

        Args:
            all_of_it: Work of one kind, this one among it.
            company: The runs, and what they keep from one time to the next.
        """


@dataclass(frozen=True)
class Carried:
    """What is one for all threads, and is to be another for each run, such as the settings of a job.

    Attributes:
        take: Return it as it is.
        give: Put it back.
    """

    take: Callable[[], Any] = lambda: None
    give: Callable[[Any], object] = lambda kept: None


class Company:
    """Runs that go in lockstep on one device; one run alone is a company, too.

    Attributes:
        device: Where the work is done.
        kept: What workers keep from one time to the next, by a name of their own; what was used last stands last.

    Args:
        device: Where the work is done: "cpu", or "cuda" where there is a GPU.
        carried: What each run finds as it left it when it moves again; nothing by default.

    Raises:
        ValueError: There is no such device here.
    """

    def __init__(self, device: torch.device | str = "cpu", carried: Carried | None = None) -> None:
        self.device, self.carried = found(device), carried or Carried()
        self.kept: dict[Hashable, Any] = {}  # in the order of their use
        self._members: list[_Member] = []

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Let the run in this thread be the only one."""
        token = _HERE.set(self)
        try:
            yield
        finally:
            _HERE.reset(token)

    def run(self, runs: Sequence[Callable[[], T]]) -> list[T | BaseException]:
        """Go through runs in lockstep.

        Args:
            runs: What to call, each in a thread of its own.

        Returns:
            What each returned, or the exception that it ended in; one that fails does not end the others.

        Raises:
            KeyboardInterrupt: The process was asked to stop; so was each run, which ended in its own time.
        """
        self._members = members = [_Member(self, run) for run in runs]
        try:
            for member in members:
                member.go_on()
            while waiting := [member for member in members if member.work is not None]:
                # Runs that skip a phase, as those that do not trust their model, fall into step again.
                ready = [member for member in waiting if not member.work.waits] or waiting  # type: ignore[union-attr]
                self._serve(ready)
                for member in ready:
                    member.go_on()
        except KeyboardInterrupt as signal:
            for member in members:
                member.stop(signal)
            raise
        return [member.came for member in members]

    def ask(self, work: Work) -> Any:
        """Have work done, together with that of the other runs, and return what came of it."""
        for member in self._members:
            if member.thread is threading.current_thread():
                return member.ask(work)
        return _result(work.done([work], self)[0])

    def room(self, name: Hashable, make: Callable[[], T]) -> T:
        """Return what is kept under a name. What is made anew is kept, and the least recently used one goes for it.

        Args:
            name: What it is for.
            make: Makes it where there is none.
        """
        found: T = self.kept.pop(name) if name in self.kept else make()
        self.kept[name] = found
        for oldest in list(self.kept)[:-ROOMS]:
            del self.kept[oldest]
        return found

    def _serve(self, waiting: Sequence[_Member]) -> None:
        groups: dict[Hashable, list[_Member]] = {}
        for member in waiting:
            assert member.work is not None
            groups.setdefault((type(member.work), member.work.kind), []).append(member)
        for group in groups.values():
            works = [member.work for member in group]
            first = works[0]
            assert first is not None
            try:
                results = first.done(works, self)
            except Exception as error:  # each run says by itself what that means to it
                results = [error] * len(group)
            for member, result in zip(group, results, strict=True):
                member.result = result


class _Member:
    """A run in its thread; `moves` says whose turn it is, the run's or the company's."""

    def __init__(self, company: Company, run: Callable[[], Any]) -> None:
        self.work: Work | None = None
        self.result: Any = None
        self.came: Any = None
        self.begun = self.ended = self.moves = False
        self._turn = threading.Condition()
        self.thread = threading.Thread(target=self._run, args=(company, run), daemon=True)
        self._company = company

    def go_on(self) -> None:
        """Let the run move until it asks for work or ends."""
        self.moves = True
        if not self.begun:
            self.begun = True
            self.thread.start()
        with self._turn:
            self._turn.notify_all()
            self._turn.wait_for(lambda: not self.moves)

    def ask(self, work: Work) -> Any:
        """Wait, in the thread of the run, until the work is done."""
        kept = self._company.carried.take()
        self.work = work
        self._hand_over()
        with self._turn:
            self._turn.wait_for(lambda: self.moves)
        self.work = None
        self._company.carried.give(kept)
        result, self.result = self.result, None
        return _result(result)

    def stop(self, signal: KeyboardInterrupt) -> None:
        """Ask the run to stop, and wait until it has ended; what it asks for on the way is not done any more."""
        if not self.begun:
            return
        with self._turn:
            self._turn.wait_for(lambda: not self.moves)
        while not self.ended:
            self.result = signal
            self.go_on()

    def _run(self, company: Company, run: Callable[[], Any]) -> None:
        with company.alone():
            try:
                self.came = run()
            except BaseException as error:
                self.came = error
        self.ended = True
        self._hand_over()

    def _hand_over(self) -> None:
        with self._turn:
            self.moves = False
            self._turn.notify_all()


_HERE: ContextVar[Company | None] = ContextVar("company", default=None)


def here() -> Company | None:
    """Return the company in which the present run goes; None where it goes by itself on the CPU."""
    return _HERE.get()


def found(device: torch.device | str) -> torch.device:
    """Return a device.

    Raises:
        ValueError: There is no such device here.
    """
    try:
        named = torch.device(device)
    except RuntimeError:
        named = torch.device("meta")
    there = torch.cuda.device_count() if named.type == "cuda" else 0
    if named.type == "cpu" or (named.index or 0) < there:
        return named
    here_are = "cpu and cuda" if torch.cuda.is_available() else "cpu alone, as torch finds no GPU"
    raise ValueError(f"device={device} is not to be had; on this machine there is {here_are}: choose one")


def _result(result: Any) -> Any:
    if isinstance(result, BaseException):
        raise result
    return result
