from dynasindy.planning import Planned, Planner


class Every(Planner):
    def plan(self):
        return Planned(1, 2)

    def distrust(self):
        pass


def test_a_phase_follows_every_nth_episode():
    assert [n for n in range(1, 10) if Every(every=3).due(n)] == [3, 6, 9]
