import pytest

from dynasindy.planning import Planned, Planner


class Every(Planner):
    def plan(self):
        return Planned(1, 2)

    def distrust(self):
        pass


def test_a_phase_follows_every_nth_episode():
    assert [n for n in range(1, 10) if Every(every=3).due(n)] == [3, 6, 9]


def test_every_episode_is_the_least():
    assert all(Every(every=1).due(n) for n in range(1, 4)) and Every().every == 1 and Every.learns_by_td3
    with pytest.raises(ValueError, match="at least 1 episode, got 0"):
        Every(every=0)
    assert Planned() == Planned(imagined=0, updates=0)
