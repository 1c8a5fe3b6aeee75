"""Windows join to one trajectory unless that is not wanted."""

from dataclasses import replace

from dynasindy.sindy.shooting import Descent


def test_windows_join_unless_they_are_told_not_to():
    descent = Descent(20)
    assert descent.joins and replace(descent, joined=True).joins
    assert not replace(descent, joined=False).joins
