import json

from dynasindy.dyna.callback import Callback, Callbacks, Cost, Place
from dynasindy.planning import Planned


def test_costs_add_up():
    assert Cost() == Cost(real_steps=0, imagined=0, updates=0)
    cost = Cost(real_steps=200)
    cost.add(Planned(imagined=10, updates=3))
    cost.add(Planned(imagined=5))
    assert (cost.real_steps, cost.imagined, cost.updates) == (200, 15, 3)


def test_callbacks_are_called_in_order():
    heard = []

    class Named(Callback):
        def __init__(self, name):
            self.name = name

        def fitted(self, report, excited, cost):
            heard.append((self.name, report))

    Callbacks([Named("a"), Named("b")]).fitted("report", None, Cost())
    assert heard == [("a", "report"), ("b", "report")]


def test_a_place_that_is_restored_is_the_same_place_and_the_same_cost():
    here = Place(True, True, 7, Cost(3000, 20, 5))
    other = Place()
    other.load_state_dict(json.loads(json.dumps(here.state_dict())))
    assert other == here and isinstance(other.cost, Cost)
    other.cost.add(Planned(imagined=1, updates=2))
    assert (other.cost.imagined, other.cost.updates) == (21, 7) and here.cost.updates == 5
