"""Numbers that go wrong while a run is under way."""


class Diverged(ArithmeticError):
    """Numbers that are not finite where a run cannot go on from them.

    The message is one line: the phase, what went wrong in it and with which numbers, and what to do. No setting is
    impossible in itself, as with a `ValueError`; it is how the run went that leaves no usable result. Whoever raises
    it leaves networks, models and storages as they were before, so that what was good may still be saved.
    """
