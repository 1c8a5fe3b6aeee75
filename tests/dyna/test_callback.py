from dynasindy.dyna.callback import Callback, Callbacks, Cost
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
