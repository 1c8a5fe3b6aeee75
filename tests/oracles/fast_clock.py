"""A clock that does not wait: rehearsals as fast as they compute."""


class FastClock:
    """A clock that only goes on when somebody waits, and then at once; computing takes no time by it."""

    def __init__(self) -> None:
        self._now = 0.0

    def monotonic(self) -> float:
        """Return the time that was waited so far [s]."""
        return self._now

    def sleep(self, seconds: float, /) -> None:
        """Let so much time pass [s]."""
        self._now += max(0.0, seconds)
