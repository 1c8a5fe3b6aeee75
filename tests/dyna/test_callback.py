import json

from dynasindy.dyna.callback import Place
from dynasindy.planning import Planned


def test_a_place_that_is_restored_is_the_same_place_and_the_same_cost():
    here = Place(9, 3000, 20, 5)
    other = Place()
    other.load_state_dict(json.loads(json.dumps(here.state_dict())))
    assert other == here and here.episodes == 7
    other.add(Planned(imagined=1, updates=2))
    assert (other.imagined, other.updates) == (21, 7) and here.updates == 5
