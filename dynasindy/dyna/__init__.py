"""The main loop and what hangs on it."""


class Stopped(KeyboardInterrupt):
    """A run was asked to stop, by Ctrl-C or by a signal.

    Args:
        message: What was kept of it, in one line.
        signal: Number of the signal, 2 for Ctrl-C.
    """

    def __init__(self, message: str, signal: int = 2) -> None:
        super().__init__(message)
        self.signal = signal
